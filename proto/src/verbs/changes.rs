//! The arguments and results of the verbs that change parameters or the group.

use std::fmt;

use schemars::JsonSchema;
use serde::de::{Error as _, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};

use crate::parameters::SetArgs;
use crate::{LARGEST_WHOLE, ParameterValues};

/// The reply to `set`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SetResult {
    /// The values before.
    pub before: ParameterValues,
    /// The values now.
    pub now: ParameterValues,
    /// The factor by which `make_room` scaled the positions; 1 is not at all.
    pub scaled_by: f64,
    /// As in `Status`; left out in a `batch`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published_hz: Option<f64>,
}

/// The individuals that a command changes. A draw is seeded by the swarm's seed and `seq`
/// minus the number of annotations so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[schemars(extend(
    "x-range" = "one of {\"ids\": […]}, {\"count\": 5}, {\"fraction\": 0.1}, {\"within\": {\"x\", \"y\", \
                 \"radius\"}}, {\"informed\": true}, {\"foremost\": {\"count\", \"along\"}}"
))]
pub enum Select {
    /// These.
    Ids(#[schemars(extend("x-range" = IDS_RANGE))] Vec<u32>),
    /// This many, drawn.
    Count(u64),
    /// This share, 0 to 1, drawn; rounded to a whole number of individuals.
    Fraction(#[schemars(range(min = 0.0, max = 1.0))] f64),
    /// All whose centre is in a disc.
    Within(Region),
    /// All with a direction of their own, or with `false` all without one.
    Informed(bool),
    /// The ones furthest along a direction.
    Foremost(Foremost),
}

/// A disc, in absolute positions and body sizes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// Its centre.
    pub x: f64,
    /// Its centre.
    pub y: f64,
    /// Its radius, above 0.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub radius: f64,
}

/// The `count` individuals furthest along a direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Foremost {
    /// How many.
    pub count: u64,
    /// The direction in radians, counter-clockwise from +x.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub along: f64,
}

/// Gives individuals a direction of their own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InformArgs {
    /// The individuals; draws are from all.
    pub select: Select,
    /// Their preferred direction in radians, counter-clockwise from +x.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub direction: f64,
    /// The weight of that direction beside attraction: above 0; `pi2` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub weight: Option<f64>,
    /// The time after which they are uninformed again, body sizes over free speed; for good if left
    /// out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e9))]
    pub for_time: Option<f64>,
}

/// Takes the preferred direction of individuals away.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UninformArgs {
    /// The individuals; draws are from the informed.
    pub select: Select,
}

/// Adds individuals, informed or not, where they overlap no other one. One of `count` and `at`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InjectArgs {
    /// Their number, at the border of the group, or in `within`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1))]
    pub count: Option<u64>,
    /// Their poses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(length(min = 1))]
    pub at: Option<Vec<Pose>>,
    /// With `count`: the disc in which they are drawn, absolute centre and radius in body sizes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within: Option<Region>,
    /// Informs them: their preferred direction in radians, counter-clockwise from +x.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -1e6, max = 1e6))]
    pub direction: Option<f64>,
    /// With `direction`: its weight beside attraction; `pi2` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub weight: Option<f64>,
}

/// Where a body is, in absolute positions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// Its centre, body sizes.
    pub x: f64,
    /// Its centre, body sizes.
    pub y: f64,
    /// Its heading in radians, counter-clockwise from +x.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub alpha: f64,
}

/// Takes individuals out of the group. The last one cannot be removed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RemoveArgs {
    /// The individuals; draws are from all.
    pub select: Select,
}

/// Applies all of several changes at one step, or none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BatchArgs {
    /// 1 to 256 of them, applied in this order as if each had been sent alone.
    #[serde(deserialize_with = "no_more_changes")]
    #[schemars(length(min = 1, max = MAX_CHANGES), extend("x-range" = CHANGES_RANGE))]
    pub commands: Vec<Change>,
    /// Seeds the draws of the first command together with the swarm's seed, instead of its `seq`;
    /// each further command adds 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = LARGEST_WHOLE))]
    pub draw: Option<u64>,
    /// The command is part of a protocol: without `draw`, the number of the swarm's changes so far by
    /// such commands seeds the draws, plus 1. The changes of commands with `draw` do not count.
    #[serde(default, skip_serializing_if = "crate::is_false")]
    pub protocol: bool,
}

/// What ids can be.
pub(super) const IDS_RANGE: &str = "a list of ids of individuals in the swarm";

/// What the changes of a `batch` can be.
pub(super) const CHANGES_RANGE: &str = "a list of 1 to 256 of {\"verb\": \"set\" | \"inform\" | \"uninform\" | \"inject\" | \"remove\", \"args\": {…}}";

/// Maximum number of changes in one `batch`.
pub const MAX_CHANGES: usize = 256;

/// A verb that changes parameters or the group, with its arguments.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(
    tag = "verb",
    content = "args",
    rename_all = "snake_case",
    deny_unknown_fields
)]
pub enum Change {
    /// Changes parameters.
    Set(SetArgs),
    /// Gives individuals a direction of their own.
    Inform(InformArgs),
    /// Takes individuals' direction away.
    Uninform(UninformArgs),
    /// Adds individuals.
    Inject(InjectArgs),
    /// Takes individuals out of the group.
    Remove(RemoveArgs),
}

/// The reply to `batch`; `seq` has increased by the number of its changes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BatchResult {
    /// The result of each change, in their order.
    pub results: Vec<Changed>,
}

/// The result of one change of a `batch`, which has the fields of its verb.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "verb", content = "result", rename_all = "snake_case")]
#[expect(clippy::large_enum_variant, reason = "there are few, and not for long")]
pub enum Changed {
    /// The parameters before and now.
    Set(SetResult),
    /// Who was informed.
    Inform(IdsResult),
    /// Who was uninformed.
    Uninform(IdsResult),
    /// Who joined.
    Inject(IdsResult),
    /// Who left.
    Remove(IdsResult),
}

/// The reply to `inform`, `uninform`, `inject` and `remove`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct IdsResult {
    /// The ids of the individuals concerned, ascending.
    pub ids: Vec<u32>,
    /// The size of the group after the command.
    pub n: u64,
}

/// Deserializes at most [`MAX_CHANGES`] changes, however long the list is.
fn no_more_changes<'de, D>(deserializer: D) -> Result<Vec<Change>, D::Error>
where
    D: serde::Deserializer<'de>,
{
    struct Changes;
    impl<'de> Visitor<'de> for Changes {
        type Value = Vec<Change>;

        fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(formatter, "a list of 1 to {MAX_CHANGES} commands")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut given: A) -> Result<Vec<Change>, A::Error> {
            let mut changes = Vec::new();
            while changes.len() < MAX_CHANGES
                && let Some(change) = given.next_element()?
            {
                changes.push(change);
            }
            if changes.len() == MAX_CHANGES && given.next_element::<IgnoredAny>()?.is_some() {
                return Err(A::Error::invalid_length(MAX_CHANGES + 1, &self));
            }
            Ok(changes)
        }
    }
    deserializer.deserialize_seq(Changes)
}

/// As [`no_more_changes`], for a field that may be left out.
pub(super) fn no_more_changes_if_given<'de, D>(
    deserializer: D,
) -> Result<Option<Vec<Change>>, D::Error>
where
    D: serde::Deserializer<'de>,
{
    no_more_changes(deserializer).map(Some)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn a_batch_has_at_most_256_commands() {
        let of = |count: usize| {
            let changes = vec![serde_json::json!({"verb": "set", "args": {"pi3": 2.0}}); count];
            serde_json::from_value::<BatchArgs>(serde_json::json!({ "commands": changes }))
        };
        for count in [1, 255, 256] {
            assert_eq!(of(count).unwrap().commands.len(), count);
        }
        let error = of(257).unwrap_err().to_string();
        assert!(error.contains("a list of 1 to 256 commands"), "{error}");
    }
}
