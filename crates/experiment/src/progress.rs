//! Progress and control of a running experiment, from any thread.
//!
//! A thread that steps a run writes its own counter and reads one atomic signal: it takes no lock
//! between steps unless the experiment is paused or cancelled.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::disk::DiskWatch;

/// Values of the signal.
const GOING: u8 = 0;
const PAUSED: u8 = 1;
const CANCELLED: u8 = 2;

/// Elapsed time before the remaining time is estimated.
const MIN_ELAPSED: Duration = Duration::from_millis(500);

/// The progress of an experiment. The current runs are not stored.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Progress {
    /// Number of runs of the experiment.
    pub runs: usize,
    /// Number of finished runs, including those of earlier executions.
    pub finished: usize,
    /// Number of finished runs that ended early.
    pub faulted: usize,
    /// The share of the work that is done, including the steps of current runs.
    pub share: f64,
    /// The time of this execution without pauses.
    pub elapsed_secs: f64,
    /// The estimated remaining time without pauses; none if it cannot be estimated yet.
    #[serde(skip)]
    pub left_secs: Option<f64>,
    /// The current runs, each with the share of its steps that is done.
    #[serde(skip)]
    pub running: Vec<(String, f64)>,
}

/// Reports the progress of one execution of an experiment, and pauses or cancels it, from any
/// thread.
#[derive(Debug, Default)]
pub struct ExecutionControl {
    /// [`GOING`], [`PAUSED`] or [`CANCELLED`].
    signal: AtomicU8,
    state: Mutex<ProgressState>,
    /// Notified when the signal leaves [`PAUSED`].
    changed: Condvar,
    /// The disk space that it may use; none if it may use all.
    disk: Option<DiskWatch>,
}

/// Steps of a current run. Aligned so that no two threads write to the same cache line.
#[derive(Debug, Default)]
#[repr(align(128))]
struct Counter(AtomicU64);

/// Costs are expected seconds of one core.
#[derive(Debug, Default)]
struct ProgressState {
    runs: usize,
    finished: usize,
    faulted: usize,
    /// Cost of all runs.
    cost: f64,
    /// Cost of the runs that were finished before this execution, and that are finished now.
    cost_before: f64,
    cost_finished: f64,
    /// Current runs by their index in the plan.
    running: BTreeMap<usize, CurrentRun>,
    clock: Clock,
}

#[derive(Debug)]
struct CurrentRun {
    name: String,
    steps: u64,
    cost: f64,
    counter: Arc<Counter>,
}

/// Measures the time of an execution without pauses.
#[derive(Debug, Default)]
struct Clock {
    past: Duration,
    since: Option<Instant>,
}

impl Clock {
    fn stop(&mut self) {
        self.past = self.read();
        self.since = None;
    }

    fn start(&mut self) {
        self.since = self.since.or_else(|| Some(Instant::now()));
    }

    fn read(&self) -> Duration {
        self.past + self.since.map_or(Duration::ZERO, |since| since.elapsed())
    }
}

/// The side of a run: counts its steps and reads the signal.
pub struct RunHandle<'a> {
    control: &'a ExecutionControl,
    counter: Arc<Counter>,
}

impl ExecutionControl {
    /// Returns a control that is neither paused nor cancelled.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// As [`Self::new`], of an execution that ends with [`ExecuteError::NoRoom`] once its disk space
    /// ends.
    ///
    /// [`ExecuteError::NoRoom`]: crate::ExecuteError::NoRoom
    #[must_use]
    pub fn with_disk(disk: DiskWatch) -> Self {
        Self {
            disk: Some(disk),
            ..Self::default()
        }
    }

    /// Returns the disk space that the execution may use; none if it may use all.
    #[must_use]
    pub fn disk(&self) -> Option<&DiskWatch> {
        self.disk.as_ref()
    }

    /// Pauses every run before its next step. No effect after a cancellation.
    pub fn pause(&self) {
        let mut state = self.state();
        if self.is(GOING) {
            self.signal.store(PAUSED, Ordering::Relaxed);
            state.clock.stop();
        }
    }

    /// Resumes every paused run. No effect after a cancellation.
    pub fn resume(&self) {
        let mut state = self.state();
        if self.is(PAUSED) {
            self.signal.store(GOING, Ordering::Relaxed);
            if state.runs > 0 {
                state.clock.start();
            }
            self.changed.notify_all();
        }
    }

    /// Stops every run before its next step. Finished runs are kept; of unfinished ones,
    /// checkpoints if the execution writes them.
    /// A cancellation cannot be undone.
    pub fn cancel(&self) {
        let _state = self.state();
        self.signal.store(CANCELLED, Ordering::Relaxed);
        self.changed.notify_all();
    }

    /// Returns whether the experiment is paused.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.is(PAUSED)
    }

    /// Returns whether the experiment was cancelled.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.is(CANCELLED)
    }

    /// Returns the progress of the execution.
    #[must_use]
    pub fn progress(&self) -> Progress {
        let state = self.state();
        let running: Vec<(&CurrentRun, f64)> = state
            .running
            .values()
            .map(|run| {
                let steps = run.counter.0.load(Ordering::Relaxed);
                (run, steps as f64 / run.steps.max(1) as f64)
            })
            .collect();
        let current: f64 = running.iter().map(|(run, share)| run.cost * share).sum();
        // An empty sum of floats is -0, and so is `-0 + -0`.
        let done = 0.0 + state.cost_finished + current;
        let elapsed = state.clock.read();
        let gained = done - state.cost_before;
        let left_secs = (elapsed > MIN_ELAPSED && gained > 0.0)
            .then(|| elapsed.as_secs_f64() * f64::max(state.cost - done, 0.0) / gained);
        Progress {
            runs: state.runs,
            finished: state.finished,
            faulted: state.faulted,
            share: match state.cost > 0.0 {
                true => f64::min(done / state.cost, 1.0),
                false => 0.0,
            },
            elapsed_secs: elapsed.as_secs_f64(),
            left_secs,
            running: running
                .into_iter()
                .map(|(run, share)| (run.name.clone(), share))
                .collect(),
        }
    }

    /// Starts an execution. `costs` are those of all runs and of the finished ones.
    pub(super) fn begin(&self, runs: usize, finished: usize, faulted: usize, costs: [f64; 2]) {
        let mut state = self.state();
        let [cost, cost_before] = costs;
        *state = ProgressState {
            runs,
            finished,
            faulted,
            cost,
            cost_before,
            cost_finished: cost_before,
            ..ProgressState::default()
        };
        if self.is(GOING) {
            state.clock.start();
        }
    }

    /// Ends the execution and returns the names of the runs that are still marked as current.
    pub(super) fn end(&self) -> Vec<String> {
        let mut state = self.state();
        state.clock.stop();
        let left = std::mem::take(&mut state.running).into_values();
        left.map(|run| run.name).collect()
    }

    /// Marks a run as current.
    pub(super) fn begin_run(
        &self,
        index: usize,
        name: &str,
        steps: u64,
        cost: f64,
    ) -> RunHandle<'_> {
        let counter = Arc::new(Counter::default());
        let run = CurrentRun {
            name: name.to_owned(),
            steps,
            cost,
            counter: counter.clone(),
        };
        self.state().running.insert(index, run);
        RunHandle {
            control: self,
            counter,
        }
    }

    /// Counts a current run as finished.
    pub(super) fn end_run(&self, index: usize, is_faulted: bool) {
        let mut state = self.state();
        let run = state.running.remove(&index);
        state.cost_finished += run.map_or(0.0, |run| run.cost);
        state.finished += 1;
        state.faulted += usize::from(is_faulted);
    }

    /// Removes a current run that was cancelled.
    pub(super) fn drop_run(&self, index: usize) {
        self.state().running.remove(&index);
    }

    fn is(&self, signal: u8) -> bool {
        self.signal.load(Ordering::Relaxed) == signal
    }

    fn state(&self) -> MutexGuard<'_, ProgressState> {
        // Poisoning is ignored: no result depends on this state.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Blocks while the experiment is paused. Returns false if it was cancelled.
    #[cold]
    fn wait(&self) -> bool {
        let state = self.state();
        let state = self.changed.wait_while(state, |_| self.is(PAUSED));
        drop(state);
        self.is(GOING)
    }
}

impl RunHandle<'_> {
    /// Returns the disk space that the execution may use; none if it may use all.
    pub fn disk(&self) -> Option<&DiskWatch> {
        self.control.disk()
    }

    /// Stores the number of steps taken. Blocks while the experiment is paused. Returns false if it
    /// was cancelled.
    #[inline]
    pub fn report_steps(&self, steps: u64) -> bool {
        self.counter.0.store(steps, Ordering::Relaxed);
        self.control.is(GOING) || self.control.wait()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sets the time of the execution so far.
    fn after(control: &ExecutionControl, elapsed: Duration) {
        let mut state = control.state();
        state.clock = Clock {
            past: elapsed,
            since: None,
        };
    }

    #[test]
    fn progress_counts_the_steps_of_current_runs_and_estimates_the_remaining_time() {
        let control = ExecutionControl::new();
        assert_eq!(control.progress(), Progress::default());
        // Runs of 100 s in all, of which runs of 20 s were finished before.
        control.begin(5, 1, 0, [100.0, 20.0]);
        let handle = control.begin_run(1, "a", 10, 40.0);
        let other = control.begin_run(2, "b", 10, 30.0);
        after(&control, Duration::from_secs(10));
        assert_eq!(control.progress().left_secs, None, "nothing is gained");
        assert!(handle.report_steps(5) && other.report_steps(1));
        let progress = control.progress();
        assert_eq!(
            (progress.runs, progress.finished, progress.faulted),
            (5, 1, 0)
        );
        let running = [("a".to_owned(), 0.5), ("b".to_owned(), 0.1)];
        assert_eq!(progress.running, running);
        // 20 + 40/2 + 30/10 of 100 are done, and 23 were gained in 10 s.
        assert_eq!((progress.share, progress.elapsed_secs), (0.43, 10.0));
        let left = progress.left_secs.unwrap_or_default();
        assert!((left - 10.0 * 57.0 / 23.0).abs() < 1e-12, "{left}");
        after(&control, MIN_ELAPSED);
        assert_eq!(control.progress().left_secs, None, "it is too early");

        after(&control, Duration::from_secs(10));
        control.end_run(1, true);
        control.drop_run(2);
        let progress = control.progress();
        assert_eq!(
            (progress.finished, progress.faulted, progress.share),
            (2, 1, 0.6)
        );
        assert_eq!(progress.left_secs, Some(10.0));
        assert!(progress.running.is_empty());
    }

    #[test]
    fn the_end_names_the_runs_that_are_current_and_stops_the_clock() {
        let control = ExecutionControl::new();
        control.begin(3, 0, 0, [3.0, 0.0]);
        assert!(control.state().clock.since.is_some());
        for (index, name) in ["a", "b", "c"].into_iter().enumerate() {
            control.begin_run(index, name, 1, 1.0);
        }
        control.end_run(1, false);
        assert_eq!(control.end(), ["a", "c"]);
        assert!(control.state().clock.since.is_none());
        assert!(control.progress().running.is_empty() && control.end().is_empty());
    }

    #[test]
    fn the_clock_stops_while_paused_and_cancellation_is_final() {
        let control = ExecutionControl::new();
        control.begin(1, 0, 0, [1.0, 0.0]);
        let is_running = |control: &ExecutionControl| control.state().clock.since.is_some();
        control.pause();
        assert!(control.is_paused() && !is_running(&control));
        control.pause();
        control.resume();
        assert!(!control.is_paused() && is_running(&control));
        let handle = control.begin_run(0, "a", 1, 1.0);
        assert!(handle.report_steps(0));
        control.cancel();
        assert!(control.is_cancelled() && !handle.report_steps(0));
        control.pause();
        control.resume();
        assert!(control.is_cancelled() && !control.is_paused());

        // An empty sum of costs is -0, which is not a share.
        let control = ExecutionControl::new();
        control.begin(1, 0, 0, [1.0, [].iter().sum()]);
        assert!(control.progress().share.is_sign_positive());

        // An execution that begins paused has no running clock.
        let control = ExecutionControl::new();
        control.pause();
        control.begin(1, 0, 0, [1.0, 0.0]);
        assert!(!is_running(&control));
        control.resume();
        assert!(is_running(&control));
    }
}
