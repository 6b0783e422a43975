//! The commands on whole swarms: creating, stepping, copying, deleting them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::envelope::PLAIN_TEXT_RULE;
use crate::keys::NAME_RULE;
use crate::parameters::RATE_RANGE;
use crate::walk::lenient;
use crate::{LARGEST_WHOLE, Spec, State};

/// Creates a swarm; sent to a node. The swarm is created paused.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CreateArgs {
    /// The new swarm's name.
    #[schemars(regex(pattern = NAME_RULE))]
    pub name: String,
    /// Its spec.
    pub spec: Spec,
    /// Whether a swarm of that name with an equal spec is a success.
    #[serde(default)]
    pub exist_ok: bool,
}

/// The reply to `create`, `fork` and `restore`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CreateResult {
    /// False if an equal swarm existed.
    pub created: bool,
    /// Its spec, with all defaults.
    #[serde(deserialize_with = "lenient")]
    pub spec: Spec,
    /// BLAKE3 of the state, in hexadecimal.
    pub state_hash: String,
}

/// Deletes a swarm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DeleteArgs {}

/// Deletes one daemon's swarm. Sent to the node: a swarm's key may reach several daemons.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DiscardArgs {
    /// The swarm's name.
    #[schemars(regex(pattern = NAME_RULE))]
    pub name: String,
}

/// Runs a swarm to an end or until it is paused; changes the end and the rate of a running one.
/// Fields that are left out keep their values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RunArgs {
    /// Pause when this step is reached. At most one of `until_step` and `until_time`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = LARGEST_WHOLE))]
    pub until_step: Option<u64>,
    /// Pause at the first step at or after this time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e12))]
    pub until_time: Option<f64>,
    /// Time units per second of wall clock; `null` is as fast as possible; left out, no change.
    #[serde(
        default,
        deserialize_with = "present",
        skip_serializing_if = "Option::is_none"
    )]
    #[schemars(
        with = "Option<f64>",
        range(max = 1e6),
        extend("exclusiveMinimum" = 0, "x-range" = RATE_RANGE)
    )]
    pub rate: Option<Option<f64>>,
}

/// The reply to `run`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunResult {
    /// The step it will pause at; `null` if it has no end.
    #[schemars(range(max = LARGEST_WHOLE))]
    pub until_step: Option<u64>,
    /// Time units per second of wall clock; `null` is as fast as possible.
    pub rate: Option<f64>,
}

/// Pauses a swarm; no change if it is paused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PauseArgs {}

/// Creates a copy of a swarm, paused: both have the same states until they get different commands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ForkArgs {
    /// The new swarm's name.
    #[schemars(regex(pattern = NAME_RULE))]
    pub name: String,
    /// Copies the swarm as it was when it reached this step of its current epoch, before the
    /// commands at that step; left out, as it is now.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = LARGEST_WHOLE))]
    pub step: Option<u64>,
}

/// Creates a swarm from a snapshot, paused; sent to a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RestoreArgs {
    /// The new swarm's name.
    #[schemars(regex(pattern = NAME_RULE))]
    pub name: String,
    /// The snapshot as `get/snapshot` gave it, its CBOR as base64.
    #[schemars(extend("x-range" = "the `result` of get/snapshot, its CBOR in base64"))]
    pub snapshot: String,
}

/// Takes steps of a paused swarm as fast as possible, independent of its rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StepArgs {
    /// How many steps: 1 to 10⁹.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub steps: u64,
    /// What the reply contains.
    #[serde(default, rename = "return")]
    pub return_: Return,
}

/// What the reply to `step` contains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Return {
    /// The hash alone, as JSON.
    #[default]
    None,
    /// The state reached too; the whole reply is then CBOR.
    State,
}

/// The reply to `step`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StepResult {
    /// Number of steps that were taken; fewer than requested if another command interrupted them.
    pub steps: u64,
    /// The last step that a crash of the daemon would not take back. It follows `step` within a few
    /// milliseconds, unless the disk is full.
    #[serde(default)]
    pub durable_step: u64,
    /// BLAKE3 of the state, in hexadecimal.
    pub state_hash: String,
    /// The state after the steps, if requested. A retry of the request gets the cached reply, which
    /// has no state if the first one took more than 4 KiB: the reply is then JSON.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<State>,
}

/// Writes a note into the journal and the events of a swarm, in every phase. The note changes neither
/// the state nor the random draws of later commands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AnnotateArgs {
    /// The note: 1 to 1000 characters in one line, without control characters.
    #[schemars(
        length(min = 1, max = MAX_NOTE_CHARS),
        regex(pattern = PLAIN_TEXT_RULE),
        extend("x-range" = "1 to 1000 characters in one line, without control characters")
    )]
    pub text: String,
}

/// The longest text of `annotate`, in characters.
pub const MAX_NOTE_CHARS: usize = 1000;

/// Protects a swarm from `delete` and `reset`, which it then rejects with `incorrect_state`, or ends that.
/// In every phase. It changes neither the state nor the random draws of later commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ProtectArgs {
    /// Whether the swarm is protected from now on.
    pub on: bool,
}

/// Restarts a swarm from its spec, at step 0 of a new epoch, paused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ResetArgs {
    /// A new seed: 0 to 2⁵³ - 1; left out, the old one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = LARGEST_WHOLE))]
    pub seed: Option<u64>,
}

/// The reply to `reset`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ResetResult {
    /// The seed of the swarm.
    pub seed: u64,
    /// BLAKE3 of the state, in hexadecimal.
    pub state_hash: String,
}

/// The reply to a command with an `at_step` that lies ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Scheduled {
    /// The step at which the command will be executed; an event then has its result.
    pub applies_at_step: u64,
}

/// The result of a command without one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EmptyResult {}

pub(super) fn one() -> u64 {
    1
}

/// Distinguishes `null` from a field that is left out.
fn present<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: serde::Deserializer<'de>,
    T: Deserialize<'de>,
{
    T::deserialize(deserializer).map(Some)
}
