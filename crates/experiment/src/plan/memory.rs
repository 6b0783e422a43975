//! The memory that a plan and its runs take.

use jostle_results::table::order::MEASURES;

use super::{Plan, PlannedRun, Point};
use crate::limits::MAX_INDIVIDUALS;

/// Memory of a run whatever its size: the used stack of its thread and its buffers.
const BYTES_PER_RUN: u64 = 1 << 20;

/// Memory of a pose of an earlier step, and for how many poses a step counts in addition.
const BYTES_PER_POSE: u64 = 28;
const POSES_PER_STEP: u64 = 8;

/// Memory of an individual of a packed group: its columns, its contacts and its share of the factor. In
/// a sparse group it takes a tenth.
const BYTES_PER_INDIVIDUAL: u64 = 6144;

/// Memory of a value of the rows of a time series that are written at once, at most so many rows.
const BYTES_PER_VALUE: u64 = 44;
const SERIES_ROWS: u64 = 65_536;

/// Columns of a time series beside its measures: run, step and time.
const SERIES_COLUMNS: u64 = 3;

/// Memory of the rows of a trajectory that are written at once.
const BYTES_PER_RECORDING: u64 = 8 << 20;

/// Memory of a run in the plan, and of its row and its place in the list of finished runs, beside its
/// name, which is there three times, and its columns.
const BYTES_PER_PLANNED: u64 = 200;
const BYTES_PER_ROW: u64 = 3200;
const BYTES_PER_COLUMN: u64 = 100;

impl Plan {
    /// Returns the memory of the plan and of the rows of all its runs, in bytes, at most.
    #[must_use]
    pub fn memory_bytes(&self) -> u64 {
        let name = |run: &PlannedRun| run.name.len() as u64;
        let names: u64 = self.runs.iter().map(name).sum();
        let columns = self.columns.measures.len() as u64;
        let per_run = BYTES_PER_PLANNED + BYTES_PER_ROW + columns * BYTES_PER_COLUMN;
        self.files.toml.len() as u64 + 3 * names + per_run * self.runs.len() as u64
    }

    /// Returns the memory of a run once all individuals of its protocol are injected, in bytes, at most.
    /// Series and frames are in files, so that the number of steps does not count.
    #[must_use]
    pub fn run_memory_bytes(&self, run: &PlannedRun) -> u64 {
        let point = self.point(run);
        let n = injected(point).saturating_add(point.spec.n as u64);
        let n = n.min(MAX_INDIVIDUALS);
        let poses = self
            .lag(run)
            .saturating_add(1)
            .saturating_mul(n + POSES_PER_STEP);
        let recording = self.record_every.map_or(0, |_| BYTES_PER_RECORDING);
        BYTES_PER_RUN
            .saturating_add(n.saturating_mul(BYTES_PER_INDIVIDUAL))
            .saturating_add(poses.saturating_mul(BYTES_PER_POSE))
            .saturating_add(recording)
            .saturating_add(self.series_bytes(run))
    }

    /// Returns the memory of the rows of the series of a run that are written at once.
    fn series_bytes(&self, run: &PlannedRun) -> u64 {
        let steps = self.point(run).steps;
        let order = (
            self.order_every.map_or(0, |every| steps / every + 1),
            MEASURES.len(),
        );
        let measures = (self.series_entries(run), self.columns.measures.len());
        let bytes = [order, measures].map(|(rows, columns)| {
            rows.min(SERIES_ROWS) * (SERIES_COLUMNS + columns as u64) * BYTES_PER_VALUE
        });
        bytes.iter().sum()
    }

    /// Returns the number of earlier steps whose states the measures of a run need.
    pub(crate) fn lag(&self, run: &PlannedRun) -> u64 {
        let point = self.point(run);
        let dt = point.spec.parameters.dt;
        let columns = self.columns.measures.iter().map(|measure| measure.lag(dt));
        let protocol = point.protocol.iter().map(|protocol| protocol.lag);
        columns.chain(protocol).max().unwrap_or(0)
    }
}

/// Returns how many individuals a run may inject, at most.
pub(crate) fn injected(point: &Point) -> u64 {
    point.protocol.as_ref().map_or(0, |it| it.injected())
}
