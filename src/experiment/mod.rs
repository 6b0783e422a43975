//! Experiments: grids of runs, each from its start to a row in a table.
//!
//! [`Plan::parse`] reads what is asked for and checks all of it; [`Folder`] is where results are
//! kept; [`execute`] carries out what is not finished, and others look and stop it through a
//! [`Control`].

mod control;
mod error;
mod execute;
mod file;
mod folder;
mod grid;
mod limits;
mod plan;
mod run;
mod touch;

pub use control::{Control, Progress};
pub use error::PlanError;
pub use execute::{ExecuteError, Outcome, execute};
pub use folder::{Folder, FolderError};
pub use grid::AXES;
pub use limits::{MAX_ENTRIES, MAX_INDIVIDUALS, MAX_RUNS, MAX_STEPS};
pub use plan::{Plan, PlannedRun, Point};
pub use run::{Finished, conduct, start};
