//! The time series of runs: the order (`order_every`) and the chosen measures (`series_every`).
//!
//! A run that is executed has the rows of a series in memory until they take more than 64 KiB. A short
//! series is then in the run's line of the list of runs. The rows of a longer one are appended to a
//! spool, as those of a trajectory are; a checkpoint of the run has its length and hash, to which a
//! resumed run truncates it. At the end of the run the spool is converted to a Parquet file,
//! `orders/run-NNNNNN.parquet` or `series/run-NNNNNN.parquet`. Where a series is depends on its length
//! alone, not on when checkpoints were written.

use std::path::{Path, PathBuf};

use jostle_results::table::order::{self, ORDER_NAME};
use jostle_results::table::series::SERIES_NAME;
use jostle_results::table::trajectory::file_name;
use jostle_results::table::{Series, SeriesWriter, TableError};

pub use self::log::{SeriesLog, encode};
pub use self::spool::{SeriesRecording, remove_spools, remove_spools_of};
use crate::plan::{Plan, PlannedRun};

mod log;
mod spool;

/// Bytes of the rows of a series, as [`SeriesLog`] has them, up to which it is in the line of its run.
pub const MAX_INLINE: u64 = 64 << 10;

/// The two time series of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeriesKind {
    /// The order, and the drift along the informed individuals' direction, every `order_every` steps.
    Order,
    /// The chosen measures every `series_every` steps, and at the last one.
    Measures,
}

impl SeriesKind {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Order, Self::Measures];

    /// Returns whether the runs of a plan have the series.
    #[must_use]
    pub fn is_in(self, plan: &Plan) -> bool {
        match self {
            Self::Order => plan.order_every.is_some(),
            Self::Measures => plan.columns.series_every.is_some(),
        }
    }

    /// Returns the names of its measures.
    #[must_use]
    pub fn measures(self, plan: &Plan) -> Vec<String> {
        match self {
            Self::Order => order::MEASURES.map(str::to_owned).into(),
            Self::Measures => {
                let measures = plan.columns.measures.iter();
                measures.map(ToString::to_string).collect()
            }
        }
    }

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

    /// Returns the most bytes of the rows of a run of a plan, as [`SeriesLog`] has them.
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
    fn spool(self, folder: &Path, index: usize) -> PathBuf {
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

/// Returns the bytes of the rows of a series, as [`SeriesLog`] has them.
pub fn encoded_bytes(rows: u64, measures: u64) -> u64 {
    rows.saturating_mul(8 * (1 + measures))
}

/// Returns the bytes of the rows of a series.
pub fn bytes_of(series: &Series) -> u64 {
    encoded_bytes(series.steps.len() as u64, series.measures.len() as u64)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
