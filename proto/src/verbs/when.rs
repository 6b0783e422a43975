//! The arguments of `when`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::verbs::changes::no_more_changes_if_given;
use crate::verbs::{Change, MAX_CHANGES};

/// Pauses a swarm, or applies changes, once, at the first step after which a condition holds. Exactly
/// one of `condition` and `cancel`; with a condition exactly one of `pause` and `commands`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WhenArgs {
    /// The condition, such as `order > 0.9 for 20`: 1 to 1000 characters. A waiting condition with
    /// the same text and action is replaced.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// Pause the swarm.
    #[serde(default, skip_serializing_if = "is_false")]
    pub pause: bool,
    /// Apply these changes as a `batch`: all at one step, or none.
    #[serde(
        default,
        deserialize_with = "no_more_changes_if_given",
        skip_serializing_if = "Option::is_none"
    )]
    #[schemars(length(min = 1, max = MAX_CHANGES))]
    pub commands: Option<Vec<Change>>,
    /// Remove all waiting conditions.
    #[serde(default, skip_serializing_if = "is_false")]
    pub cancel: bool,
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_false(value: &bool) -> bool {
    !value
}
