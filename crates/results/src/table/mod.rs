//! Tables of results, as Parquet and as CSV, written atomically.
//!
//! Both hold exactly the same values. A reader of the CSV must parse numbers exactly, which older
//! versions of pandas do only with `read_csv(..., float_precision="round_trip")`.

mod axes;
mod csv;
pub mod order;
pub mod series;

#[cfg(feature = "files")]
pub(crate) mod checksums;
#[cfg(feature = "files")]
pub(crate) mod column;
#[cfg(feature = "files")]
mod error;
#[cfg(feature = "files")]
mod file;
#[cfg(feature = "files")]
pub(crate) mod parquet;
#[cfg(feature = "files")]
pub mod trajectory;

use crate::ResultRow;

pub use axes::occasional;
pub use series::{MeasureSeries, Series, SeriesPart};

#[cfg(feature = "files")]
pub use self::{
    error::TableError,
    file::{read, write, write_csv, write_parquet},
    series::SeriesWriter,
    trajectory::{Trajectory, TrajectoryWriter},
};
#[cfg(feature = "files")]
use error::io_error;

/// The file name of a Parquet table within its directory.
pub const PARQUET_NAME: &str = "results.parquet";

/// The file name of a CSV table within its directory.
pub const CSV_NAME: &str = "results.csv";

/// Returns `runs` as CSV, as a table in a file has them.
#[must_use]
pub fn csv(runs: &[ResultRow], extra: &[String]) -> String {
    let mut bytes = Vec::new();
    csv::write_to(&mut bytes, runs, extra).expect("writing to memory cannot fail");
    String::from_utf8(bytes).expect("CSV is UTF-8")
}

/// Returns the names of the columns that only some experiments have: axes, then those of `first`, then
/// others in the order of the rows.
fn extra_names<'a>(runs: &'a [ResultRow], first: &'a [String]) -> Vec<&'a str> {
    let mut names: Vec<&str> = axes::of(runs, first).collect();
    let extra = runs.iter().flat_map(|run| &run.extra);
    for name in first.iter().chain(extra.map(|it| &it.name)) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    names
}

/// Returns whether a table of `runs` has the column of the faults.
///
/// Only tables with a faulted run have it: the others are as those of earlier versions.
fn has_faults(runs: &[ResultRow]) -> bool {
    runs.iter().any(|run| run.fault.is_some())
}
