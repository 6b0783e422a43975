//! Why a laboratory refuses something.

use thiserror::Error;

use jostle_experiment::PlanError;

/// Why a laboratory refuses something. Nothing has changed then.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum LabError {
    /// The file describes no experiment.
    #[error("the experiment cannot be understood: {reason}")]
    Plan {
        /// What is wrong with it, and where.
        reason: String,
        /// The line, if it is one, from 1.
        line: Option<usize>,
    },
    /// An experiment's name can be none.
    #[error("{0:?} is no name of an experiment")]
    Name(String),
    /// There is no such experiment.
    #[error("there is no experiment {0:?}: the node's get/experiments lists what there is")]
    Unknown(String),
    /// There is no such run.
    #[error("experiment {name:?} has no run {run:?}: its results name those it has")]
    UnknownRun {
        /// The experiment.
        name: String,
        /// What was asked for, at most its beginning.
        run: String,
    },
    /// The run has not been carried out so far.
    #[error("run {run:?} of experiment {name:?} is not finished: ask again when it is")]
    Unfinished {
        /// The experiment.
        name: String,
        /// The run.
        run: String,
    },
    /// No time series were asked for.
    #[error(
        "experiment {0:?} does not measure the order over time: submit it under another name with \
         order_every below [measure]"
    )]
    NoSeries(String),
    /// Another experiment has this name.
    #[error(
        "there is another experiment {0:?}, made from another file: submit this one under another \
         name, or delete that one"
    )]
    Exists(String),
    /// It is over, or not yet.
    #[error("experiment {name:?} is {phase}: {remedy}")]
    Phase {
        /// The experiment.
        name: String,
        /// What it is doing.
        phase: &'static str,
        /// What can be done about it.
        remedy: &'static str,
    },
    /// There are too many.
    #[error("there are {0} experiments, which is the most: delete one that is over")]
    TooMany(usize),
    /// What must outlive the daemon cannot be written.
    #[error("the experiment cannot be kept: {0}")]
    Unkept(String),
    /// What was written cannot be read.
    #[error("the experiment's results cannot be read: {0}")]
    Unreadable(String),
    /// The daemon stops.
    #[error("the daemon is closing: send it again when it is back")]
    Stopping,
}

impl From<PlanError> for LabError {
    fn from(error: PlanError) -> Self {
        LabError::Plan {
            line: match &error {
                PlanError::Field { line, .. } | PlanError::Repeated { line, .. } => Some(*line),
                _ => None,
            },
            reason: error.to_string(),
        }
    }
}
