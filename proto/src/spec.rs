//! What a swarm is made from.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::LARGEST_WHOLE;

/// Maximum number of measures in a published order.
pub const MAX_PUBLISHED_MEASURES: usize = 16;

/// The description of a swarm: same spec, same seed, same bytes.
///
/// Lengths are in body sizes, speeds in free speeds, times in their quotient. Everything but `n`
/// may be left out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Spec {
    /// The number of individuals: 1 to the daemon's limit; in a spec that at the start.
    #[schemars(range(min = 1), extend("x-unit" = "individuals", "x-changed-by" = ["inject", "remove"]))]
    pub n: u64,
    /// Length over width of a body: 1 (a disc) to 32.
    #[serde(default = "default::pi1")]
    #[schemars(range(min = 1.0, max = 32.0), extend("x-unit" = "1", "x-changed-by" = ["set"]))]
    pub pi1: f64,
    /// Weight of the preferred direction of individuals informed without a weight: 0 or more.
    #[serde(default = "default::pi2")]
    #[schemars(range(min = 0.0, max = 1e6), extend("x-unit" = "1", "x-changed-by" = ["set"]))]
    pub pi2: f64,
    /// Body size over turning radius: above 0.
    #[serde(default = "default::pi3")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6), extend("x-unit" = "1", "x-changed-by" = ["set"]))]
    pub pi3: f64,
    /// Translational over rotational drag: above 0.
    #[serde(default = "default::pi4")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6), extend("x-unit" = "1", "x-changed-by" = ["set"]))]
    pub pi4: f64,
    /// The time step: above 0, and short enough that a step cannot carry a body across another.
    #[serde(default = "default::dt")]
    #[schemars(extend("exclusiveMinimum" = 0, "x-unit" = "body size / free speed"), range(max = 1.0))]
    pub dt: f64,
    /// Which of a pair's contacts constrain it.
    #[serde(default)]
    #[schemars(extend("x-unit" = "1", "x-changed-by" = ["set"]))]
    pub contacts: ContactRule,
    /// What a contact limits.
    #[serde(default)]
    #[schemars(extend("x-unit" = "1", "x-changed-by" = ["set"]))]
    pub stepping: Stepping,
    /// How many more programs a step solves about what the last one predicts: 0 or 1. One more
    /// leaves less overlap, and goes with `position` alone.
    #[serde(default)]
    #[schemars(range(max = 1), extend("x-unit" = "1", "x-changed-by" = ["set"]))]
    pub relinearise: u8,
    /// The seed of every draw: 0 to 2⁵³ - 1.
    #[serde(default)]
    #[schemars(range(max = LARGEST_WHOLE), extend("x-unit" = "1", "x-changed-by" = ["reset"]))]
    pub seed: u64,
    /// Where the individuals begin.
    #[serde(default)]
    pub start: Start,
    /// What an individual turns towards.
    #[serde(default)]
    #[schemars(extend("x-unit" = "1", "x-changed-by" = ["set"]))]
    pub attraction: Attraction,
    /// Intensity of white noise on the turning rate, squared angle over time: 0 or more.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 1e6), extend("x-unit" = "free speed / body size", "x-changed-by" = ["set"]))]
    pub noise: f64,
    /// Steps between two published states: 1 or more.
    #[serde(default = "default::publish_every")]
    #[schemars(range(min = 1, max = 1_000_000_000), extend("x-unit" = "steps", "x-changed-by" = ["set"]))]
    pub publish_every: u64,
    /// The measures in each published order, such as `milling`, at most 16 that need no earlier
    /// state; none if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(length(max = MAX_PUBLISHED_MEASURES), extend("x-unit" = "1", "x-changed-by" = ["set"]))]
    pub measures: Option<Vec<String>>,
    /// Time units per second of wall clock; `null` is as fast as possible.
    #[serde(default = "default::rate")]
    #[schemars(extend("exclusiveMinimum" = 0, "x-unit" = "time units / s", "x-changed-by" = ["run"]), range(max = 1e6))]
    pub rate: Option<f64>,
}

impl Spec {
    /// The spec of `n` individuals with everything else left out.
    pub fn new(n: u64) -> Self {
        Spec {
            n,
            pi1: default::pi1(),
            pi2: default::pi2(),
            pi3: default::pi3(),
            pi4: default::pi4(),
            dt: default::dt(),
            contacts: ContactRule::default(),
            stepping: Stepping::default(),
            relinearise: 0,
            seed: 0,
            start: Start::default(),
            attraction: Attraction::default(),
            noise: 0.0,
            publish_every: default::publish_every(),
            measures: None,
            rate: default::rate(),
        }
    }
}

/// The defaults of Table 1 and of the service.
mod default {
    pub(super) fn pi1() -> f64 {
        4.0
    }
    pub(super) fn pi2() -> f64 {
        0.5
    }
    pub(super) fn pi3() -> f64 {
        1.0
    }
    pub(super) fn pi4() -> f64 {
        10.0
    }
    pub(super) fn dt() -> f64 {
        0.02
    }
    pub(super) fn publish_every() -> u64 {
        5
    }
    #[expect(clippy::unnecessary_wraps, reason = "the field it fills is optional")]
    pub(super) fn rate() -> Option<f64> {
        Some(1.0)
    }
}

/// Which of a pair's contacts constrain it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ContactRule {
    /// Every endpoint that projects inside the other segment, and mutual endpoint pairs.
    #[default]
    Endpoints,
    /// Of those the one with the smallest gap: the literal reading of the paper's appendix. Axes
    /// may come to cross.
    Closest,
    /// Those of `endpoints` and the end pairs that they imply: not the model's, to compare with.
    Clamped,
}

/// What a contact limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stepping {
    /// The gap after the step: overlap is pushed out again, eq. (7).
    #[default]
    Position,
    /// The speed at which touching bodies close, eq. (19): overlap adds up over the steps.
    Velocity,
}

/// What an individual turns towards.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Attraction {
    /// The mean of the unit vectors to all the others, eq. (4).
    All {
        /// About how far off that mean may be, its largest length being 1: 1e-9 to 1e-3. It is
        /// measured and no bound: in one group the largest error is at most this, in several
        /// flocks far apart up to ten times as much. Worth it from some thousand individuals on.
        /// Exact to rounding if left out.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        #[schemars(range(min = 1e-9, max = 1e-3))]
        accuracy: Option<f64>,
    },
    /// The mean over those whose Voronoi cells share an edge with one's own.
    Voronoi {},
    /// The mean over all within a distance.
    Metric {
        /// The distance, body sizes: above 0.
        #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
        radius: f64,
    },
    /// The mean over the nearest few; of those equally far the lower ids.
    Topological {
        /// How many: 1 or more.
        #[schemars(range(min = 1))]
        neighbours: u32,
    },
    /// The mean over all the others of the unit vectors times a power of the distance.
    Power {
        /// The exponent: -8 to 8; 0 is `all`.
        #[schemars(range(min = -8.0, max = 8.0))]
        exponent: f64,
    },
}

impl Default for Attraction {
    fn default() -> Self {
        Attraction::All { accuracy: None }
    }
}

/// Where the individuals begin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Start {
    /// Uniformly in a disc, one after the other, none overlapping an earlier one.
    Disc {
        /// The radius of the disc in body sizes, above 0; √n, at least 1, if left out.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
        radius: Option<f64>,
    },
    /// Exactly there, to the bit. Three columns of n numbers.
    Given {
        /// Absolute positions, body sizes.
        #[schemars(inner(range(min = -1e6, max = 1e6)))]
        x: Vec<f64>,
        /// Absolute positions, body sizes.
        #[schemars(inner(range(min = -1e6, max = 1e6)))]
        y: Vec<f64>,
        /// Headings in radians, counter-clockwise from +x.
        #[schemars(inner(range(min = -1e6, max = 1e6)))]
        alpha: Vec<f64>,
    },
}

impl Default for Start {
    fn default() -> Self {
        Start::Disc { radius: None }
    }
}
