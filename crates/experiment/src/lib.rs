//! Experiments: grids of runs, each of which gives a row of a table.
//!
//! [`Plan::of`] parses and checks an experiment's [`Files`]. A [`Folder`] contains the results.
//! [`execute`] executes the unfinished runs, while other threads read its progress and pause or
//! cancel it through an [`ExecutionControl`]. No daemon is needed.

mod cells;
mod contact_events;
mod digest;
mod disk;
mod dry_run;
mod error;
mod execute;
mod export;
mod file;
mod files;
mod folder;
mod grid;
mod limits;
mod merge;
mod plan;
mod play;
mod points;
mod progress;
mod protocol;
mod row_grids;
mod run;
mod schema;
mod series;
mod set_points;
pub mod shell;
mod spool_hash;
mod start;
pub mod stdout;
mod subset;
mod trajectory;

pub use disk::DiskWatch;
pub use dry_run::{DiskNeed, DryRun, Estimate, Measured};
pub use error::PlanError;
pub use execute::{ExecuteError, Execution, Outcome, execute};
pub use export::{
    AppliedChange, ExportError, ExportOptions, ExportedFiles, SwarmHistory, experiment_file,
};
pub use files::{Files, FilesError, POINTS, SET_POINTS, START};
pub use folder::{FinishedRuns, Folder, FolderError, MissingFiles, SeriesSource, unfinished};
pub use jostle_physics::model::MODEL_VERSION;
pub use limits::{
    MAX_BLOCKS, MAX_ENTRIES, MAX_INDIVIDUALS, MAX_RUNS, MAX_SET_POINTS, MAX_STEPS,
    MAX_TRAJECTORY_BYTES,
};
pub use merge::{Difference, MergeError, Parts, missing};
pub use plan::{Columns, Plan, PlannedRun, Point};
pub use play::{LiveCommand, LiveRun, MAX_COMMANDS, PlayError};
pub use progress::{ExecutionControl, Progress};
pub use protocol::{Block, Protocol, Trigger, Variables};
pub use run::{FinishedRun, execute_run, start};
pub use schema::{SCHEMA, schema};
pub use series::SeriesKind;
pub use set_points::{SetPoint, SetPointLog};
pub use subset::{Subset, SubsetError};
