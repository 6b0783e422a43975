//! Executes the unfinished runs of an experiment on several threads.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use jostle_physics::model::State;
use thiserror::Error;

use crate::folder::{Checkpoints, Folder, FolderError};
use crate::plan::Plan;
use crate::progress::{ExecutionControl, RunHandle};
use crate::run::{FinishedRun, RecordedHashes, Recorder, execute_run_from};
use crate::series::{SeriesKind, SeriesRecording};
use crate::subset::Subset;
use crate::trajectory::{Recording, Trajectories, trajectory_file};

/// Nice value of an experiment's threads, so that live swarms have priority, also those without a rate.
const NICENESS: i32 = 12;

/// Why an experiment failed.
#[derive(Debug, Error)]
pub enum ExecuteError {
    /// Results could not be written.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// A thread could not be started.
    #[error("no thread can be started: {0}")]
    NoThread(std::io::Error),
    /// The disk space that the execution may use has ended. Runs have checkpoints, if the execution
    /// writes them.
    #[error("{0}")]
    NoRoom(String),
    /// Runs panicked: a bug in the program.
    #[error("run {runs:?} panicked: please report it with the experiment's file")]
    Panicked {
        /// The runs that panicked.
        runs: Vec<String>,
    },
}

impl ExecuteError {
    /// Returns whether the execution can continue once there is more disk space.
    #[must_use]
    pub fn is_disk_full(&self) -> bool {
        match self {
            Self::Folder(error) => error.is_disk_full(),
            Self::NoRoom(_) => true,
            Self::NoThread(_) | Self::Panicked { .. } => false,
        }
    }
}

/// The outcome of one execution of an experiment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// Number of runs of the experiment.
    pub runs: usize,
    /// Number of finished runs.
    pub finished: usize,
    /// The names of the runs that ended early, each with its reason.
    pub faults: Vec<(String, String)>,
    /// Whether the execution was cancelled before all runs were finished.
    pub is_cancelled: bool,
    /// Why a checkpoint could not be written, if one could not. No result depends on it.
    pub checkpoint_error: Option<String>,
}

/// Which runs to execute, and how.
#[derive(Clone, Copy, Debug)]
pub struct Execution<'a> {
    /// The experiment.
    pub plan: &'a Plan,
    /// Its runs that are executed.
    pub subset: &'a Subset,
    /// Number of runs at a time.
    pub threads: usize,
    /// The time between two checkpoints of a run; none if no checkpoints are written. With it, a
    /// cancellation writes one of every current run.
    pub checkpoint_every: Option<Duration>,
}

/// Executes every run of a subset that is not finished in `folder`, and writes the tables of the
/// folder. A run that has a checkpoint there continues from it.
///
/// The runs with the longest expected time start first, so that threads end at about the same time.
/// No row depends on this order or on the number of threads.
///
/// # Errors
///
/// [`ExecuteError`]. Finished runs are kept.
pub fn execute(
    execution: Execution<'_>,
    folder: &mut Folder,
    control: &ExecutionControl,
) -> Result<Outcome, ExecuteError> {
    // Of a folder that an earlier version began.
    let mut earlier = None;
    if folder.definitions() != execution.plan.definitions {
        let plan = earlier.insert(execution.plan.clone());
        plan.definitions = folder.definitions();
    }
    let plan = earlier.as_ref().unwrap_or(execution.plan);
    let execution = Execution { plan, ..execution };
    let Execution {
        subset, threads, ..
    } = execution;
    // A process that was killed left them.
    folder.remove_unused();
    let has_room = |bytes| control.disk().is_none_or(|disk| disk.has_room(bytes));
    if !has_room(0) {
        return Err(no_room(control));
    }
    let runs = plan.runs();
    let cost = |index: usize| plan.point(&runs[index]).expected_secs();
    let (done, mut left): (Vec<usize>, Vec<usize>) = subset
        .indices()
        .iter()
        .partition(|&&index| folder.is_finished(index));
    // An empty sum of floats is -0.
    let sum = |indices: &[usize]| 0.0 + indices.iter().map(|&index| cost(index)).sum::<f64>();
    let costs = [sum(subset.indices()), sum(&done)];
    let faults = folder.faults(subset).len();
    control.begin(subset.indices().len(), done.len(), faults, costs);
    left.sort_by(|&one, &other| cost(other).total_cmp(&cost(one)));

    let next = AtomicUsize::new(0);
    let (finished, received) = mpsc::channel();
    let (checkpoints, trajectories) = (folder.checkpoints(), folder.trajectories());
    let (path, unwritten) = (&folder.path().to_owned(), Mutex::new(None));
    let work = |finished: mpsc::Sender<Executed>| {
        // None is the calling thread. If the call is not permitted, the nice value is unchanged.
        let _ = rustix::process::setpriority_process(None, NICENESS);
        while let Some(&index) = left.get(next.fetch_add(1, Ordering::Relaxed)) {
            let run = &runs[index];
            let steps = plan.point(run).steps;
            let handle = control.begin_run(index, &run.name, steps, cost(index));
            let result = match handle.report_steps(0) {
                true => {
                    let files = (path.as_path(), &checkpoints, &trajectories);
                    execute_with_checkpoints(execution, index, files, &handle, &unwritten)
                }
                false => Ok(None),
            };
            let result = match result {
                Ok(Some(result)) => Ok((index, result)),
                Ok(None) => return control.drop_run(index),
                Err(error) => Err(error),
            };
            match &result {
                Ok((_, it)) => control.end_run(index, it.fault.is_some()),
                Err(_) => control.drop_run(index),
            }
            if finished.send(result).is_err() {
                return;
            }
        }
    };
    let written = thread::scope(|scope| {
        let workers: Result<Vec<_>, _> = (0..threads.clamp(1, left.len().max(1)))
            .map(|number| {
                let (work, finished) = (&work, finished.clone());
                thread::Builder::new()
                    .name(format!("run-{number}"))
                    .spawn_scoped(scope, move || work(finished))
            })
            .collect();
        drop(finished);
        let written = match &workers {
            Ok(_) => write_finished(plan, folder, control, &received),
            Err(_) => Ok(()),
        };
        if written.is_err() || workers.is_err() {
            control.cancel();
        }
        drop(received);
        // A panic is detected below: its run is still marked as running.
        for worker in workers.map_err(ExecuteError::NoThread)? {
            let _ = worker.join();
        }
        written.map_err(ExecuteError::from)
    });
    let panicked = control.end();
    if folder.finished() < runs.len() {
        folder.remove_unused();
    }
    written?;
    if !has_room(folder.table_bytes()) {
        return Err(no_room(control));
    }
    folder.write_tables(plan)?;
    if !panicked.is_empty() {
        return Err(ExecuteError::Panicked { runs: panicked });
    }
    if folder.finished() == runs.len() {
        folder.clear();
    }
    let unwritten = unwritten
        .into_inner()
        .unwrap_or_else(PoisonError::into_inner);
    let is_finished = |index: &&usize| folder.is_finished(**index);
    let finished = subset.indices().iter().filter(is_finished).count();
    Ok(Outcome {
        runs: subset.indices().len(),
        finished,
        faults: folder.faults(subset),
        is_cancelled: finished < subset.indices().len(),
        checkpoint_error: unwritten.map(|error| error.to_string()),
    })
}

/// A run that ended, with its index in the plan, or the error of reading its checkpoint.
type Executed = Result<(usize, FinishedRun), FolderError>;

/// The files to which a run that is executed writes.
pub(crate) struct RunRecorder<'a> {
    pub trajectory: Option<&'a Recording>,
    pub series: &'a SeriesRecording,
}

impl Recorder for RunRecorder<'_> {
    fn add_frame(&self, state: &State) {
        if let Some(trajectory) = self.trajectory {
            trajectory.add(state);
        }
    }

    fn add_rows(&self, kind: SeriesKind, rows: &[u8], earlier: u64) {
        self.series.add(kind, rows, earlier);
    }
}

/// Executes a run from its last checkpoint. The result is none if the execution was cancelled. The
/// last error of writing a checkpoint is stored in `unwritten`, and the run goes on.
fn execute_with_checkpoints(
    execution: Execution<'_>,
    index: usize,
    (folder, checkpoints, trajectories): (&Path, &Checkpoints, &Trajectories),
    handle: &RunHandle<'_>,
    unwritten: &Mutex<Option<FolderError>>,
) -> Result<Option<FinishedRun>, FolderError> {
    let Execution {
        plan,
        checkpoint_every,
        ..
    } = execution;
    let run = &plan.runs()[index];
    let mut checkpoint = checkpoints.read(index)?;
    let recording = trajectories.record(plan, index, &mut checkpoint)?;
    let series = SeriesRecording::of(folder, index, &mut checkpoint);
    let recorder = RunRecorder {
        trajectory: recording.as_ref(),
        series: &series,
    };
    let has_failed =
        || series.has_failed() || recording.as_ref().is_some_and(Recording::has_failed);
    let recorded = || series.length() + recording.as_ref().map_or(0, Recording::length);
    let (mut last, mut length) = (Instant::now(), recorded());
    let steps = plan.point(run).steps;
    let mut has_room = |is_last: bool| {
        let Some(disk) = handle.disk() else {
            return true;
        };
        let before = length;
        length = recorded();
        // At the end of the run its rows are copied: without the space for that it ends here.
        let is_copied = is_last && length > 0;
        disk.add(length.saturating_sub(before)) && (!is_copied || disk.has_room(length))
    };
    let mut finished = execute_run_from(plan, run, checkpoint, Some(&recorder), |current| {
        let continues = handle.report_steps(current.steps()) && has_room(current.steps() == steps);
        if checkpoint_every.is_some_and(|every| !continues || last.elapsed() >= every) {
            current.pass_rows(&recorder);
            has_room(false);
            series.sync();
            let mut checkpoint = current.checkpoint();
            // Without its frames a checkpoint is of no use.
            checkpoint.recorded = recording.as_ref().and_then(Recording::sync);
            checkpoint.hashes = RecordedHashes {
                frames: recording.as_ref().map(Recording::hash),
                rows: series.hashes(),
            };
            if !has_failed()
                && let Err(error) = checkpoints.write(index, &checkpoint)
            {
                *unwritten.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
            }
            last = Instant::now();
        }
        continues && !has_failed()
    });
    // Those that were recorded at the end.
    has_room(false);
    if let Some(recording) = recording {
        match &mut finished {
            Some(finished) => {
                let (has_row, disk) = (finished.row.is_some(), handle.disk());
                let Some(length) = recording.finish(plan, run, has_row, disk)? else {
                    return Ok(None);
                };
                let files = length.map(|length| (trajectory_file(index), length));
                finished.files.extend(files);
            }
            None => recording.check()?,
        }
    }
    match &mut finished {
        Some(finished) => {
            let (has_row, disk) = (finished.row.is_some(), handle.disk());
            let Some(files) = series.finish(plan, run, has_row, disk)? else {
                return Ok(None);
            };
            finished.files.extend(files);
        }
        None => series.check()?,
    }
    Ok(finished)
}

/// Appends finished runs to the folder, in batches of all runs received so far, until all threads
/// have ended.
fn write_finished(
    plan: &Plan,
    folder: &mut Folder,
    control: &ExecutionControl,
    received: &Receiver<Executed>,
) -> Result<(), FolderError> {
    while let Ok(first) = received.recv() {
        let mut batch = Vec::new();
        let mut failed = Ok(());
        for executed in [first].into_iter().chain(received.try_iter()) {
            match executed {
                Ok(finished) => batch.push(finished),
                Err(error) => failed = Err(error),
            }
        }
        let length = folder.length();
        folder.append(plan, batch)?;
        if let Some(disk) = control.disk() {
            disk.add(folder.length() - length);
        }
        failed?;
    }
    Ok(())
}

fn no_room(control: &ExecutionControl) -> ExecuteError {
    let reason = control.disk().and_then(|disk| disk.reason());
    ExecuteError::NoRoom(reason.unwrap_or_default().to_owned())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use jostle_results::Measure;
    use std::fs;
    use std::path::Path;

    use super::*;
    use crate::progress::Progress;

    const FILE: &str = "name = \"a\"\nreplicates = 3\nduration = 20\n[[grid]]\npi1 = [1, 4]\n\
                        n = [3, 15]\n";

    fn table(folder: &Path) -> Vec<u8> {
        fs::read(folder.join("results.csv")).unwrap()
    }

    fn execute_all(
        plan: &Plan,
        folder: &mut Folder,
        threads: usize,
        control: &ExecutionControl,
    ) -> Outcome {
        let execution = Execution {
            plan,
            subset: &Subset::all(plan),
            threads,
            checkpoint_every: None,
        };
        execute(execution, folder, control).unwrap()
    }

    /// Executes `plan` in a new folder and returns the bytes of its table.
    fn executed(plan: &Plan, threads: usize) -> Vec<u8> {
        let directory = tempfile::tempdir().unwrap();
        let mut folder = Folder::open(directory.path(), plan).unwrap();
        let control = ExecutionControl::new();
        let outcome = execute_all(plan, &mut folder, threads, &control);
        assert_eq!((outcome.runs, outcome.finished), (12, 12));
        assert!(outcome.faults.is_empty() && !outcome.is_cancelled);
        let progress = control.progress();
        assert_eq!((progress.finished, progress.faulted), (12, 0));
        assert!((progress.share - 1.0).abs() < 1e-12 && progress.running.is_empty());
        table(directory.path())
    }

    fn wait_until(condition: &str, is_true: impl Fn() -> bool) {
        let began = Instant::now();
        while !is_true() {
            assert!(
                began.elapsed() < Duration::from_secs(60),
                "timed out waiting for {condition}"
            );
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn rows_do_not_depend_on_the_number_of_threads() {
        let plan = Plan::parse(FILE).unwrap();
        let expected = executed(&plan, 1);
        for threads in [0, 2, 5, 100] {
            assert_eq!(executed(&plan, threads), expected, "{threads} threads");
        }
    }

    #[test]
    fn a_paused_experiment_takes_no_steps_and_a_cancelled_one_can_be_resumed() {
        let plan = Plan::parse(FILE).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let mut folder = Folder::open(directory.path(), &plan).unwrap();
        let control = ExecutionControl::new();
        control.pause();
        let (outcome, paused, later) = thread::scope(|scope| {
            let (plan, folder, control) = (&plan, &mut folder, &control);
            let executing = scope.spawn(move || execute_all(plan, folder, 2, control));
            // Paused before the execution started: no run takes a step.
            wait_until("two runs", || control.progress().running.len() == 2);
            assert_eq!(control.progress().share, 0.0);
            assert!(control.is_paused() && control.progress().left_secs.is_none());
            control.resume();
            wait_until("a finished run", || control.progress().finished > 0);
            control.pause();
            let paused = control.progress();
            thread::sleep(Duration::from_millis(50));
            let later = control.progress();
            // A failed assertion in here would wait for the paused threads.
            control.cancel();
            control.resume();
            (executing.join().unwrap(), paused, later)
        });
        assert_eq!(later.elapsed_secs, paused.elapsed_secs);
        // Each of the two threads ends the step that it was in. A run has 1000 steps.
        let steps = |it: &Progress| {
            let current: f64 = it.running.iter().map(|(_, share)| share).sum();
            1000.0 * (it.finished as f64 + current)
        };
        assert!(steps(&later) - steps(&paused) < 2.5, "{paused:?} {later:?}");
        assert!(later.share > 0.0 && later.share < 1.0);
        assert!(control.is_cancelled() && outcome.is_cancelled);
        assert!((1..12).contains(&outcome.finished), "{outcome:?}");
        let part = table(directory.path());
        let rows = part.iter().filter(|&&byte| byte == b'\n').count() - 1;
        assert_eq!(rows, outcome.finished);

        let control = ExecutionControl::new();
        let outcome = execute_all(&plan, &mut folder, 1, &control);
        assert_eq!((outcome.finished, outcome.is_cancelled), (12, false));
        assert_eq!(table(directory.path()), executed(&plan, 1));
    }

    #[test]
    fn runs_that_end_early_are_counted_and_reported() {
        // With nearly the longest allowed step and a low rotational drag some axes cross.
        let text = "name = \"a\"\nreplicates = 4\nduration = 40\n[spec]\nn = 30\npi1 = 2\n\
                    pi4 = 1000\ndt = 0.3";
        let plan = Plan::parse(text).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let mut folder = Folder::open(directory.path(), &plan).unwrap();
        let control = ExecutionControl::new();
        let outcome = execute_all(&plan, &mut folder, 2, &control);
        assert!(!outcome.faults.is_empty(), "no run ended early");
        assert_eq!(control.progress().faulted, outcome.faults.len());
        let (name, reason) = &outcome.faults[0];
        assert!(reason.contains("cross"), "{reason}");
        let rows = folder.rows();
        let row = rows.iter().find(|row| row.run == *name).unwrap();
        assert!(row.time < 40.0 && row.steps > 0 && row.number(Measure::V) > 0.0);
    }
}
