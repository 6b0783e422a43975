//! What the runs of a plan need, without taking a step.

use super::estimate::{disk_bytes, may_take_less};
use crate::plan::{Plan, PlannedRun};
use crate::series::{MAX_INLINE, SeriesKind};
use crate::subset::Subset;

/// What the runs of a subset need on disk, by their number of steps, without taking any.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiskNeed {
    /// Bytes of the folder while its runs are executed. The frames and the long series of a run that
    /// ends are there twice, also of the largest runs at a time.
    pub bytes: f64,
    /// Whether it may be less, since `[stop]` may end a run before its duration, or since a recorded
    /// group grows to its size only later.
    pub is_at_most: bool,
}

impl DiskNeed {
    /// Returns what a subset needs, with so many runs at a time.
    #[must_use]
    pub fn of(plan: &Plan, subset: &Subset, threads: usize) -> Self {
        let runs = subset.indices().iter().map(|&index| &plan.runs()[index]);
        let runs: Vec<&PlannedRun> = runs.collect();
        let spooled = |run: &&PlannedRun| plan.trajectory_bytes(run) + spool_bytes(plan, run);
        let mut spools: Vec<f64> = runs.iter().map(spooled).collect();
        spools.sort_by(|one, other| other.total_cmp(one));
        let twice: f64 = spools.iter().take(threads.max(1)).sum();
        Self {
            bytes: disk_bytes(plan, &runs) + twice,
            is_at_most: runs.iter().any(|run| may_take_less(plan, plan.point(run))),
        }
    }
}

/// Returns the bytes of the spools of the series of a run.
fn spool_bytes(plan: &Plan, run: &PlannedRun) -> f64 {
    let bytes = SeriesKind::ALL.map(|kind| kind.most_bytes(plan, run));
    let long = bytes.into_iter().filter(|&bytes| bytes > MAX_INLINE);
    long.map(|bytes| bytes as f64).sum()
}
