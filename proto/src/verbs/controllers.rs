//! The arguments and results of the verbs of controllers.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Return;
use super::changes::{IDS_RANGE, Select};
use super::swarms::one;
use crate::keys::NAME_RULE;
use crate::{LARGEST_WHOLE, State};

/// Registers a controller of a swarm, and claims individuals that no other controller may steer.
///
/// In lock-step the swarm steps when every controller has advanced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JoinArgs {
    /// Its name, which identifies it in further requests.
    #[schemars(regex(pattern = NAME_RULE))]
    pub controller: String,
    /// The individuals to steer; draws are from those that no other controller claims. Left out,
    /// none, or its previous ones if it joins again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub select: Option<Select>,
    /// When the swarm steps.
    #[serde(default)]
    pub mode: Mode,
    /// In lock-step, how long others wait for it; running freely, how long its set-points hold
    /// after the last put. Seconds: above 0, at most 60.
    #[serde(default = "five_secs")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 60.0))]
    pub deadline_secs: f64,
    /// What happens to its individuals when it is late. In lock-step the swarm then continues
    /// without it, and removes it after three misses in a row.
    #[serde(default)]
    pub on_timeout: OnTimeout,
    /// Whether it may drive individuals directly, by turning rate and speed. Beyond the paper.
    #[serde(default)]
    pub driving: bool,
    /// Whether it joins again: it replaces the controller of its name.
    #[serde(default)]
    pub again: bool,
}

/// When a swarm with a controller steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// When every controller in this mode has advanced.
    #[default]
    Lockstep,
    /// At its rate; the controller puts set-points on `ctl/{controller}`.
    FreeRunning,
}

/// What happens to the individuals of a late controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnTimeout {
    /// They keep their last set-points, also after it has left.
    #[default]
    Hold,
    /// They are uninformed.
    Free,
    /// The swarm pauses and replies to the waiting controllers.
    Pause,
}

/// The reply to `join`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JoinResult {
    /// The ids of the individuals that the controller steers.
    pub ids: Vec<u32>,
    /// What happened since it left, if it rejoins.
    pub news: News,
}

/// Permits steps of the swarm, which takes them when every controller has, and then replies.
/// `expect_step` of the envelope is the step at which the controller assumes the swarm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AdvanceArgs {
    /// The controller's name.
    #[schemars(regex(pattern = NAME_RULE))]
    pub controller: String,
    /// How many steps: 1 to 10⁹.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub steps: u64,
    /// Set-points from the next step on; individuals without one keep theirs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set: Option<SetPoints>,
    /// What the reply contains.
    #[serde(default, rename = "return")]
    pub return_: Return,
}

/// Set-points of individuals that a controller steers: columns of equal length.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend(
    "x-range" = "{\"ids\": […], \"direction\": […]}, optionally with \"weight\": […]"
))]
pub struct SetPoints {
    /// The individuals.
    #[schemars(extend("x-range" = IDS_RANGE))]
    pub ids: Vec<u32>,
    /// Their preferred directions in radians, counter-clockwise from +x.
    #[schemars(inner(range(min = -1e6, max = 1e6)))]
    pub direction: Vec<f64>,
    /// How much each counts beside attraction, 0 for uninformed; `pi2` each if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(inner(range(min = 0.0, max = 1e6)))]
    pub weight: Option<Vec<f64>>,
    /// Beyond the paper, for controllers that joined with `driving`: turning rates, angle over
    /// time, instead of those of the model; limited to the fastest free one, `pi3 (1 + largest
    /// weight)`. `null` for the model's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(inner(range(min = -1e6, max = 1e6)))]
    pub turn: Option<Vec<Option<f64>>>,
    /// Beyond the paper, for controllers that joined with `driving`: factors of the free speed, 0
    /// to 1. `null` for the model's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(inner(range(min = 0.0, max = 1.0)))]
    pub speed: Option<Vec<Option<f64>>>,
}

/// The reply to `advance`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AdvanceResult {
    /// How many steps were taken; fewer than asked for if another command came between.
    pub steps: u64,
    /// The last step that is durable: a crash of the daemon does not undo it.
    pub durable_step: u64,
    /// BLAKE3 of the state, in hexadecimal.
    pub state_hash: String,
    /// What happened since the last reply to this controller.
    pub news: News,
    /// The state after the steps, if requested. A retry of the request gets the cached reply, which
    /// has no state if the first one took more than 4 KiB: the reply is then JSON.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<State>,
}

/// What happened between two replies to a controller.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct News {
    /// Missed deadlines, also its own.
    pub missed: Vec<Miss>,
    /// Controllers that have left.
    pub left: Vec<Departed>,
    /// Ids of individuals of its own that were removed.
    pub removed: Vec<u32>,
}

/// A missed deadline.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Miss {
    /// The controller that missed it.
    pub controller: String,
    /// The step at which the swarm waited.
    pub step: u64,
    /// Number of misses in a row: with the third the controller has left.
    pub misses: u32,
}

/// A controller that has left.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Departed {
    /// Its name.
    pub controller: String,
    /// Why it has left.
    pub why: Departure,
}

/// Why a controller has left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Departure {
    /// It sent `leave`.
    Left,
    /// Its liveliness token disappeared.
    Lost,
    /// It missed three deadlines in a row, or sent nothing for `max_idle_secs`.
    Late,
}

/// Removes a controller. Its individuals become uninformed, unless it joined with `hold`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaveArgs {
    /// The controller's name.
    #[schemars(regex(pattern = NAME_RULE))]
    pub controller: String,
}

/// Set-points that a controller puts on `ctl/{controller}` while the swarm runs, as JSON or CBOR.
/// They apply at the next step; the newest wins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Control {
    /// Grows with every put: one that is not larger than the last is stale and dropped.
    #[schemars(range(min = 1, max = LARGEST_WHOLE))]
    pub sequence: u64,
    /// The epoch for which it is meant; in another one it is stale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub epoch: Option<u64>,
    /// The set-points.
    pub set: SetPoints,
}

fn five_secs() -> f64 {
    5.0
}
