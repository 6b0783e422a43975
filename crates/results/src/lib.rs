//! Results of runs: tidy tables, the paper's statistics and its figures; and recordings of running
//! swarms.
//!
//! This crate depends on neither the daemon nor the wire: its input are rows and frames, its output
//! files and pictures.

pub mod claims;
pub mod disorder;
pub mod figure;
pub mod recording;
pub mod run;
pub mod statistics;
pub mod table;
pub mod touch;

pub use run::Run;
