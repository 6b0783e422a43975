//! Results of runs: tidy tables and the paper's statistics; and recordings of running swarms.
//!
//! Its inputs are rows and frames, its outputs files. It uses `jostle-proto` only for the definition
//! of a row.

pub mod chart;
#[cfg(feature = "files")]
pub mod claims;
pub mod contact_statistics;
pub mod disorder;
#[cfg(test)]
mod flips;
#[cfg(feature = "files")]
pub mod recording;
#[cfg(test)]
mod samples;
pub mod statistics;
pub mod table;

pub use jostle_proto::{
    COLUMNS, Cell, CellKind, Column, ExtraValue, FAULT, Measure, OCCASIONAL_COLUMNS, ResultRow,
    STOPPED_AT, TIME_UNIT, rename_fault, unit_of_column,
};
