//! Why a file describes no experiment.

use thiserror::Error;

use crate::limits::{MAX_ENTRIES, MAX_RUNS};
use jostle_physics::simulation::ChangeError;

/// Why a file describes no experiment.
#[derive(Debug, Error)]
pub enum PlanError {
    /// Something in it is not known, of another kind, or outside its range.
    #[error("line {line}: {reason}")]
    Field {
        /// The line, from 1.
        line: usize,
        /// What is wrong, and what would not be.
        reason: String,
    },
    /// A run's parameters or its start are refused.
    #[error("run {run:?}: {error}")]
    Run {
        /// The first run of that kind.
        run: String,
        /// Why.
        error: ChangeError,
    },
    /// Two runs have one name.
    #[error("line {line}: run {run:?} is there twice: no value and no grid may repeat another")]
    Repeated {
        /// Where the later one's grid begins.
        line: usize,
        /// The run.
        run: String,
    },
    /// There are more runs than an experiment may have.
    #[error("these are {runs} runs, and an experiment has at most {MAX_RUNS}: split it")]
    TooManyRuns {
        /// How many, or as many as can be counted.
        runs: u64,
    },
    /// The time series would fill a disk.
    #[error(
        "the orders over time have {entries} entries, at most {MAX_ENTRIES} are kept: raise \
         order_every"
    )]
    TooManyEntries {
        /// How many.
        entries: u64,
    },
}
