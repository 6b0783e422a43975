//! What must hold of any bytes whatever: a function for each way into the daemon and out of it.
//!
//! `fuzz/` hands them what a fuzzer makes up; [`crate::corpora`] hands them what was found to be
//! interesting. They panic when something does not hold. Those that need no daemon depend on
//! `jostle-proto` alone, so that they are fuzzed without building one.

pub mod experiments;
pub mod messages;
pub mod names;
pub mod orders;
pub mod recordings;
pub mod requests;
pub mod rows;
pub mod selectors;
pub mod sequences;
pub mod settings;
pub mod snapshots;
pub mod states;
