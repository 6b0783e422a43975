//! The limits of an experiment.

/// The most runs of one experiment: a list of them is still readable.
pub const MAX_RUNS: u64 = 100_000;

/// The most individuals of a run: beyond, a single step takes a good part of a second.
pub const MAX_INDIVIDUALS: u64 = 100_000;

/// The most steps of a run: up to here `duration / dt` gives their number without doubt.
pub const MAX_STEPS: u64 = 1_000_000_000;

/// The most entries of the time series of all runs together: 8 GB.
pub const MAX_ENTRIES: u64 = 1_000_000_000;
