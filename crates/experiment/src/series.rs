//! The time series of runs: the order (`order_every`) and the chosen measures (`series_every`).
//!
//! A run that is executed has the rows of a series in memory until they take more than 64 KiB. A short
//! series is then in the run's line of the list of runs. The rows of a longer one are appended to a
//! spool, as those of a trajectory are; a checkpoint of the run has its length and hash, to which a
//! resumed run truncates it. At the end of the run the spool is converted to a Parquet file,
//! `orders/run-NNNNNN.parquet` or `series/run-NNNNNN.parquet`. Where a series is depends on its length
//! alone, not on when checkpoints were written.

#[cfg(feature = "files")]
mod files;
mod log;
#[cfg(feature = "files")]
mod spool;

use jostle_results::table::order;

#[cfg(feature = "files")]
pub use self::files::{bytes_of, encode, encoded_bytes};
pub use self::log::SeriesLog;
#[cfg(feature = "files")]
pub use self::spool::{SeriesRecording, remove_spools, remove_spools_of};
use crate::plan::Plan;

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
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
