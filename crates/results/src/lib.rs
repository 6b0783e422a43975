//! Results of runs: tidy tables, the paper's statistics and its figures; and recordings of running
//! swarms.
//!
//! Its input are rows and frames, its output files and pictures. Of the wire it needs the definition
//! of a row only.

pub mod claims;
pub mod disorder;
pub mod figure;
pub mod recording;
#[cfg(test)]
mod samples;
pub mod statistics;
pub mod table;
pub mod touch;

pub use jostle_proto::{COLUMNS, Cell, CellKind, Column, Measure, ResultRow};
