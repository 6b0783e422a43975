//! Errors in an experiment's file.

use thiserror::Error;

use crate::limits::{MAX_ENTRIES, MAX_RUNS, MAX_TRAJECTORY_BYTES};
use jostle_physics::simulation::ChangeError;

/// Why an experiment's file is rejected.
#[derive(Debug, Error)]
pub enum PlanError {
    /// A field is unknown, of a wrong kind, or outside its range.
    #[error("line {line}, column {column}: {reason}")]
    Field {
        /// The line, from 1.
        line: usize,
        /// The column in characters, from 1.
        column: usize,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// A cell of the CSV that the file names is invalid.
    #[error("{file}, line {line}, column {column}: {reason}")]
    Points {
        /// The CSV, as the file names it.
        file: String,
        /// The line, from 1.
        line: usize,
        /// The number of the column in the CSV, from 1.
        column: usize,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// A cell of the CSV with the set-points that the file names is invalid.
    #[error("{file}, line {line}, column {column}: {reason}")]
    SetPoints {
        /// The CSV, as the file names it.
        file: String,
        /// The line, from 1.
        line: usize,
        /// The number of the column in the CSV, from 1.
        column: usize,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// The parameters or the start of a run are rejected.
    #[error("run {run:?}: {error}")]
    Run {
        /// The first replicate.
        run: String,
        /// Why.
        error: ChangeError,
    },
    /// Two runs have the same name.
    #[error("line {line}: duplicate run {run:?}: remove the repeated value or grid")]
    Repeated {
        /// The line of the later run's grid.
        line: usize,
        /// The run.
        run: String,
    },
    /// The experiment has more than [`MAX_RUNS`] runs.
    #[error("{runs} runs, the limit is {MAX_RUNS}: split the experiment")]
    TooManyRuns {
        /// Their number; `u64::MAX` if it is larger.
        runs: u64,
    },
    /// The time series have more than [`MAX_ENTRIES`] entries.
    #[error(
        "the time series have {entries} values, the limit is {MAX_ENTRIES}: raise order_every or \
         series_every"
    )]
    TooManyEntries {
        /// Their number.
        entries: u64,
    },
    /// The trajectories can take more than [`MAX_TRAJECTORY_BYTES`].
    #[error(
        "the trajectories have up to {rows} rows, {:.1} GB; the limit is {} GB: raise record_every, \
         or split the experiment",
        bytes / 1e9, MAX_TRAJECTORY_BYTES / 1e9
    )]
    TooManyFrames {
        /// Their number of rows, at most: a row for each individual and recorded step.
        rows: f64,
        /// Their bytes.
        bytes: f64,
    },
}

impl PlanError {
    /// Returns what is wrong, without the place in a file.
    pub(crate) fn without_place(&self) -> String {
        match self {
            Self::Field { reason, .. }
            | Self::Points { reason, .. }
            | Self::SetPoints { reason, .. } => reason.clone(),
            other => other.to_string(),
        }
    }
}
