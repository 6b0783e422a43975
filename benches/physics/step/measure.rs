//! Measures every phase and backend on one settled group.
//!
//! The clock is the thread's CPU time. A sample consists of enough passes over all recorded steps
//! to be measured accurately. Samples of all phases and backends alternate, so that a slow period
//! of the machine affects all of them. The quickest sample of each counts.

use std::time::Duration;

use jostle_physics::model::State;
use jostle_physics::model::simd::Level;
use jostle_physics::stepper::Stepper;
use rustix::time::{ClockId, clock_gettime};

use super::arguments::Arguments;
use super::backend::{Backend, Quality, Solver};
use super::outsiders;
use super::phases::Phases;
use super::rapier;
use super::record::{Recorded, record};
use super::settled::Case;
use super::table::Row;

/// Minimum duration of a sample: a thousand times that of reading the clock.
const MIN_SAMPLE: Duration = Duration::from_millis(4);

/// Samples of each task.
const SAMPLES: usize = 9;

/// A task whose pass takes longer than this averages over variations of the machine and needs fewer
/// samples.
const SLOW: Duration = Duration::from_secs(1);
const SLOW_SAMPLES: usize = 2;

/// Maximum number of programs that are solved in another process.
const MAX_EXTERNAL: usize = 20;

/// A measured task.
struct Task<'a> {
    /// The backend; none for a phase.
    backend: Option<Backend>,
    /// Processes all recorded steps once and returns the CPU time.
    pass: Box<dyn FnMut() -> Duration + 'a>,
    /// The least time of a pass.
    best: Duration,
}

/// Returns the CPU time of the thread.
pub fn cpu_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    let seconds = u64::try_from(now.tv_sec).expect("CPU time is positive");
    let nanoseconds = u32::try_from(now.tv_nsec).expect("nanoseconds are below a billion");
    Duration::new(seconds, nanoseconds)
}

/// Returns the number of successive steps that are recorded.
fn steps(n: usize, quick: bool) -> usize {
    let steps: usize = match n {
        0..=120 => 200,
        121..=300 => 100,
        301..=700 => 40,
        701..=1500 => 20,
        _ => 10,
    };
    if quick { steps.div_ceil(5) } else { steps }
}

/// Measures one group. Returns a row for each backend that is selected and installed.
pub fn measure(case: Case, arguments: &Arguments) -> Vec<Row> {
    let count = steps(case.n, arguments.quick);
    // Only rapier needs the first steps: the other backends keep no data besides those in the
    // record.
    let all = record(case.settled(), rapier::WARMING + count);
    let records = &all[rapier::WARMING..];
    let start = records[0].state.clone();
    let truth = exact_displacements(records);

    let mut rows: Vec<Row> = Vec::new();
    let level = arguments.level();
    let mut tasks = phases(records, &start, level);
    for backend in [Backend::Exact, Backend::Fallback, Backend::Clarabel] {
        // The exact solver is always measured: the step time of another backend is that of the
        // exact one with the time of the solution replaced.
        if !arguments.selects(backend) && backend != Backend::Exact {
            continue;
        }
        let mut solver = Solver::new(backend, level).expect("the backend runs in this process");
        if arguments.selects(backend) {
            rows.push(Row::new(
                &start,
                backend,
                quality_of(&mut solver, records, &truth),
            ));
        }
        tasks.push(Task::of(Some(backend), move || {
            records.iter().for_each(|recorded| solver.solve(recorded));
        }));
    }
    if arguments.selects(Backend::Rapier) {
        let (run, alone) = rapier::Run::new(&start, count, arguments.sweeps);
        let quality = rapier::quality_of(&all, &truth, arguments.sweeps);
        let mut row = Row::new(&start, Backend::Rapier, quality);
        row.alone = Some(alone);
        rows.push(row);
        tasks.push(Task {
            backend: Some(Backend::Rapier),
            pass: Box::new(move || run.repeat()),
            best: Duration::MAX,
        });
    }
    sample(&mut tasks, arguments.quick);

    let microseconds = |task: usize| 1e6 * tasks[task].best.as_secs_f64() / count as f64;
    let [attraction, assembly, whole, exact] = [0, 1, 2, 3].map(microseconds);
    for row in &mut rows {
        row.attraction_us = attraction;
        let task = tasks
            .iter()
            .position(|task| task.backend == Some(row.backend));
        let own = microseconds(task.expect("every row has a task"));
        if row.backend == Backend::Rapier {
            row.step_us = own;
            continue;
        }
        row.contacts_us = Some(assembly);
        row.qp_us = Some(own);
        row.step_us = whole - exact + own;
    }
    let external = &records[..count.min(MAX_EXTERNAL)];
    for backend in [Backend::Daqp, Backend::Piqp] {
        let answers = outsiders::measure(backend, case, external, arguments);
        if let Some(answers) = answers {
            let mut row = Row::new(&start, backend, answers.quality(external, &truth));
            row.attraction_us = attraction;
            row.contacts_us = Some(assembly);
            row.qp_us = Some(answers.microseconds);
            row.step_us = whole - exact + answers.microseconds;
            rows.push(row);
        }
    }
    rows
}

impl<'a> Task<'a> {
    fn of(backend: Option<Backend>, mut work: impl FnMut() + 'a) -> Self {
        let pass = move || {
            let began = cpu_time();
            work();
            cpu_time() - began
        };
        Self {
            backend,
            pass: Box::new(pass),
            best: Duration::MAX,
        }
    }
}

/// Returns three tasks: attraction; the assembly of the program; and the step without attraction.
fn phases<'a>(records: &'a [Recorded], start: &'a State, level: Level) -> Vec<Task<'a>> {
    let (mut one, mut other) = (Phases::at(level), Phases::at(level));
    let mut stepper = Stepper::with_level(level);
    vec![
        Task::of(None, move || {
            records
                .iter()
                .for_each(|recorded| one.attraction(&recorded.state));
        }),
        Task::of(None, move || {
            records
                .iter()
                .for_each(|recorded| other.assemble(&recorded.state, &recorded.pull));
        }),
        // The steps from the first state are the recorded ones, to the bit.
        Task::of(None, move || {
            let mut state = start.clone();
            for Recorded { pull, .. } in records {
                stepper
                    .advance(&mut state, pull)
                    .expect("every step is solved");
            }
        }),
    ]
}

/// Measures all tasks in turn, once per sample.
fn sample(tasks: &mut [Task], quick: bool) {
    let passes: Vec<u32> = tasks
        .iter_mut()
        .map(|task| {
            let once = (task.pass)();
            if once > SLOW {
                task.best = once;
            }
            let many = MIN_SAMPLE.as_secs_f64() / once.as_secs_f64().max(1e-9);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a small positive number"
            )]
            let many = many.ceil().max(1.0) as u32;
            many
        })
        .collect();
    let samples = if quick { SAMPLES.div_ceil(3) } else { SAMPLES };
    for sample in 0..samples {
        for (task, &passes) in tasks.iter_mut().zip(&passes) {
            if task.best != Duration::MAX && task.best > SLOW && sample + 1 >= SLOW_SAMPLES {
                continue;
            }
            let sum: Duration = (0..passes).map(|_| (task.pass)()).sum();
            task.best = task.best.min(sum / passes);
        }
    }
}

/// Returns the exact displacements of each recorded step.
fn exact_displacements(records: &[Recorded]) -> Vec<Vec<[f64; 3]>> {
    let mut solver =
        Solver::new(Backend::Exact, Level::default()).expect("the backend runs in this process");
    let mut displacement = Vec::new();
    records
        .iter()
        .map(|recorded| {
            solver.solve(recorded);
            recorded.qp.displace(solver.answer().0, &mut displacement);
            displacement.clone()
        })
        .collect()
}

/// Solves the recorded programs and returns the quality of the answers.
fn quality_of(solver: &mut Solver, records: &[Recorded], truth: &[Vec<[f64; 3]>]) -> Quality {
    let mut quality = Quality::default();
    for (recorded, exact) in records.iter().zip(truth) {
        solver.solve(recorded);
        let (multipliers, iterations, fallbacks) = solver.answer();
        quality.add(recorded, multipliers, exact);
        quality.iterations += iterations as f64;
        quality.fallbacks += fallbacks;
    }
    quality.divide(records.len());
    quality
}
