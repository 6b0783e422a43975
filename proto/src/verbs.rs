//! The arguments and results of every verb.

use std::fmt;

use schemars::JsonSchema;
use serde::de::{Error as _, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};

use crate::envelope::PLAIN_TEXT_RULE;
use crate::keys::NAME_RULE;
use crate::walk::lenient;
use crate::{Attraction, ContactRule, LARGEST_WHOLE, ParameterValues, Spec, State, Stepping};

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

/// The result of `create`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CreateResult {
    /// False if an equal swarm existed.
    pub created: bool,
    /// The spec with every default filled in.
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
    #[schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub rate: Option<Option<f64>>,
}

/// How the swarm runs now.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunResult {
    /// The step it will pause at.
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

/// The result of `step`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StepResult {
    /// How many steps were taken; fewer than asked for if another command came between.
    pub steps: u64,
    /// The last step that is durable: a crash of the daemon does not undo it. It follows `step`
    /// within a few milliseconds, unless the disk is full.
    #[serde(default)]
    pub durable_step: u64,
    /// BLAKE3 of the state, in hexadecimal.
    pub state_hash: String,
    /// The state after the steps, if requested. A retry of the request gets the cached reply, which
    /// has no state if the first one took more than 4 KiB: the reply is then JSON.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<State>,
}

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

/// The result of `join`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JoinResult {
    /// The individuals that it steers, by id.
    pub ids: Vec<u32>,
    /// What happened while it was away, if it joins again.
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
pub struct SetPoints {
    /// The individuals.
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

/// The result of `advance`.
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
    /// Missed deadlines, its own too.
    pub missed: Vec<Miss>,
    /// Controllers that have left.
    pub left: Vec<Departed>,
    /// Individuals of its own that were removed.
    pub removed: Vec<u32>,
}

/// A missed deadline.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Miss {
    /// The late controller.
    pub controller: String,
    /// The step at which the swarm waited.
    pub step: u64,
    /// How many it has missed in a row; the third removes it.
    pub misses: u32,
}

/// A controller that has left.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Departed {
    /// The controller.
    pub controller: String,
    /// Why.
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
    /// It missed three deadlines in a row.
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

/// Writes a note into the journal and the events of a swarm, in every phase. The note changes neither
/// the state nor the random draws of later commands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AnnotateArgs {
    /// The note: 1 to 1000 characters in one line, without control characters.
    #[schemars(length(min = 1, max = MAX_NOTE_CHARS), regex(pattern = PLAIN_TEXT_RULE))]
    pub text: String,
}

/// The longest text of `annotate`, in characters.
pub const MAX_NOTE_CHARS: usize = 1000;

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

/// Restarts a swarm from its spec, at step 0 of a new epoch, paused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ResetArgs {
    /// A new seed: 0 to 2⁵³ - 1; left out, the old one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = LARGEST_WHOLE))]
    pub seed: Option<u64>,
}

/// The result of `reset`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ResetResult {
    /// Its seed.
    pub seed: u64,
    /// BLAKE3 of the state, in hexadecimal.
    pub state_hash: String,
}

/// Changes the given parameters, at least one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SetArgs {
    /// Length over width of a body: 1 to 32.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1.0, max = 32.0))]
    pub pi1: Option<f64>,
    /// Weight of individuals informed without one: 0 or more. Those informed keep theirs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e6))]
    pub pi2: Option<f64>,
    /// Body size over turning radius: above 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub pi3: Option<f64>,
    /// Translational over rotational drag: above 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub pi4: Option<f64>,
    /// Which of a pair's contacts constrain it; all but `closest` need that no axes cross.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contacts: Option<ContactRule>,
    /// What a contact limits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stepping: Option<Stepping>,
    /// How many more programs a step solves about what the last one predicts: 0 or 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = 1))]
    pub relinearise: Option<u8>,
    /// What an individual turns towards.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attraction: Option<Attraction>,
    /// Intensity of white noise on the turning rate, squared angle over time: 0 or more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e6))]
    pub noise: Option<f64>,
    /// Steps between two published states: 1 or more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub publish_every: Option<u64>,
    /// With `pi1`: scale positions about the centroid by the least factor that makes room.
    #[serde(default)]
    pub make_room: bool,
}

/// The result of `set`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SetResult {
    /// The values before.
    pub before: ParameterValues,
    /// The values now.
    pub now: ParameterValues,
    /// The factor by which positions were scaled to make room; 1 if they were not.
    pub scaled_by: f64,
}

/// The individuals that a command changes. A draw is seeded by the swarm's seed and `seq`
/// minus the number of annotations so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Select {
    /// These.
    Ids(Vec<u32>),
    /// This many, drawn.
    Count(u64),
    /// This share, 0 to 1, drawn; rounded to a whole number of individuals.
    Fraction(#[schemars(range(min = 0.0, max = 1.0))] f64),
    /// All whose centre is in a disc.
    Within(Region),
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
    /// How much it counts beside attraction, `pi2` if left out: above 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub weight: Option<f64>,
    /// After this many time units they are uninformed again; for good if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e9))]
    pub for_time: Option<f64>,
}

/// Takes individuals' direction away.
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
    /// How many, at the border of the group, or in `within`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1))]
    pub count: Option<u64>,
    /// Exactly there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(length(min = 1))]
    pub at: Option<Vec<Pose>>,
    /// With `count`: the disc they are drawn in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within: Option<Region>,
    /// Informs them: their preferred direction in radians.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -1e6, max = 1e6))]
    pub direction: Option<f64>,
    /// With `direction`: how much it counts beside attraction, `pi2` if left out.
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
    #[schemars(length(min = 1, max = MAX_CHANGES))]
    pub commands: Vec<Change>,
}

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

/// The results of the changes in a `batch`, in their order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BatchResult {
    /// One for each.
    pub results: Vec<Changed>,
}

/// The result of a change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "verb", content = "result", rename_all = "snake_case")]
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

/// The result of a command that is scheduled by `at_step`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Scheduled {
    /// The step at which it will be executed; an event then has its result.
    pub applies_at_step: u64,
}

/// The individuals that a command changed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct IdsResult {
    /// Their ids, ascending.
    pub ids: Vec<u32>,
    /// The size of the group now.
    pub n: u64,
}

/// The result of a command without one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EmptyResult {}

fn one() -> u64 {
    1
}

fn five_secs() -> f64 {
    5.0
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

/// Distinguishes `null` from a field that is left out.
fn present<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: serde::Deserializer<'de>,
    T: Deserialize<'de>,
{
    T::deserialize(deserializer).map(Some)
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
