//! The values of the parameters that are no number, and where the individuals begin.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
#[schemars(extend(
    "x-range" = "{\"kind\": \"all\"}, optionally with \"accuracy\"; or of kind \"voronoi\", \"metric\" with \
                 \"radius\", \"topological\" with \"neighbours\", \"power\" with \"exponent\""
))]
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
#[schemars(extend(
    "x-range" = "{\"kind\": \"disc\"} or {\"kind\": \"given\", \"x\", \"y\", \"alpha\"}"
))]
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
