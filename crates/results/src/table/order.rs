//! The order over time, run by run: series of two measures.

#[cfg(feature = "files")]
mod file;

#[cfg(feature = "files")]
pub use file::begin;

/// The names of the measures: the order, and the drift along the informed individuals' direction.
pub const MEASURES: [&str; 2] = ["order", "drift"];

/// The file name of the table within its directory.
pub const ORDER_NAME: &str = "order.parquet";
