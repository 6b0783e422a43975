//! Estimates what the runs of an experiment take, from some steps of two of its conditions.

use std::fmt::{self, Display};
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;

use super::condition;
use crate::plan::{Plan, PlannedRun, Point};
use crate::run::execute_run;
use crate::series::{MAX_INLINE, SeriesKind};
use crate::subset::Subset;

/// Processor seconds of all steps that are taken for an estimate.
const SECS: f64 = 1.0;

/// Steps between two readings of the clock, once the first of these have been taken.
const CLOCK_STEPS: u64 = 16;

/// Bytes of the tables of an experiment, and in addition of each run, of each character of its name
/// (which three files contain), of each column that only some experiments have, and of `touch`.
const BYTES: f64 = 6000.0;
const BYTES_OF_RUN: f64 = 1100.0;
const BYTES_OF_CHARACTER: f64 = 3.0;
const BYTES_OF_COLUMN: f64 = 75.0;
const BYTES_OF_TOUCH: f64 = 600.0;

/// Bytes of an entry of the order's time series, and in addition of its drift.
const BYTES_OF_ENTRY: f64 = 31.0;
const BYTES_OF_DRIFT: f64 = 28.0;

/// Bytes of a step of the time series of the chosen measures, and in addition of each of its values.
const BYTES_OF_SERIES_STEP: f64 = 12.0;
const BYTES_OF_VALUE: f64 = 28.0;

/// Bytes of a row of a long series, and in addition of each of its values, in the table and in the file
/// of the run.
const BYTES_OF_LONG_ROW: f64 = 24.0;
const BYTES_OF_LONG_VALUE: f64 = 20.0;

/// What the runs of a subset take.
#[derive(Clone, Debug, Serialize)]
pub struct Estimate {
    /// Processor seconds of all runs.
    pub cpu_secs: f64,
    /// Bytes of the folder of results.
    pub disk_bytes: f64,
    /// Bytes of memory of the plan and of the rows of all runs of the experiment, at most.
    pub memory_bytes: u64,
    /// Bytes of memory of the largest run, at most, in addition for each that is executed at a time.
    pub run_memory_bytes: u64,
    /// Whether the runs may take less, since `[stop]` may end one before its duration, or since a
    /// recorded group grows to its size only later.
    pub is_at_most: bool,
    /// The conditions of which steps were taken, the cheapest one first.
    pub measured: Vec<Measured>,
}

/// Steps of one condition.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// The values that vary.
    pub condition: String,
    /// The number of individuals at the start.
    pub n: usize,
    /// The number of steps that were taken.
    pub steps: u64,
    /// Processor seconds of a step.
    pub secs_per_step: f64,
    /// Processor seconds before the second step.
    pub start_secs: f64,
}

impl Measured {
    /// Takes steps of a run for a time; none if it takes none.
    fn of(plan: &Plan, run: &PlannedRun, secs: f64) -> Option<Self> {
        let began = processor_secs();
        let (mut first, mut last) = (None, None);
        let _ = execute_run(plan, run, |steps| {
            if steps > CLOCK_STEPS && !steps.is_multiple_of(CLOCK_STEPS) {
                return true;
            }
            let now = processor_secs();
            first = first.or(Some(now));
            last = Some((steps, now));
            now - began < secs
        });
        let (first, (steps, last)) = first.zip(last)?;
        let start_secs = first - began;
        Some(Self {
            condition: condition(&run.name).to_owned(),
            n: plan.point(run).spec.n,
            steps,
            secs_per_step: match steps {
                1 => start_secs,
                _ => (last - first) / (steps - 1) as f64,
            },
            start_secs,
        })
    }
}

impl Estimate {
    /// Takes steps of the conditions whose steps are expected to take the least and the most time.
    pub fn of(plan: &Plan, subset: &Subset) -> Self {
        let runs: Vec<&PlannedRun> = subset
            .indices()
            .iter()
            .map(|&index| &plan.runs()[index])
            .collect();
        let cost = |run: &PlannedRun| step_cost(plan.point(run));
        let by_cost = |one: &&&PlannedRun, other: &&&PlannedRun| cost(one).total_cmp(&cost(other));
        let (least, most) = (runs.iter().min_by(by_cost), runs.iter().max_by(by_cost));
        let ends: Vec<&PlannedRun> = match (least, most) {
            (Some(least), Some(most)) if cost(least) < cost(most) => vec![least, most],
            (Some(least), _) => vec![least],
            (None, _) => Vec::new(),
        };
        let secs = SECS / ends.len().max(1) as f64;
        let measured = ends.iter().map(|run| Measured::of(plan, run, secs));
        let measured: Vec<Option<Measured>> = measured.collect();
        let factors = ends.iter().zip(&measured).filter_map(|(run, measured)| {
            let secs = measured.as_ref()?.secs_per_step;
            Some((cost(run), secs / cost(run)))
        });
        let factors: Vec<(f64, f64)> = factors.collect();
        let measured: Vec<Measured> = measured.into_iter().flatten().collect();
        let start = measured.iter().map(|it| it.start_secs);
        let start = start.fold(0.0, f64::max).min(secs);
        let of_run = |run: &&PlannedRun| {
            let cost = cost(run);
            plan.point(run).steps as f64 * cost * factor(&factors, cost)
        };
        let memory = runs.iter().map(|run| plan.run_memory_bytes(run));
        Self {
            cpu_secs: runs.iter().map(of_run).sum::<f64>() + start * runs.len() as f64,
            disk_bytes: disk_bytes(plan, &runs),
            memory_bytes: plan.memory_bytes(),
            run_memory_bytes: memory.max().unwrap_or(0),
            is_at_most: runs.iter().any(|run| may_take_less(plan, plan.point(run))),
            measured,
        }
    }
}

/// The expected time of a step, in seconds.
fn step_cost(point: &Point) -> f64 {
    point.expected_secs() / point.steps as f64
}

/// Returns the measured time over the expected one at an expected time, by the line between the
/// measured ones, both logarithmic.
#[expect(
    clippy::disallowed_methods,
    reason = "an estimate, which depends on the machine anyway"
)]
fn factor(measured: &[(f64, f64)], cost: f64) -> f64 {
    match measured {
        [(low, at_low), (high, at_high)] if at_low.min(*at_high) > 0.0 => {
            let share = (cost / low).ln() / (high / low).ln();
            at_low * (at_high / at_low).powf(share)
        }
        [first, ..] => first.1,
        [] => 1.0,
    }
}

/// Returns whether a run may take less than estimated: its individuals that are injected are counted
/// from its start.
pub fn may_take_less(plan: &Plan, point: &Point) -> bool {
    let is_recorded = plan.record_every.is_some();
    let protocol = point.protocol.as_ref();
    protocol.is_some_and(|it| it.stop.is_some() || is_recorded && it.injected() > 0)
}

/// Returns the bytes of the folder of results of these runs.
pub fn disk_bytes(plan: &Plan, runs: &[&PlannedRun]) -> f64 {
    let of_run = |run: &&PlannedRun| {
        let point = plan.point(run);
        let stop = point.protocol.as_ref().is_some_and(|it| it.stop.is_some());
        let columns = plan.columns.measures.len() + point.variables.0.len() + usize::from(stop);
        let touch = if plan.touch { BYTES_OF_TOUCH } else { 0.0 };
        let has_drift = point.informed > 0 || point.protocol.is_some();
        let drift = if has_drift { BYTES_OF_DRIFT } else { 0.0 };
        let measures = plan.columns.measures.len() as f64;
        let of_series = |kind: SeriesKind| {
            let (values, short) = match kind {
                SeriesKind::Order => (1.0 + f64::from(has_drift), BYTES_OF_ENTRY + drift),
                SeriesKind::Measures => {
                    (measures, BYTES_OF_SERIES_STEP + BYTES_OF_VALUE * measures)
                }
            };
            let of_row = match kind.most_bytes(plan, run) > MAX_INLINE {
                true => BYTES_OF_LONG_ROW + BYTES_OF_LONG_VALUE * values,
                false => short,
            };
            of_row * kind.most_rows(plan, run) as f64
        };
        BYTES_OF_RUN
            + BYTES_OF_CHARACTER * run.name.len() as f64
            + BYTES_OF_COLUMN * columns as f64
            + touch
            + SeriesKind::ALL.into_iter().map(of_series).sum::<f64>()
            + plan.trajectory_bytes(run)
    };
    let points = plan.files.points.as_ref().map_or(0, String::len);
    let set_points = plan.files.setpoints.as_ref().map_or(0, String::len);
    let files = plan.files.toml.len() + points + set_points;
    BYTES + files as f64 + runs.iter().map(of_run).sum::<f64>()
}

/// Processor time of this process.
fn processor_secs() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    Duration::try_from(time).unwrap_or_default().as_secs_f64()
}

impl Display for Estimate {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let about = if self.is_at_most { "at most" } else { "about" };
        let (secs, bytes) = (self.cpu_secs, size(self.disk_bytes));
        let memory = size(self.memory_bytes as f64);
        let of_run = size(self.run_memory_bytes as f64);
        write!(
            to,
            "{about} {} of processor time, {about} {bytes} on disk\nup to {memory} of memory, and \
             {of_run} for each run at a time",
            rounded(secs)
        )?;
        for (index, it) in self.measured.iter().enumerate() {
            let start = if index == 0 { "\nmeasured: " } else { "; " };
            let (steps, micros) = (it.steps, it.secs_per_step * 1e6);
            write!(to, "{start}{steps} steps of n = {} at {micros:.3} µs", it.n)?;
        }
        Ok(())
    }
}

/// A time in seconds, with two digits.
fn rounded(secs: f64) -> String {
    match secs {
        0.0..0.1 => "0.1 s".to_owned(),
        0.1..10.0 => format!("{secs:.1} s"),
        _ => format!("{secs:.0} s"),
    }
}

fn size(bytes: f64) -> String {
    let (unit, name) = [(1e9, "GB"), (1e6, "MB")]
        .into_iter()
        .find(|(unit, _)| bytes >= *unit)
        .unwrap_or((1e3, "kB"));
    format!("{:.1} {name}", bytes / unit)
}
