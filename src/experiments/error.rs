//! Why a request about experiments is rejected.

use std::fmt::Display;

use jostle_experiment::{MODEL_VERSION, PlanError, name_again};
use jostle_proto::ExperimentPhase as Phase;
use thiserror::Error;

/// Why a request about experiments is rejected. It has changed nothing.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ExperimentError {
    #[error("invalid experiment: {reason}")]
    Plan {
        /// What is wrong, and where.
        reason: String,
        /// The field of the request that is wrong.
        field: String,
        /// The line from 1, if the error is in one line.
        line: Option<usize>,
    },
    #[error("invalid experiment name {0:?}")]
    Name(String),
    #[error("unknown experiment {0:?}: the node's get/experiments lists the experiments")]
    Unknown(String),
    #[error("experiment {name:?} has no run {run:?}: its results list the finished runs")]
    UnknownRun {
        name: String,
        /// The requested name, truncated.
        run: String,
    },
    #[error("run {run:?} of experiment {name:?} is not finished: retry when it is")]
    Unfinished { name: String, run: String },
    #[error(
        "the file of run {run:?} of experiment {name:?} is missing: `jostle experiment resume` executes \
         the run again"
    )]
    MissingFile { name: String, run: String },
    #[error(
        "{reason}: delete the file, then `jostle experiment resume {name}` executes the run again"
    )]
    DamagedFile {
        name: String,
        run: String,
        /// Which file, and how it is damaged.
        reason: String,
    },
    #[error(
        "experiment {0:?} does not measure the order over time: submit it under another name with \
         order_every in [measure]"
    )]
    NoOrder(String),
    #[error(
        "experiment {0:?} does not record measures over time: submit it under another name with \
         series_every in [measure]"
    )]
    NoSeries(String),
    #[error(
        "experiment {0:?} does not record trajectories: submit it under another name with \
         record_every in [measure]"
    )]
    NoTrajectory(String),
    #[error(
        "another experiment has the name {0:?}: submit this one under another name, or delete that \
         one"
    )]
    Exists(String),
    #[error(
        "version {theirs} of the model executed the finished runs of experiment {name:?}, and this daemon has \
         {MODEL_VERSION}: they remain readable; `jostle experiment run --again FILE` executes all runs again, as \
         {again}"
    )]
    OtherModel {
        name: String,
        /// The version of the model that executed its runs.
        theirs: u32,
        /// The name under which they are executed again.
        again: String,
    },
    #[error("experiment {name:?} is {phase}: {remedy}")]
    Phase {
        name: String,
        phase: Phase,
        remedy: &'static str,
    },
    #[error("there are {0} experiments, the maximum: delete one that is over")]
    TooMany(usize),
    #[error("{0}")]
    TooLong(String),
    #[error(
        "the experiment needs up to {} on disk, {} are free{}: free disk space, raise record_every or \
         series_every, or split the experiment", size(*needed), size(*free), kept(*reserved)
    )]
    NoRoom {
        needed: u64,
        /// What is free for it, in bytes.
        free: u64,
        /// What unfinished experiments may still write, in bytes.
        reserved: u64,
    },
    #[error(
        "the experiment needs {} of memory for a single run, {} of {} are free beside the swarms: make it \
         smaller, delete swarms, or raise max_memory_mb", size(*needed), size(*free), size(*limit)
    )]
    NoMemory {
        needed: u64,
        /// What the swarms leave, in bytes.
        free: u64,
        /// `max_memory_mb` in bytes.
        limit: u64,
    },
    #[error(
        "the experiment needs up to {} on disk, {} of {} are left (experiments_quota_mb){}: delete one \
         that is over, or raise the setting", size(*needed), size(*left), size(*quota), kept(*reserved)
    )]
    OverQuota {
        needed: u64,
        /// What is left for it, in bytes.
        left: u64,
        /// What unfinished experiments may still write, in bytes.
        reserved: u64,
        /// `experiments_quota_mb` in bytes.
        quota: u64,
    },
    #[error("cannot write the experiment: {0}")]
    NotStored(String),
    #[error("cannot read the experiment: {0}")]
    Unreadable(String),
    #[error("the daemon is stopping: retry after it has restarted")]
    Stopping,
}

impl ExperimentError {
    /// The error of a file in the arguments of an action.
    pub fn of_plan(action: &str, error: &PlanError) -> Self {
        ExperimentError::Plan {
            line: match error {
                PlanError::Field { line, .. }
                | PlanError::Repeated { line, .. }
                | PlanError::Points { line, .. }
                | PlanError::SetPoints { line, .. } => Some(*line),
                _ => None,
            },
            field: match error {
                PlanError::Points { .. } => format!("{action}.points"),
                PlanError::SetPoints { .. } => format!("{action}.setpoints"),
                _ => format!("{action}.toml"),
            },
            reason: error.to_string(),
        }
    }

    /// No run is added to an experiment of another version of the model.
    pub(super) fn other_model(name: &str, theirs: u32) -> Self {
        ExperimentError::OtherModel {
            name: name.to_owned(),
            theirs,
            again: name_again(name),
        }
    }

    /// The message of an experiment that may need less.
    pub(super) fn as_warning(&self) -> String {
        format!("{self}; it may need less, and is paused if it does not")
    }

    pub(super) fn not_stored(error: impl Display) -> Self {
        ExperimentError::NotStored(error.to_string())
    }

    pub(super) fn unreadable(error: impl Display) -> Self {
        ExperimentError::Unreadable(error.to_string())
    }
}

/// A number of bytes, rounded up to MiB.
fn size(bytes: u64) -> String {
    format!("{} MiB", bytes.div_ceil(1 << 20))
}

fn kept(reserved: u64) -> String {
    match reserved {
        0 => String::new(),
        reserved => format!(" beside the {} that unfinished ones need", size(reserved)),
    }
}

impl From<PlanError> for ExperimentError {
    fn from(error: PlanError) -> Self {
        ExperimentError::of_plan("submit", &error)
    }
}
