//! One row of a table of results.

use serde::{Deserialize, Serialize};

/// The result of one run of an experiment: a row of `results.parquet` and `results.csv`. The fields
/// are the columns, in this order.
///
/// Lengths are in body sizes `s`, speeds in free speeds `v0`, times in `s/v0`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// The run's name within its experiment: the varied parameters, then the replicate. The seed is
    /// derived from the name.
    pub run: String,
    /// The seed of all random draws.
    pub seed: u64,
    /// Number of individuals.
    pub n: u64,
    /// Length over width of a body.
    pub pi1: f64,
    /// Weight of the informed individuals' own preference.
    pub pi2: f64,
    /// Body size over turning radius.
    pub pi3: f64,
    /// Translational over rotational drag.
    pub pi4: f64,
    /// Number of informed individuals.
    pub informed: u64,
    /// The contact rule: `endpoints`, `closest` or `clamped`.
    pub contacts: String,
    /// The time step.
    pub dt: f64,
    /// Duration of the run; less than that of the experiment if the run faulted.
    pub time: f64,
    /// Time mean of the centroid's speed, eq. (8).
    pub v: f64,
    /// Mean drift along the informed individuals' direction; none without informed individuals.
    pub v_pd: Option<f64>,
    /// Number of intervals with an order of at least 2/3, including those that the run's ends cut.
    pub ordered_intervals: u64,
    /// Total time of the ordered intervals.
    pub ordered_time: f64,
    /// Number of intervals with an order below 2/3, including those that the run's ends cut.
    pub unordered_intervals: u64,
    /// Total time of the unordered intervals.
    pub unordered_time: f64,
    /// The deepest overlap of any two bodies, 0 or more.
    pub worst_overlap: f64,
    /// The share of time in which any two axes crossed.
    pub crossed_share: f64,
    /// The largest residual of any step.
    pub worst_residual: f64,
    /// Number of degraded steps: less accurate than the target, but acceptable.
    pub degraded: u64,
    /// Number of steps that the fallback solved because the exact solver missed its target.
    pub fallbacks: u64,
    /// Number of steps.
    pub steps: u64,
    /// The hash of the last state, in hexadecimal.
    pub state_hash: String,
}

/// A row as an experiment could produce it.
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

/// Rows whose values are hard to store exactly.
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
