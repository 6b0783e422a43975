//! What is read off runs once they are over: tidy tables, the paper's statistics, its figures; and
//! recordings of swarms as they go.
//!
//! It knows neither the daemon nor the wire: rows in, files and pictures out.

pub mod claims;
pub mod disorder;
pub mod figure;
pub mod recording;
pub mod run;
pub mod statistics;
pub mod table;
pub mod touch;

mod atomic_file;

pub use run::Run;
