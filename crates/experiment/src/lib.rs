//! Experiments: grids of runs, each of which gives a row of a table.
//!
//! [`Plan::of`] parses and checks an experiment's [`Files`]. A [`Folder`] contains the results.
//! [`execute`] executes the unfinished runs, while other threads read its progress and pause or
//! cancel it through an [`ExecutionControl`]. No daemon is needed.
//!
//! Without the feature `files` there are no folders of results: a caller has the contents of the files
//! and steps single runs, each as a [`CurrentRun`].

mod cells;
mod contact_events;
mod error;
mod export;
mod file;
mod files;
mod grid;
mod limits;
mod plan;
mod play;
mod points;
mod protocol;
mod row_grids;
mod run;
mod schema;
mod series;
mod set_points;
pub mod shell;
mod start;
pub mod stdout;
mod subset;

#[cfg(feature = "files")]
mod again;
#[cfg(feature = "files")]
mod digest;
#[cfg(feature = "files")]
mod disk;
#[cfg(feature = "files")]
mod dry_run;
#[cfg(feature = "files")]
mod execute;
#[cfg(feature = "files")]
mod folder;
#[cfg(feature = "files")]
pub mod html;
#[cfg(feature = "files")]
mod merge;
#[cfg(feature = "files")]
mod progress;
#[cfg(feature = "files")]
mod spool_hash;
#[cfg(feature = "files")]
mod trajectory;

pub use error::PlanError;
pub use export::{
    AppliedChange, ExportError, ExportOptions, ExportedFiles, SwarmHistory, experiment_file,
};
pub use files::{EncodedFiles, Files, POINTS, SET_POINTS, START};
pub use jostle_physics::model::MODEL_VERSION;
pub use limits::{
    MAX_BLOCKS, MAX_ENTRIES, MAX_INDIVIDUALS, MAX_RUNS, MAX_SET_POINTS, MAX_STEPS,
    MAX_TRAJECTORY_BYTES,
};
pub use plan::{Columns, Plan, PlannedRun, Point};
pub use play::{LiveCommand, LiveRun, MAX_COMMANDS, PlayError};
pub use protocol::{Block, Protocol, Trigger, Variables};
pub use run::{CurrentRun, FinishedRun, Recorder, RunCheckpoint, execute_run, start};
pub use schema::{SCHEMA, schema};
pub use series::SeriesKind;
pub use set_points::{SetPoint, SetPointLog};
pub use start::start_remark;
pub use subset::{Subset, SubsetError};

#[cfg(feature = "files")]
pub use self::{
    again::{folder_again, name_again},
    disk::DiskWatch,
    dry_run::{DiskNeed, DryRun, Estimate, Measured},
    execute::{ExecuteError, Execution, Outcome, execute},
    files::{EXPERIMENT, FilesError},
    folder::{
        FinishedRuns, Folder, FolderError, MissingFiles, SeriesSource, finished, results_in,
        unfinished,
    },
    merge::{Difference, MergeError, Parts, missing},
    progress::{ExecutionControl, Progress},
};
