//! Executes the queued experiments, one at a time in the order of submission.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use jostle_experiment::{
    ExecuteError, Execution, ExecutionControl, Folder, FolderError, Outcome, Subset, execute,
};
use jostle_proto::ExperimentPhase as Phase;
use parking_lot::MutexGuard;
use tracing::{info, warn};

use super::status::Entry;
use super::{ExperimentManager, State};

/// The interval of the checkpoints of a run: at most as much is repeated after a crash.
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(300);

impl ExperimentManager {
    /// Publishes a change of the state, and starts the next experiment if none is running.
    pub(super) fn publish_change(&self, mut state: MutexGuard<'_, State>) {
        state.version += 1;
        self.schedule_next(&mut state);
        self.0.changed.notify_all();
    }

    pub(super) fn schedule_next(&self, state: &mut State) {
        while state.is_measured && !state.is_stopping && !state.entries.values().any(Entry::is_busy)
        {
            let queued = state.entries.iter_mut();
            let queued = queued.filter(|(_, entry)| entry.status.phase == Phase::Queued);
            let Some((name, entry)) = queued.min_by_key(|(_, entry)| entry.status.number) else {
                return;
            };
            state.version += 1;
            entry.status.phase = Phase::Running;
            entry.number_of_execution = state.version;
            if let Some(paused) = &entry.execution {
                return self.resume_counted(name, state.version, paused);
            }
            if let Err(reason) = self.start(name, entry) {
                warn!(experiment = name, reason, "failed to start");
                entry.status.phase = Phase::Failed;
                entry.status.message = Some(reason);
            }
        }
    }

    fn start(&self, name: &str, entry: &mut Entry) -> Result<(), String> {
        let plan = entry.plan.clone().ok_or("its plan is unknown")?;
        let control = Arc::new(ExecutionControl::with_disk(self.watch_disk()));
        let (manager, name, controlled) = (self.clone(), name.to_owned(), control.clone());
        let number = entry.number_of_execution;
        let run = move || {
            manager.count_start(&name, number);
            manager.settle(&name, number);
            let path = manager.0.jobs.folder(&name);
            let executed = catch_unwind(AssertUnwindSafe(|| {
                let mut folder = Folder::open(&path, &plan).map_err(|it| End::of_folder(&it))?;
                let memory = manager.reserve_memory(&plan);
                let memory = memory.map_err(|it| End::of(true, format!("{it}, then resume it")))?;
                let execution = Execution {
                    plan: &plan,
                    subset: &Subset::all(&plan),
                    threads: memory.threads,
                    checkpoint_every: Some(CHECKPOINT_INTERVAL),
                };
                execute(execution, &mut folder, &controlled).map_err(|it| End::of_execution(&it))
            }));
            let outcome = executed.unwrap_or_else(|_| Err(End::failed("a defect of the daemon")));
            manager.ended(&name, outcome);
        };
        let thread = thread::Builder::new().name("experiment".into());
        thread.spawn(run).map_err(|error| error.to_string())?;
        entry.execution = Some(control);
        Ok(())
    }

    fn ended(&self, name: &str, outcome: Result<Outcome, End>) {
        // A stop does not wait for it.
        let bytes = (!self.lock().is_stopping).then(|| self.measure(name));
        let writing = self.0.serialize_writes.lock();
        let mut state = self.lock();
        let is_stopping = state.is_stopping;
        let Some(entry) = state.entries.get_mut(name) else {
            return;
        };
        entry.bytes = bytes.unwrap_or_else(|| entry.bytes());
        entry.end(outcome.as_ref().is_ok_and(|it| !it.is_cancelled));
        match outcome {
            Ok(outcome) if !outcome.is_cancelled => entry.status.message = faults(&outcome),
            // `cancel` has stored the phase; after `stop` the experiment resumes.
            Ok(_) if is_stopping || entry.status.phase == Phase::Cancelled => {}
            Ok(_) => entry.status.phase = Phase::Cancelled,
            Err(End { phase, .. }) if phase == Phase::Paused && entry.status.phase.is_over() => {}
            Err(End { phase, reason }) => {
                warn!(experiment = name, reason, "stopped");
                entry.status.phase = phase;
                entry.status.message = Some(reason);
            }
        }
        let phase = entry.status.phase;
        info!(experiment = name, phase = phase.to_string(), "ended");
        if (phase.is_over() || phase == Phase::Paused)
            && let Err(error) = self.0.jobs.write_status(name, &entry.status)
        {
            // The next start finds all runs finished.
            warn!(experiment = name, %error, "failed to write the status file");
        }
        drop(writing);
        self.publish_change(state);
    }
}

/// Why an execution ended before its end, and the phase after it.
struct End {
    phase: Phase,
    reason: String,
}

impl End {
    fn failed(reason: &str) -> Self {
        let (phase, reason) = (Phase::Failed, reason.to_owned());
        Self { phase, reason }
    }

    /// A lack of disk space or memory pauses an experiment, anything else is a failure.
    fn of(lacks_room: bool, reason: String) -> Self {
        let phase = match lacks_room {
            true => Phase::Paused,
            false => Phase::Failed,
        };
        Self { phase, reason }
    }

    fn of_folder(error: &FolderError) -> Self {
        Self::of(error.is_disk_full(), error.to_string())
    }

    fn of_execution(error: &ExecuteError) -> Self {
        Self::of(error.is_disk_full(), error.to_string())
    }
}

/// A message about the runs that ended early.
fn faults(outcome: &Outcome) -> Option<String> {
    let (run, why) = outcome.faults.first()?;
    Some(match outcome.faults.len() {
        1 => format!("run {run:?} ended early: {why}"),
        count => format!("{count} runs ended early; run {run:?}: {why}"),
    })
}
