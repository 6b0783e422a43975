//! The states that a swarm publishes.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::column;

/// The phase of a swarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Paused; every command is allowed.
    Paused,
    /// Stepping.
    Running,
    /// A step failed: the last good state is kept; `reset` or `delete` go on from here.
    Faulted,
}

impl Phase {
    /// Its name on the wire.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Phase::Paused => "paused",
            Phase::Running => "running",
            Phase::Faulted => "faulted",
        }
    }
}

/// One published state: columns of n numbers, ordered by id.
///
/// An individual's absolute position is `1024 · origin + (x, y)`. In CBOR the columns are RFC 8746
/// typed arrays, little-endian; in JSON plain arrays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct State {
    /// The swarm's name.
    pub swarm: String,
    /// Grows whenever `step` does not continue what was published before.
    pub epoch: u64,
    /// Counts the published states, so that a reader can distinguish skipped from lost ones.
    pub frame: u64,
    /// The number of steps since the start.
    pub step: u64,
    /// `step · dt`.
    pub time: f64,
    /// The phase of the swarm.
    pub phase: Phase,
    /// Two integers: where the positions are counted from, in units of 1024 body sizes.
    pub origin: [i64; 2],
    /// Ids; never used twice.
    #[serde(with = "column::u32_column")]
    #[schemars(with = "Vec<u32>")]
    pub id: Vec<u32>,
    /// Positions relative to the origin, body sizes.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub x: Vec<f64>,
    /// Positions relative to the origin, body sizes.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub y: Vec<f64>,
    /// Headings in radians, counter-clockwise from +x, never wrapped.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub alpha: Vec<f64>,
    /// Weights of the preferred directions; 0 for the uninformed.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub weight: Vec<f64>,
    /// Preferred directions in radians; 0 for the uninformed.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub direction: Vec<f64>,
    /// Order and drift.
    pub order: Order,
    /// How exact this state is.
    pub certificate: Certificate,
}

impl State {
    /// Writes the state as CBOR.
    pub fn to_cbor(&self) -> Vec<u8> {
        to_cbor(self)
    }

    /// Reads a state from CBOR.
    ///
    /// # Errors
    ///
    /// What is wrong with `bytes`.
    pub fn from_cbor(bytes: &[u8]) -> Result<Self, String> {
        ciborium::from_reader(bytes).map_err(|error| error.to_string())
    }
}

/// Initial capacity: CBOR is written a word at a time, and most messages are no longer.
const USUAL_BYTES: usize = 256;

/// Writes any message as CBOR.
pub fn to_cbor<T: Serialize>(message: &T) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(USUAL_BYTES);
    ciborium::into_writer(message, &mut bytes).expect("writing to memory cannot fail");
    bytes
}

/// The order and drift of a swarm, now and as means since the start or the last reset.
///
/// Speeds are in free speeds; the means are over steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Order {
    /// The polar order parameter, the length of the mean heading: 0 to 1; eq. (8) without the mean.
    pub order: f64,
    /// Its time mean, `v` of eq. (8); `null` before the first step.
    pub mean_order: Option<f64>,
    /// The mean heading (x, y), which is the centroid's velocity in free speeds.
    pub velocity: [f64; 2],
    /// Its time mean; `null` before the first step.
    pub mean_velocity: Option<[f64; 2]>,
    /// The common direction of the informed individuals, radians: that of the sum of their
    /// directions, each times its weight; `null` if there are none, or they disagree so much that
    /// `direction_strength` is below 0.1.
    pub direction: Option<f64>,
    /// How far they agree, the length of that sum divided by the sum of the weights: 0 to 1; `null`
    /// if there are none, and from an earlier version.
    #[serde(default)]
    pub direction_strength: Option<f64>,
    /// The centroid's velocity along that direction, free speeds; `null` without one.
    pub drift: Option<f64>,
    /// Its mean over the steps with such a direction.
    pub mean_drift: Option<f64>,
}

/// The accuracy of a state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Certificate {
    /// The smallest gap between two bodies, body sizes; negative is overlap; `null` if no two are
    /// near. It is measured independently of the solver.
    pub worst_gap: Option<f64>,
    /// The residual `max |min(λ, s)|` of the step that led here, body sizes: at most 1e-9 unless
    /// the step was degraded.
    pub residual: f64,
    /// Number of steps since the start or reset with a larger residual.
    pub degraded: u64,
    /// Number of pairs with crossing axes. It is measured independently of the solver.
    pub crossed: u64,
    /// Number of contacts that constrained the step.
    pub contacts: u64,
    /// Number of iterations of the solver.
    pub iterations: u64,
}

/// A published order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OrderSample {
    /// The swarm's name.
    pub swarm: String,
    /// Increases when `step` does not continue what was published before.
    pub epoch: u64,
    /// The number of its published state.
    pub frame: u64,
    /// The number of steps since the start.
    pub step: u64,
    /// `step · dt`, body sizes over free speed.
    pub time: f64,
    /// The phase of the swarm.
    pub phase: Phase,
    /// The number of individuals.
    pub n: u64,
    /// How many individuals are informed.
    pub informed: u64,
    /// Order and drift.
    pub order: Order,
    /// How exact the state is.
    pub certificate: Certificate,
    /// Time units per second of wall clock that the swarm is asked to run at; `null` is as fast
    /// as possible.
    pub rate: Option<f64>,
    /// The rate that was reached lately; `null` while it does not run.
    pub real_time_factor: Option<f64>,
    /// The measures that the swarm publishes, by name, each in its unit; a value is `null` where it
    /// is undefined or the group too large. Left out without any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measures: Option<BTreeMap<String, Option<f64>>>,
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    fn state() -> State {
        State {
            swarm: "demo".into(),
            epoch: 1,
            frame: 2,
            step: 3,
            time: 0.06,
            phase: Phase::Paused,
            origin: [-1, 2],
            id: vec![0, 7],
            x: vec![0.1, -511.999_999_999_999_9],
            y: vec![1e-300, 0.0],
            alpha: vec![-270.02419291642303, 3.0],
            weight: vec![0.0, 0.5],
            direction: vec![0.0, -0.0],
            order: Order {
                order: 0.5,
                mean_order: None,
                velocity: [0.5, 0.0],
                mean_velocity: None,
                direction: None,
                direction_strength: None,
                drift: None,
                mean_drift: None,
            },
            certificate: Certificate {
                worst_gap: None,
                residual: 0.0,
                degraded: 0,
                crossed: 0,
                contacts: 0,
                iterations: 0,
            },
        }
    }

    #[test]
    fn columns_are_little_endian_typed_arrays_in_cbor() {
        let bytes = state().to_cbor();
        // "id", tag 70 (0xd8 0x46), a byte string of 8.
        let id = [0x62, b'i', b'd', 0xd8, 70, 0x48, 0, 0, 0, 0, 7, 0, 0, 0];
        assert!(bytes.windows(id.len()).any(|window| window == id));
        // "x", tag 86 (0xd8 0x56), a byte string of 16.
        let x = [0x61, b'x', 0xd8, 86, 0x50];
        assert!(bytes.windows(x.len()).any(|window| window == x));
    }

    #[test]
    fn what_is_read_back_is_the_same_double() {
        let bits = |state: &State| {
            let columns = [&state.x, &state.y, &state.alpha, &state.direction];
            columns.map(|column| column.iter().map(|x| x.to_bits()).collect::<Vec<_>>())
        };
        let before = state();
        let cbor = State::from_cbor(&before.to_cbor()).unwrap();
        let json: State = serde_json::from_str(&serde_json::to_string(&before).unwrap()).unwrap();
        assert_eq!(bits(&before), bits(&cbor));
        assert_eq!(bits(&before), bits(&json));
        assert_eq!(before, cbor);
    }

    #[test]
    fn bytes_cut_short_are_rejected() {
        let bytes = state().to_cbor();
        for length in [0, 1, 20, bytes.len() - 1] {
            assert!(State::from_cbor(&bytes[..length]).is_err());
        }
    }
}
