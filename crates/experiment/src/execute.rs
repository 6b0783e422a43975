//! Executes the unfinished runs of an experiment on several threads.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::thread;

use jostle_physics::model::ContactRule;
use thiserror::Error;

use crate::control::Control;
use crate::folder::{Folder, FolderError};
use crate::plan::{Plan, Point};
use crate::run::{Finished, conduct};

/// Nice value of an experiment's threads, so that live swarms have priority.
const NICENESS: i32 = 10;

/// Why an experiment failed.
#[derive(Debug, Error)]
pub enum ExecuteError {
    /// Results could not be written.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// A thread could not be started.
    #[error("no thread can be started: {0}")]
    NoThread(std::io::Error),
    /// Runs panicked: a bug in the program.
    #[error("run {runs:?} panicked: please report it with the experiment's file")]
    Panicked {
        /// The runs that panicked.
        runs: Vec<String>,
    },
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
}

/// Executes every run of `plan` that is not finished in `folder`, and writes the tables.
///
/// The runs with the longest expected time start first, so that threads end at about the same time.
/// No row depends on this order or on the number of threads.
///
/// # Errors
///
/// [`ExecuteError`]. Finished runs are kept.
pub fn execute(
    plan: &Plan,
    folder: &mut Folder,
    threads: usize,
    control: &Control,
) -> Result<Outcome, ExecuteError> {
    let runs = plan.runs();
    let costs: Vec<f64> = runs
        .iter()
        .map(|run| expected_secs(plan.point(run)))
        .collect();
    let is_finished: Vec<bool> = runs.iter().map(|run| folder.is_finished(run)).collect();
    let sum = |is_counted: &dyn Fn(usize) -> bool| -> f64 {
        let indices = (0..runs.len()).filter(|&index| is_counted(index));
        indices.map(|index| costs[index]).sum()
    };
    let done = is_finished.iter().filter(|&&it| it).count();
    let sums = [sum(&|_| true), sum(&|index| is_finished[index])];
    control.begin(runs.len(), done, folder.faults(plan).len(), sums);
    let mut left: Vec<usize> = (0..runs.len()).filter(|&it| !is_finished[it]).collect();
    left.sort_by(|&one, &other| costs[other].total_cmp(&costs[one]));

    let next = AtomicUsize::new(0);
    let (finished, received) = mpsc::channel();
    let work = |finished: mpsc::Sender<(usize, Finished)>| {
        // None is the calling thread. If the call is not permitted, the nice value is unchanged.
        let _ = rustix::process::setpriority_process(None, NICENESS);
        while let Some(&index) = left.get(next.fetch_add(1, Ordering::Relaxed)) {
            let run = &runs[index];
            let steps = plan.point(run).steps;
            let watch = control.begin_run(index, &run.name, steps, costs[index]);
            let result = match watch.go_on(0) {
                true => conduct(plan, run, |steps| watch.go_on(steps)),
                false => None,
            };
            let Some(result) = result else {
                control.drop_run(index);
                return;
            };
            control.end_run(index, result.fault.is_some());
            if finished.send((index, result)).is_err() {
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
            Ok(_) => write_finished(plan, folder, &received),
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
    written?;
    folder.write_tables(plan)?;
    if !panicked.is_empty() {
        return Err(ExecuteError::Panicked { runs: panicked });
    }
    let finished = runs.iter().filter(|run| folder.is_finished(run)).count();
    Ok(Outcome {
        runs: runs.len(),
        finished,
        faults: folder.faults(plan),
        is_cancelled: finished < runs.len(),
    })
}

/// Appends finished runs to the folder, in batches of all runs received so far, until all threads
/// have ended.
fn write_finished(
    plan: &Plan,
    folder: &mut Folder,
    received: &Receiver<(usize, Finished)>,
) -> Result<(), FolderError> {
    while let Ok(first) = received.recv() {
        let batch = [first].into_iter().chain(received.try_iter()).collect();
        folder.append(plan, batch)?;
    }
    Ok(())
}

/// Estimates the time of a run, in seconds of one core.
///
/// Only the order of the runs and the reported progress depend on it. Measured for n from 3 to 74,
/// π1 from 1 to 8, and the rules `endpoints` and `closest`: correct within a factor of 2, and
/// within 3 for small or round bodies under `closest`, whose longer steps have more contacts.
fn expected_secs(point: &Point) -> f64 {
    let n = point.spec.n as f64;
    let parameters = &point.spec.parameters;
    let step = 0.5 + 0.2 * n + 0.003 * n * n;
    let rule_factor = match parameters.contacts {
        ContactRule::Closest if parameters.pi1 > 1.0 => 1.0 + n / 20.0,
        _ => 1.0,
    };
    let programs = if parameters.relinearise { 2.0 } else { 1.0 };
    point.steps as f64 * 1e-6 * step * rule_factor * programs
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::fs;
    use std::path::Path;
    use std::time::{Duration, Instant};

    use jostle_results::Measure;

    use super::*;

    const FILE: &str = "name = \"a\"\nreplicates = 3\nduration = 20\n[[grid]]\npi1 = [1, 4]\n\
                        n = [3, 15]\n";

    fn table(folder: &Path) -> Vec<u8> {
        fs::read(folder.join("results.csv")).unwrap()
    }

    /// Executes `plan` in a new folder and returns the bytes of its table.
    fn executed(plan: &Plan, threads: usize) -> Vec<u8> {
        let directory = tempfile::tempdir().unwrap();
        let mut folder = Folder::open(directory.path(), plan).unwrap();
        let control = Control::new();
        let outcome = execute(plan, &mut folder, threads, &control).unwrap();
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
        let control = Control::new();
        control.pause();
        let outcome = thread::scope(|scope| {
            let (plan, folder, control) = (&plan, &mut folder, &control);
            let executing = scope.spawn(move || execute(plan, folder, 2, control).unwrap());
            // Paused before the execution started: no run takes a step.
            wait_until("two runs", || control.progress().running.len() == 2);
            assert_eq!(control.progress().share, 0.0);
            assert!(control.is_paused() && control.progress().left_secs.is_none());
            control.resume();
            wait_until("a finished run", || control.progress().finished > 0);
            control.pause();
            thread::sleep(Duration::from_millis(20));
            let paused = control.progress();
            thread::sleep(Duration::from_millis(50));
            let later = control.progress();
            assert_eq!(
                (later.share, later.elapsed_secs),
                (paused.share, paused.elapsed_secs)
            );
            assert!(later.share > 0.0 && later.share < 1.0);
            control.cancel();
            control.resume();
            executing.join().unwrap()
        });
        assert!(control.is_cancelled() && outcome.is_cancelled);
        assert!((1..12).contains(&outcome.finished), "{outcome:?}");
        let part = table(directory.path());
        let rows = part.iter().filter(|&&byte| byte == b'\n').count() - 1;
        assert_eq!(rows, outcome.finished);

        let control = Control::new();
        let outcome = execute(&plan, &mut folder, 1, &control).unwrap();
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
        let control = Control::new();
        let outcome = execute(&plan, &mut folder, 2, &control).unwrap();
        assert!(!outcome.faults.is_empty(), "no run ended early");
        assert_eq!(control.progress().faulted, outcome.faults.len());
        let (name, reason) = &outcome.faults[0];
        assert!(reason.contains("cross"), "{reason}");
        let rows = folder.rows(&plan);
        let row = rows.iter().find(|row| row.run == *name).unwrap();
        assert!(row.time < 40.0 && row.steps > 0 && row.number(Measure::V) > 0.0);
    }
}
