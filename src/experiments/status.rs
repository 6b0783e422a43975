//! The status of an experiment: in memory, and in its folder.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use jostle_experiment::{DiskNeed, DiskWatch, ExecutionControl, Plan, Progress};
use jostle_proto::ExperimentPhase as Phase;
use serde::{Deserialize, Serialize};

use crate::jobs::StatusFile;

#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    pub name: String,
    pub phase: Phase,
    pub progress: Progress,
    /// Why it failed or the daemon paused it, or which runs ended early.
    pub message: Option<String>,
    /// The version of the model that executed its finished runs, if this program has another one.
    pub other_model: Option<u32>,
    /// The earlier version of the model of the state from which its runs start.
    pub start_model_version: Option<u32>,
}

/// The last executions in a row, of which none lasted a minute, finished a run, or was ended by a request
/// or an orderly stop of the daemon.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Starts {
    pub(super) count: u32,
    /// The number of finished runs when the last one started.
    pub(super) finished: usize,
}

/// What outlives the daemon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Status {
    /// Its position in the order of submission.
    pub(super) number: u64,
    /// On disk, a running experiment is queued: it resumes when the daemon restarts.
    pub(super) phase: Phase,
    #[serde(flatten)]
    progress: Progress,
    #[serde(default)]
    pub(super) message: Option<String>,
    #[serde(default)]
    pub(super) starts: Starts,
    /// The earlier version of the model of the state from which its runs start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) start_model_version: Option<u32>,
}

impl StatusFile for Status {
    const NAME: &'static str = "standing.json";
}

/// Returns whether the status in the folder of an experiment says that all its runs are finished.
pub fn is_finished(folder: &Path) -> bool {
    let status = fs::read(folder.join(Status::NAME)).ok();
    let status = status.and_then(|status| serde_json::from_slice::<Status>(&status).ok());
    status.is_some_and(|status| status.phase == Phase::Finished)
}

impl Status {
    pub(super) fn queued(number: u64) -> Self {
        Status {
            number,
            phase: Phase::Queued,
            progress: Progress::default(),
            message: None,
            starts: Starts::default(),
            start_model_version: None,
        }
    }

    /// Whether runs were finished when it was stored.
    pub(super) fn has_finished(&self) -> bool {
        self.progress.finished > 0
    }

    /// Sets what the plan determines, and how many runs are finished.
    pub(super) fn plan(&mut self, plan: &Plan, finished: usize) {
        self.count(plan.runs().len(), finished);
        self.start_model_version = plan.start_model_version();
    }

    /// Sets the plan's number of runs, and how many of them are finished.
    fn count(&mut self, runs: usize, finished: usize) {
        self.progress.runs = runs;
        if finished < self.progress.finished {
            // Files of runs are missing.
            self.progress.share = finished as f64 / runs.max(1) as f64;
        }
        self.progress.finished = finished;
    }

    /// Sets how many runs of an experiment that is over are finished, and what is said of the others.
    pub(super) fn set_lacking(&mut self, finished: usize, message: String) {
        self.progress.finished = finished;
        self.progress.share = finished as f64 / self.progress.runs.max(1) as f64;
        self.message = Some(message);
    }
}

pub(super) struct Entry {
    /// As of the end of the last execution, but for the phase and the message.
    pub(super) status: Status,
    /// `None` until it is needed, if the experiment was over when the daemon started.
    pub(super) plan: Option<Arc<Plan>>,
    /// The version of the model that executed its finished runs, if this program has another one.
    pub(super) other_model: Option<u32>,
    /// What its files took when they were last measured, in bytes.
    pub(super) bytes: u64,
    /// What all its runs need on disk, if it is not over.
    pub(super) need: Option<DiskNeed>,
    /// Controls the execution, also while that is paused or about to end.
    pub(super) execution: Option<Arc<ExecutionControl>>,
    /// Differs between executions, and between what precedes and follows a pause.
    pub(super) number_of_execution: u64,
}

impl Entry {
    pub(super) fn report(&self, name: &str) -> Report {
        let before = self.status.progress.clone();
        let mut progress = match self.execution.as_ref().map(|it| it.progress()) {
            // It has no runs until it has started.
            Some(current) if current.runs > 0 => Progress {
                elapsed_secs: before.elapsed_secs + current.elapsed_secs,
                ..current
            },
            _ => before,
        };
        let phase = self.status.phase;
        if phase != Phase::Running {
            progress.left_secs = None;
        }
        if phase.is_over() {
            progress.running.clear();
        }
        Report {
            name: name.to_owned(),
            phase,
            progress,
            message: self.status.message.clone(),
            other_model: self.other_model,
            start_model_version: self.status.start_model_version,
        }
    }

    /// The present status, in another phase, with no start counted.
    pub(super) fn status_in(&self, phase: Phase, message: Option<String>) -> Status {
        Status {
            number: self.status.number,
            phase,
            message,
            starts: Starts::default(),
            start_model_version: self.status.start_model_version,
            progress: Progress {
                left_secs: None,
                running: Vec::new(),
                ..self.report("").progress
            },
        }
    }

    /// Enters the phase of a status that has been stored.
    pub(super) fn enter(&mut self, stored: &Status) {
        self.status.phase = stored.phase;
        self.status.message.clone_from(&stored.message);
        self.status.starts = stored.starts;
    }

    /// What its files take, in bytes.
    pub(super) fn bytes(&self) -> u64 {
        let disk = self.execution.as_ref().and_then(|it| it.disk());
        let grown = disk.map_or(0, DiskWatch::grown);
        self.bytes.saturating_add_signed(grown)
    }

    /// What it may still write, if it is not over.
    pub(super) fn left(&self) -> Option<DiskNeed> {
        let need = self.need.filter(|_| !self.status.phase.is_over())?;
        Some(DiskNeed {
            bytes: (need.bytes - self.bytes() as f64).max(0.0),
            ..need
        })
    }

    /// Whether no other experiment may be executed now.
    pub(super) fn is_busy(&self) -> bool {
        self.status.phase == Phase::Running || self.is_ending()
    }

    /// Whether it is over, but its last execution still uses its folder.
    pub(super) fn is_ending(&self) -> bool {
        self.status.phase.is_over() && self.execution.is_some()
    }

    /// Its execution has ended: at the end of all runs if `is_complete`.
    pub(super) fn end(&mut self, is_complete: bool) {
        self.status = self.status_in(self.status.phase, self.status.message.clone());
        self.execution = None;
        if is_complete {
            self.status.phase = Phase::Finished;
            self.status.progress.share = 1.0;
        }
    }
}
