//! Counts the starts of an experiment that an unclean end of the daemon follows. A daemon that an
//! experiment ends, such as for lack of memory, would otherwise execute it again after each restart.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use fail::fail_point;
use jostle_experiment::ExecutionControl;
use jostle_proto::ExperimentPhase as Phase;
use tracing::warn;

use super::status::{Entry, Starts, Status};
use super::{ExperimentManager, State};

/// After this time an execution is not the cause of an unclean end: reading the folder and the first
/// steps of each thread take seconds.
const SETTLE_TIME: Duration = Duration::from_secs(60);

/// The number of unclean ends in a row after which an experiment is not started: one may have another
/// cause, such as a power loss.
const MAX_UNCLEAN_ENDS: u32 = 2;

impl Starts {
    /// What counts after an end of the daemon, when so many runs are finished.
    pub(super) fn left_at(self, finished: usize) -> Self {
        match finished > self.finished {
            true => Starts::default(),
            false => self,
        }
    }

    fn next(self, finished: usize) -> Self {
        Starts {
            count: self.left_at(finished).count + 1,
            finished,
        }
    }
}

impl Status {
    /// Pauses an experiment that was not ended in order before the daemon started, if that has
    /// happened too often; so many of its runs are finished. Returns whether it is paused for that.
    pub(super) fn pause_after_unclean_ends(&mut self, name: &str, finished: usize) -> bool {
        self.starts = self.starts.left_at(finished);
        let Starts { count, .. } = self.starts;
        let is_suspended = count >= MAX_UNCLEAN_ENDS;
        if is_suspended {
            warn!(
                experiment = name,
                unclean_ends = count,
                "paused: see its message"
            );
            self.phase = Phase::Paused;
            self.message = Some(format!(
                "the daemon was killed or crashed {count} times in a row within {} s of starting this \
                 experiment, before a run finished: find the cause, such as too little memory, then \
                 `jostle experiment resume {name}` continues",
                SETTLE_TIME.as_secs()
            ));
            self.starts = Starts::default();
        }
        is_suspended
    }
}

impl ExperimentManager {
    /// Counts the start of the execution number `execution`; it is durable on return.
    pub(super) fn count_start(&self, name: &str, execution: u64) {
        self.write_starts(name, execution, |entry| {
            let finished = entry.report("").progress.finished;
            entry.status.starts.next(finished)
        });
    }

    /// Resumes an execution that is paused, once that is counted.
    pub(super) fn resume_counted(
        &self,
        name: &str,
        execution: u64,
        paused: &Arc<ExecutionControl>,
    ) {
        let (manager, counted, control) = (self.clone(), name.to_owned(), paused.clone());
        let work = move || {
            manager.count_start(&counted, execution);
            if going(&mut manager.lock(), &counted, execution).is_some() {
                control.resume();
            }
            manager.wait_until_settled(&counted, execution);
        };
        if let Err(error) = spawn(work) {
            warn!(experiment = name, %error, "the start is not counted");
            paused.resume();
        }
    }

    /// Discards the count once the execution has lasted [`SETTLE_TIME`].
    pub(super) fn settle(&self, name: &str, execution: u64) {
        let (manager, settled) = (self.clone(), name.to_owned());
        let work = move || manager.wait_until_settled(&settled, execution);
        if let Err(error) = spawn(work) {
            warn!(experiment = name, %error, "the start remains counted");
        }
    }

    /// Cancels what is running; nothing starts afterwards. Returns the names of what was running.
    pub(super) fn begin_stop(&self) -> Vec<String> {
        let mut state = self.lock();
        state.is_stopping = true;
        let mut running = Vec::new();
        for (name, entry) in &state.entries {
            if let Some(execution) = &entry.execution {
                execution.cancel();
                if entry.status.phase == Phase::Running {
                    running.push(name.clone());
                }
            }
        }
        self.0.changed.notify_all();
        running
    }

    /// Stores that the daemon ends in order, on a thread of its own: a disk must not delay the end.
    pub(super) fn store_orderly_ends(&self, running: Vec<String>) {
        let manager = self.clone();
        let work = move || {
            manager.write_orderly_ends(running);
            manager.lock().is_stop_stored = true;
            manager.0.changed.notify_all();
        };
        if let Err(error) = spawn(work) {
            warn!(%error, "the starts remain counted");
            self.lock().is_stop_stored = true;
        }
    }

    fn write_orderly_ends(&self, running: Vec<String>) {
        let _writing = self.0.serialize_writes.lock();
        for name in running {
            let stopped = |entry: &Entry| {
                // On disk, a running experiment is queued.
                let is_running = entry.status.phase == Phase::Running;
                is_running.then(|| entry.status_in(Phase::Queued, None))
            };
            if let Ok(Some(status)) = self.entry(&name, stopped)
                && let Err(error) = self.0.jobs.write_status(&name, &status)
            {
                warn!(experiment = name, %error, "failed to write the status file");
            }
        }
    }

    fn wait_until_settled(&self, name: &str, execution: u64) {
        let mut state = self.lock();
        let is_going = |state: &mut State| going(state, name, execution).is_some();
        let changed = &self.0.changed;
        let waited = changed.wait_while_for(&mut state, is_going, settle_time());
        drop(state);
        if waited.timed_out() {
            self.write_starts(name, execution, |_| Starts::default());
        }
    }

    /// Writes what is counted of an execution, unless that has ended or is paused.
    fn write_starts(&self, name: &str, execution: u64, starts: impl FnOnce(&Entry) -> Starts) {
        let _writing = self.0.serialize_writes.lock();
        let status = {
            let mut state = self.lock();
            let Some(entry) = going(&mut state, name, execution) else {
                return;
            };
            entry.status.starts = starts(entry);
            // On disk, a running experiment is queued.
            let mut status = entry.status_in(Phase::Queued, None);
            status.starts = entry.status.starts;
            status
        };
        if let Err(error) = self.0.jobs.write_status(name, &status) {
            warn!(experiment = name, %error, "failed to write the status file");
        }
    }
}

/// The entry of an experiment, if it is running and this is its present execution.
fn going<'a>(state: &'a mut State, name: &str, execution: u64) -> Option<&'a mut Entry> {
    let is_stopping = state.is_stopping;
    let entry = state.entries.get_mut(name)?;
    let is_going = entry.status.phase == Phase::Running && entry.number_of_execution == execution;
    (is_going && !is_stopping).then_some(entry)
}

fn spawn(work: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    let thread = thread::Builder::new().name("experiment-start".into());
    thread.spawn(work).map(drop)
}

/// The time after which an execution is settled; tests shorten it.
fn settle_time() -> Duration {
    fail_point!("experiment-settled", |millis| {
        let millis = millis.and_then(|it| it.parse().ok());
        Duration::from_millis(millis.unwrap_or_default())
    });
    SETTLE_TIME
}
