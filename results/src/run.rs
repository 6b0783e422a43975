//! One row of a table of results.

use serde::{Deserialize, Serialize};

/// What one run of an experiment came to: a row of `results.parquet` and `results.csv`, its
/// fields the columns, in this order.
///
/// Lengths are in body sizes, speeds in free speeds, times in their quotient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// The run's name within its experiment: what varies, then the replicate. Its seed is
    /// derived from it.
    pub run: String,
    /// The seed of every draw.
    pub seed: u64,
    /// Individuals.
    pub n: u64,
    /// Length over width of a body.
    pub pi1: f64,
    /// Weight of the informed individuals' own preference.
    pub pi2: f64,
    /// Body size over turning radius.
    pub pi3: f64,
    /// Translational over rotational drag.
    pub pi4: f64,
    /// How many individuals were informed.
    pub informed: u64,
    /// The contact rule: `endpoints` or `closest`.
    pub contacts: String,
    /// The time step.
    pub dt: f64,
    /// How long the run was; less than the experiment's duration if it faulted.
    pub time: f64,
    /// Time mean of the centroid's speed, eq. (8).
    pub v: f64,
    /// Mean drift along the informed individuals' direction; none if nobody was informed.
    pub v_pd: Option<f64>,
    /// Intervals spent continuously with an order of at least 2/3, cut ones included.
    pub ordered_intervals: u64,
    /// The time they took together.
    pub ordered_time: f64,
    /// Intervals spent continuously below.
    pub unordered_intervals: u64,
    /// The time they took together.
    pub unordered_time: f64,
    /// The deepest overlap of any two bodies, 0 or more.
    pub worst_overlap: f64,
    /// The share of time in which some two axes crossed.
    pub crossed_share: f64,
    /// The worst residual of any step.
    pub worst_residual: f64,
    /// How many steps missed the accuracy aimed at, yet were good enough.
    pub degraded: u64,
    /// How many steps the exact solver left to the referee.
    pub fallbacks: u64,
    /// How many steps were taken.
    pub steps: u64,
    /// The hash of the last state, in hexadecimal.
    pub state_hash: String,
}
