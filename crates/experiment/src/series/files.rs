//! The files of the time series of runs: their places, and the bytes that they take.

use std::path::{Path, PathBuf};

use jostle_results::table::order::{self, ORDER_NAME};
use jostle_results::table::series::SERIES_NAME;
use jostle_results::table::trajectory::file_name;
use jostle_results::table::{Series, SeriesWriter, TableError};

use super::SeriesKind;
use crate::plan::{Plan, PlannedRun};

impl SeriesKind {
    /// Returns the most rows of a run of a plan.
    pub(crate) fn most_rows(self, plan: &Plan, run: &PlannedRun) -> u64 {
        match self {
            Self::Order => {
                let steps = plan.point(run).steps;
                plan.order_every.map_or(0, |every| steps / every + 1)
            }
            Self::Measures => plan.series_entries(run),
        }
    }

    /// Returns the most bytes of the rows of a run of a plan, as [`SeriesLog`](super::SeriesLog) has them.
    pub(crate) fn most_bytes(self, plan: &Plan, run: &PlannedRun) -> u64 {
        encoded_bytes(self.most_rows(plan, run), self.measures(plan).len() as u64)
    }

    /// The name of the table of all runs.
    pub(crate) fn table(self) -> &'static str {
        match self {
            Self::Order => ORDER_NAME,
            Self::Measures => SERIES_NAME,
        }
    }

    /// The folder of the files of runs.
    pub(crate) fn folder(self) -> &'static str {
        match self {
            Self::Order => "orders",
            Self::Measures => "series",
        }
    }

    /// Returns the path of the file of a run, within the folder of results.
    pub(crate) fn file(self, index: usize) -> String {
        format!("{}/{}", self.folder(), file_name(index + 1))
    }

    /// Returns the path of the spool of a run.
    pub(super) fn spool(self, folder: &Path, index: usize) -> PathBuf {
        folder.join(self.file(index)).with_extension("partial")
    }

    /// Begins a table, or the file of a run.
    pub(crate) fn begin(self, path: &Path, plan: &Plan) -> Result<SeriesWriter, TableError> {
        match self {
            Self::Order => order::begin(path),
            Self::Measures => SeriesWriter::begin(path, self.measures(plan).into_iter()),
        }
    }
}

/// Returns the bytes of the rows of a series, as [`SeriesLog`](super::SeriesLog) has them.
pub fn encoded_bytes(rows: u64, measures: u64) -> u64 {
    rows.saturating_mul(8 * (1 + measures))
}

/// Returns the bytes of the rows of a series.
pub fn bytes_of(series: &Series) -> u64 {
    encoded_bytes(series.steps.len() as u64, series.measures.len() as u64)
}

/// Encodes rows of a series.
pub fn encode(series: &Series) -> Vec<u8> {
    let mut rows = Vec::new();
    for (row, step) in series.steps.iter().enumerate() {
        rows.extend(step.to_le_bytes());
        for measure in &series.measures {
            rows.extend(measure.values[row].unwrap_or(f64::NAN).to_le_bytes());
        }
    }
    rows
}
