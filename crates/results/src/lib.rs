//! Results of runs: tidy tables and the paper's statistics; and recordings of running swarms.
//!
//! Its input are rows and frames, its output files. Of the wire it needs the definition
//! of a row only.

pub mod claims;
pub mod disorder;
pub mod recording;
#[cfg(test)]
mod samples;
pub mod statistics;
pub mod table;
pub mod touch;

pub use jostle_proto::{COLUMNS, Cell, CellKind, Column, Measure, ResultRow};
