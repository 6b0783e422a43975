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

/// A row like those of an experiment.
#[cfg(test)]
pub(crate) fn sample() -> Run {
    Run {
        run: "pi1=4 n=10 #0".to_owned(),
        seed: (1 << 53) - 1,
        n: 10,
        pi1: 4.0,
        pi2: 0.0,
        pi3: 1.0,
        pi4: 10.0,
        informed: 0,
        contacts: "endpoints".to_owned(),
        dt: 0.02,
        time: 1000.0,
        v: 0.9,
        v_pd: None,
        ordered_intervals: 3,
        ordered_time: 950.0,
        unordered_intervals: 2,
        unordered_time: 50.0,
        worst_overlap: 2.6e-3,
        crossed_share: 0.0,
        worst_residual: 1e-9,
        degraded: 0,
        fallbacks: 0,
        steps: 50_000,
        state_hash: "00ff".to_owned(),
    }
}

/// Rows that a careless table would change.
#[cfg(test)]
pub(crate) fn samples() -> Vec<Run> {
    let awkward = [
        0.1 + 0.2,
        f64::MIN_POSITIVE,
        5e-324,
        f64::MAX,
        1.0 / 3.0,
        -0.0,
        f64::INFINITY,
    ];
    let mut runs = vec![sample()];
    for (index, value) in awkward.into_iter().enumerate() {
        runs.push(Run {
            run: format!("quoted \", {index}\nµ"),
            v: value,
            v_pd: (index % 2 == 0).then_some(-value),
            ..sample()
        });
    }
    runs
}
