//! The limits of an experiment.

use jostle_proto::LARGEST_WHOLE;

/// Maximum number of runs of an experiment: a list of them is still readable.
pub const MAX_RUNS: u64 = 100_000;

/// Maximum number of individuals of a run: with more, a single step takes a good part of a second.
pub const MAX_INDIVIDUALS: u64 = 100_000;

/// Maximum number of steps of a run: up to it `duration / dt` determines the number of steps in
/// spite of rounding.
pub const MAX_STEPS: u64 = 1_000_000_000;

/// Maximum number of entries of all time series of an experiment: 8 GB.
pub const MAX_ENTRIES: u64 = 1_000_000_000;

/// Maximum number of bytes of all trajectories of an experiment, by [`Plan::trajectory_bytes`].
///
/// [`Plan::trajectory_bytes`]: crate::Plan::trajectory_bytes
pub const MAX_TRAJECTORY_BYTES: f64 = 100e9;

/// Maximum number of blocks of a protocol. Every point of the grid has its own.
pub const MAX_BLOCKS: usize = 1000;

/// Maximum number of blocks of all points of the grid.
pub const MAX_BLOCKS_OF_PLAN: usize = 1_000_000;

/// Maximum number of measures that are columns of the results.
pub const MAX_COLUMNS: usize = 100;

/// Maximum number of set-points of a run, the rows of its CSV.
pub const MAX_SET_POINTS: u64 = 100_000;

/// The range of the seeds in a file.
pub const SEEDS: [u64; 2] = [0, LARGEST_WHOLE];

/// The range of the replicates of a condition.
pub const REPLICATES: [u64; 2] = [1, MAX_RUNS];

/// The range of the number of steps between two measurements.
pub const STEPS_BETWEEN: [u64; 2] = [1, MAX_STEPS];
