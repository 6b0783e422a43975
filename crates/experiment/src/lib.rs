//! Experiments: grids of runs, each from its start to a row of a table.
//!
//! [`Plan::parse`] reads an experiment's file and checks it; a [`Folder`] holds the results; [`execute`]
//! steps the runs that are not finished, while other threads read its progress and stop it through a
//! [`Control`]. It needs no daemon.

mod contact_events;
mod control;
mod error;
mod execute;
mod file;
mod folder;
mod grid;
mod limits;
mod plan;
mod run;

pub use control::{Control, Progress};
pub use error::PlanError;
pub use execute::{ExecuteError, Outcome, execute};
pub use folder::{Folder, FolderError};
pub use grid::AXES;
pub use limits::{MAX_ENTRIES, MAX_INDIVIDUALS, MAX_RUNS, MAX_STEPS};
pub use plan::{Plan, PlannedRun, Point};
pub use run::{Finished, conduct, start};
