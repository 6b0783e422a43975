//! The arguments of `when`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::LARGEST_WHOLE;
use crate::verbs::changes::{CHANGES_RANGE, no_more_changes_if_given};
use crate::verbs::{Change, MAX_CHANGES};

/// Pauses a swarm, applies changes or publishes an event, once, at the first step after which a
/// condition holds. `condition`, or `cancel` alone or with `event` or `id`; with a condition exactly one of
/// `pause`, `commands` and `event`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WhenArgs {
    /// The condition, such as `order > 0.9 for 20`: 1 to 1000 characters. A waiting condition with
    /// the same text and action is replaced.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend(
        "x-range" = "a comparison of a measure with a number, such as \"order > 0.9 for 20\"; several are joined \
                     by `and` and `or`"
    ))]
    pub condition: Option<String>,
    /// Pause the swarm.
    #[serde(default, skip_serializing_if = "crate::is_false")]
    pub pause: bool,
    /// Apply these changes as a `batch`: all at one step, or none.
    #[serde(
        default,
        deserialize_with = "no_more_changes_if_given",
        skip_serializing_if = "Option::is_none"
    )]
    #[schemars(length(min = 1, max = MAX_CHANGES), extend("x-range" = CHANGES_RANGE))]
    pub commands: Option<Vec<Change>>,
    /// Only publish the event `fired` with this name, which has the form of a swarm's name; `get/wait`
    /// waits for it. A waiting condition with the same name is replaced. Such a command counts as an
    /// annotation: it changes no random draw.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub event: Option<String>,
    /// Evaluate states from this step on. If the swarm is there already, its present state is the
    /// first: if the condition holds in it, nothing waits. Left out, the first is that after the
    /// next step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = LARGEST_WHOLE))]
    pub from_step: Option<u64>,
    /// Remove the condition at this step, without evaluating it there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = LARGEST_WHOLE))]
    pub before_step: Option<u64>,
    /// With `commands`: as `draw` of `batch`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = LARGEST_WHOLE))]
    pub draw: Option<u64>,
    /// The command is part of a protocol. With `commands`: as `protocol` of `batch`. With `pause`: the
    /// condition ends the protocol: the commands of this step are not executed, and the scheduled
    /// commands and the other conditions, except those with `event`, are removed.
    #[serde(default, skip_serializing_if = "crate::is_false")]
    pub protocol: bool,
    /// Remove all waiting conditions, or with `event` the one with this name, or with `id` the one of this id.
    #[serde(default, skip_serializing_if = "crate::is_false")]
    pub cancel: bool,
    /// With `cancel`: the id of a condition, which `get/status` has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
}

/// The reply to `when`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct WhenResult {
    /// With `event`: whether the condition holds already, so that it does not wait; left out if it
    /// waits.
    #[serde(default, skip_serializing_if = "crate::is_false")]
    pub holds: bool,
    /// The id of the condition that waits now, by which `when` with `cancel` removes it; left out
    /// if none
    /// does, and in replies of earlier daemons.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
}
