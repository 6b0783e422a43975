//! Replies on the `get` keys.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use std::collections::BTreeMap;

use serde_json::Value;

use crate::verbs::{Mode, OnTimeout};
use crate::{Certificate, Event, LARGEST_WHOLE, Order, ParameterValues, Phase, Replay};

/// A swarm's reply to `get/status`; phase, step and time are in the envelope.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Status {
    /// Why it is paused or faulted.
    pub reason: Option<String>,
    /// What went wrong, if it has faulted; left out otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<Fault>,
    /// The number of the swarm in the store of its daemon: another swarm that gets this name later has
    /// another one. Left out for a replay.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub swarm_id: Option<u64>,
    /// What it was made from; left out if it was created from a spec, and for swarms made by earlier
    /// versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin: Option<Origin>,
    /// The step it will pause at.
    pub until_step: Option<u64>,
    /// Time units per second of wall clock; `null` is as fast as possible.
    pub rate: Option<f64>,
    /// The rate that was reached lately; `null` while it does not run.
    pub real_time_factor: Option<f64>,
    /// Whether it lately omitted steps that were due, since they take longer than `rate` allows on the
    /// cores that it gets.
    #[serde(default)]
    pub behind_rate: bool,
    /// How many states a second it publishes at most while it runs: what `rate`, `dt` and
    /// `publish_every` ask for, or the daemon's `max_hz` if that is less. Left out for a replay.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published_hz: Option<f64>,
    /// The number of individuals.
    pub n: u64,
    /// How many individuals are informed.
    pub informed: u64,
    /// The seed of every draw.
    pub seed: u64,
    /// The time step.
    pub dt: f64,
    /// The parameters that commands can change.
    pub parameters: ParameterValues,
    /// Commands that wait for their step.
    pub scheduled: u64,
    /// The conditions that it waits for, in the order of their commands; left out without any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub when: Option<Vec<String>>,
    /// The same conditions: their ids, actions and clients; left out without any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<WaitingCondition>,
    /// The conditions for which clients wait by `get/wait`; left out without any. They are no part of the
    /// swarm's state.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub waits: Vec<WaitingClient>,
    /// How many controllers have joined.
    #[serde(default)]
    pub controllers: u64,
    /// The controllers that the swarm waits for in lock-step.
    #[serde(default)]
    pub waiting_for: Vec<Awaited>,
    /// BLAKE3 of the state, in hexadecimal; zeros for a replay, which has frames and no state.
    pub state_hash: String,
    /// Order and drift.
    pub order: Order,
    /// How exact the state is.
    pub certificate: Certificate,
    /// The start of its stored history; `null` while that cannot be read.
    pub history_from: Option<HistoryFrom>,
    /// The position, if it is the playback of a recording.
    #[serde(default)]
    pub replay: Option<Replay>,
    /// The share of its history that a `verify` under way has replayed, from 0 to 1; `null` if none
    /// is under way.
    #[serde(default)]
    pub verifying: Option<f64>,
}

/// What went wrong in a swarm that has faulted. `reason` says it in words.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Fault {
    /// What it is: `crossed_bodies`; `not_solved`, if no solution of a step was exact enough; `overturned`, if
    /// the attraction turned an individual too far in one step; `not_finite`, if a position is no number;
    /// `other` if the step does not fail: a stored line is damaged, a replay had another hash, or the daemon has
    /// a defect. Later versions may have more.
    pub kind: String,
    /// The individuals that it is about; empty if it is about none in particular.
    pub ids: Vec<u32>,
    /// The gap between the two bodies that cross, in the last good state, body sizes; `null` for others.
    pub gap: Option<f64>,
}

/// What a swarm was made from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Origin {
    /// How it was made.
    pub kind: OriginKind,
    /// The swarm that was forked, saved in a snapshot or recorded; `null` if a snapshot has no name that a
    /// swarm can have.
    pub swarm: Option<String>,
    /// The number of that swarm in the store of this daemon; `null` if it may be of another daemon.
    pub swarm_id: Option<u64>,
    /// Its step then.
    pub step: u64,
    /// The number of its commands before; `null` for a replay.
    pub seq: Option<u64>,
    /// BLAKE3 of its state then, in hexadecimal; `null` for a replay.
    pub state_hash: Option<String>,
}

/// How a swarm was made from another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OriginKind {
    /// By `fork`.
    Fork,
    /// By `restore`, from a snapshot.
    Restore,
    /// By `replay`, from a recording.
    Play,
}

/// A condition of `when` that waits.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct WaitingCondition {
    /// By which `when` with `cancel` removes it: 8 hexadecimal digits, the same for equal conditions with
    /// equal actions.
    pub id: String,
    /// The condition.
    pub condition: String,
    /// What the swarm does once it holds.
    pub action: WaitingAction,
    /// The name of its event; left out without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub event: Option<String>,
    /// The client that sent it, as the request names it; `null` if it does not.
    pub client: Option<String>,
    /// Whether it is evaluated, left out if it is. If not, it does not hold: the group has grown, or an earlier
    /// version accepted more conditions, so that their measures need too much time or too many earlier states.
    #[serde(default = "is_evaluated", skip_serializing_if = "Clone::clone")]
    pub evaluated: bool,
}

/// Earlier versions did not say that a condition is not evaluated.
fn is_evaluated() -> bool {
    true
}

/// What a swarm does once a condition holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WaitingAction {
    /// It pauses.
    Pause,
    /// It applies changes.
    Commands,
    /// It publishes an event.
    Event,
}

/// A client that waits for a condition by `get/wait`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct WaitingClient {
    /// The condition.
    pub condition: String,
    /// The user; `null` on a daemon without users.
    pub user: Option<String>,
}

/// A controller that the others wait for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Awaited {
    /// Its name.
    pub controller: String,
    /// For how long, seconds.
    pub secs: f64,
    /// The timeout of this wait, seconds.
    pub deadline_secs: f64,
}

/// A swarm's reply to `get/controllers`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControllerList {
    /// The joined controllers, by name.
    pub controllers: Vec<Controller>,
}

/// A controller that has joined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Controller {
    /// Its name.
    pub controller: String,
    /// When the swarm steps.
    pub mode: Mode,
    /// The individuals that it steers, by id.
    pub ids: Vec<u32>,
    /// How long others wait for it, or how long its set-points hold, seconds.
    pub deadline_secs: f64,
    /// What happens to its individuals when it is late.
    pub on_timeout: OnTimeout,
    /// Whether it may drive individuals directly.
    pub driving: bool,
    /// The step that it has advanced to; `null` unless in lock-step.
    pub target_step: Option<u64>,
    /// Deadlines missed in a row.
    pub misses: u32,
    /// For how long others have waited for it, seconds; `null` if they do not.
    pub waited_secs: Option<f64>,
    /// The outcomes of its puts.
    pub puts: Puts,
}

/// The outcomes of a controller's puts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Puts {
    /// Applied.
    pub applied: u64,
    /// Not newer than one before, or of another epoch.
    pub stale: u64,
    /// Overtaken by a newer one before the next step.
    pub overtaken: u64,
    /// Unreadable, out of range, not permitted, or about individuals that are not its own.
    pub refused: u64,
}

/// The oldest stored checkpoint of a swarm: all after it can be replayed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HistoryFrom {
    /// Its epoch.
    pub epoch: u64,
    /// Its step.
    pub step: u64,
}

/// Whether a replay of a swarm's journal gives the same hashes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Verified {
    /// The step of the checkpoint from which it was replayed.
    pub from_step: u64,
    /// The step to which it was replayed.
    pub to_step: u64,
    /// How many hashes were compared: those in the journal, and the current one of a swarm that is
    /// paused.
    pub hashes: u64,
    /// The first step with a different hash; `null` if there is none.
    pub differs_at: Option<u64>,
    /// The epoch of that step: a reset restarts the count of steps.
    pub differs_in_epoch: Option<u64>,
}

/// The commands of a swarm since its start, as the file of an experiment with one run.
///
/// The parameter `replicates` of the query gives the run other seeds, so many. The file contains the
/// set-points of controllers as the text of a CSV; with the parameter `setpoints`, a name of a file, it
/// names that one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ExperimentFile {
    /// The text of the file, TOML. Its run takes the steps of the swarm.
    pub file: String,
    /// The text of the CSV of set-points that the file names, with the parameter `setpoints`; left out
    /// if no controller steered an individual.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub setpoints: Option<String>,
    /// The step of the swarm.
    #[schemars(range(max = LARGEST_WHOLE))]
    pub steps: u64,
    /// BLAKE3 of the state at that step, in hexadecimal. The run ends with it, unless commands were
    /// applied at that step: then the run takes one more step.
    pub state_hash: String,
}

/// A swarm's reply to `get/parameters`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Parameters {
    /// All but the start, in the order of the spec.
    pub parameters: Vec<Parameter>,
}

/// A parameter of a swarm, described for a form or a slider.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Parameter {
    /// Its name in the spec.
    pub name: String,
    /// What it means, in a line.
    pub doc: String,
    /// Its unit; `1` if it has none.
    pub unit: String,
    /// What values it takes.
    pub kind: ParameterKind,
    /// The least value; `null` if there is none.
    pub minimum: Option<f64>,
    /// The value that it must exceed; `null` if there is none.
    pub exclusive_minimum: Option<f64>,
    /// The largest value at present; `null` if there is none.
    pub maximum: Option<f64>,
    /// What it usually is; `null` of a parameter without such a range, and of daemons of earlier versions.
    #[serde(default)]
    pub usual: Option<Usual>,
    /// The values of a choice, of those that take numbers the kind alone; empty otherwise.
    pub choices: Vec<Value>,
    /// Whether `null` is a value.
    pub nullable: bool,
    /// The value if left out; `null` if it is required.
    pub default: Value,
    /// The current value.
    pub value: Value,
    /// Whether commands can change it.
    pub live: bool,
    /// The verbs that change it.
    pub changed_by: Vec<String>,
}

/// The usual values of a parameter, for a slider: those of the paper where it varies one, else around its
/// value. Others are valid, too.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Usual {
    /// The least.
    pub from: f64,
    /// The largest.
    pub to: f64,
    /// How they are spread.
    pub scale: Scale,
}

/// How values are spread over a range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// Evenly.
    Linear,
    /// Evenly in their logarithms.
    Logarithmic,
}

/// What values a parameter takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ParameterKind {
    /// A double.
    Number,
    /// A whole number.
    Integer,
    /// One of several.
    Choice,
}

/// A swarm's reply to `get/measures?names=NAME,...`, or with a histogram to
/// `get/measures?histogram=NAME;bins=COUNT;max=LENGTH`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Measures {
    /// The requested measures of the newest state, in the requested order.
    pub measures: Vec<MeasureValue>,
    /// The requested histogram of the newest state.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub histogram: Option<Histogram>,
}

/// A histogram of a state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Histogram {
    /// Its name: `pair_correlation` or `neighbour_density`.
    pub name: String,
    /// The unit of its values; `1` if they have none.
    pub unit: String,
    /// The edges of the bins of one axis, body sizes: one more than the axis has bins.
    pub edges: Vec<f64>,
    /// The number of ordered pairs of individuals in each bin. The bins of `neighbour_density` are
    /// squares: rows from the back to the front, each from the right to the left.
    pub counts: Vec<u64>,
    /// The value of each bin.
    pub values: Vec<f64>,
}

/// A measure of a state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MeasureValue {
    /// Its name with its argument, unless that is the default: `order`, `clusters.count(0.1)`.
    pub name: String,
    /// Its value; `null` if it is undefined, such as `drift` without informed individuals.
    pub value: Option<f64>,
    /// Its unit; `1` if it has none.
    pub unit: String,
}

/// A swarm's reply to `get/events?after=NUMBER`: the events it still has, oldest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Events {
    /// Those after the requested number, as many as one reply holds.
    pub events: Vec<Event>,
    /// The number of the oldest one that it still has; `null` if it has none.
    pub oldest: Option<u64>,
    /// The number of the newest one: query until it is reached. 0 before the first.
    pub newest: u64,
}

/// A swarm's reply to `get/journal?after=SEQ`: the commands it applied, oldest first.
///
/// The spec and these commands determine the state of the swarm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Journal {
    /// Those after the requested `seq` that the request selects, as many as one reply holds.
    pub entries: Vec<JournalEntry>,
    /// The `seq` of the oldest one that it still has; `null` if it has none.
    pub oldest: Option<u64>,
    /// The `seq` of the newest one. 0 before the first.
    pub newest: u64,
    /// The line of the journal at which the next page begins: query again with it as `line`, also
    /// if this page has no entries. Left out by the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next: Option<u64>,
}

/// A command that was applied.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JournalEntry {
    /// Counts the swarm's applied commands; a `batch` counts each of its changes, and has the
    /// number of the last.
    pub seq: u64,
    /// The epoch it was applied in.
    pub epoch: u64,
    /// The step it was applied at.
    pub step: u64,
    /// `step · dt`.
    pub time: f64,
    /// The daemon's wall clock when it was applied: seconds since 1970, UTC, to the millisecond;
    /// `null` if it is not known, as in what older versions journaled.
    #[serde(default)]
    pub unix_secs: Option<f64>,
    /// Its verb.
    pub verb: String,
    /// Its arguments as received.
    pub args: Value,
    /// The client, as the request names it.
    pub client: Option<String>,
    /// The id that its client gave it.
    pub request_id: Option<String>,
}

/// A node's reply to `get/audit`: who sent which commands, oldest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Audit {
    /// The lines that the request selects, as many as one reply holds.
    pub lines: Vec<AuditLine>,
    /// The number of the oldest line that the daemon still has; `null` if it has none.
    pub oldest: Option<u64>,
    /// The number of the newest line; 0 before the first.
    pub newest: u64,
    /// How many of the selected lines are damaged: they are left out.
    pub damaged: u64,
}

/// Equal commands of one client within a minute.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuditLine {
    /// Counts the lines of the daemon.
    pub number: u64,
    /// The daemon's wall clock when the first command was received: seconds since 1970, UTC.
    pub unix_secs: f64,
    /// The same for the last one.
    pub last_unix_secs: f64,
    /// How many commands there were.
    pub count: u64,
    /// The user of the token; `null` from a daemon without users, and for an unknown token.
    pub user: Option<String>,
    /// What the client calls itself; `null` if it does not.
    pub client: Option<String>,
    /// The verb.
    pub verb: String,
    /// What an `experiment`, `record` or `replay` does, such as `cancel`; `null` for other verbs.
    pub action: Option<String>,
    /// The swarm, experiment or recording; of `create`, `restore` and `replay` the new swarm.
    pub name: Option<String>,
    /// How the commands ended. What is missing to `count` had no outcome when the line was stored.
    pub outcomes: Vec<AuditOutcome>,
}

/// How commands ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AuditOutcome {
    /// `ok`, the code of the error, or `abandoned` of a command that ended because its client was gone.
    pub outcome: String,
    /// How many commands ended so.
    pub count: u64,
}

/// A node's reply to `get/hello`: its version and limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Hello {
    /// The daemon's version.
    pub version: String,
    /// The version of the contract.
    pub wire_version: u32,
    /// The daemon's clock: seconds since 1970, UTC.
    pub unix_secs: f64,
    /// The limits it enforces.
    pub limits: Limits,
    /// Where it serves HTTP, such as `https://0.0.0.0:8443`; absent if it serves none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub http: Option<String>,
    /// Its data, by a number that the daemon drew when it began their database. A daemon with the same id
    /// has the replies to commands that were executed, so that a command can be sent again after a restart.
    /// Absent if the daemon could not store it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data_id: Option<String>,
}

/// The limits of a daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Limits {
    /// Individuals in one swarm.
    pub max_individuals: u64,
    /// Swarms at once.
    pub max_swarms: u64,
    /// Memory of all swarms together, in bytes.
    pub max_memory_bytes: u64,
    /// The longest request, in bytes; a longer one is rejected, and zenoh drops one of more than 1
    /// MiB without an error.
    pub max_message_bytes: u64,
    /// Clients at once; while more are connected, `get/hello` is rejected.
    pub max_clients: u64,
    /// States published per second and swarm.
    pub max_hz: u64,
}

/// A node's reply to `get/status`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NodeStatus {
    /// Seconds since the daemon started.
    pub uptime_secs: f64,
    /// Swarms it hosts.
    pub swarms: u64,
    /// How many of them run.
    pub running: u64,
    /// How many of them faulted.
    pub faulted: u64,
    /// Individuals in all swarms together.
    pub individuals: u64,
    /// Memory reserved for the swarms and the experiment that goes on, in bytes.
    pub memory_bytes: u64,
    /// Of it, memory reserved for that experiment, in bytes.
    #[serde(default)]
    pub experiments_memory_bytes: u64,
    /// Clients connected.
    pub clients: u64,
}

/// A node's reply to `get/schema`: JSON Schemas (2020-12) of every message.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Schemas {
    /// The version of the contract they describe.
    pub wire_version: u32,
    /// By the name of the message, such as `step.args`.
    pub schemas: BTreeMap<String, Value>,
}

/// A node's reply to `get/swarms`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Swarms {
    /// All it hosts, ordered by name.
    pub swarms: Vec<SwarmSummary>,
}

/// A swarm in a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SwarmSummary {
    /// Its name.
    pub swarm: String,
    /// Its phase.
    pub phase: Phase,
    /// Why it is paused or faulted.
    pub reason: Option<String>,
    /// The number of steps since the start.
    pub step: u64,
    /// `step · dt`.
    pub time: f64,
    /// The number of individuals.
    pub n: u64,
    /// How many individuals are informed.
    pub informed: u64,
    /// The polar order parameter.
    pub order: f64,
    /// Time units per second of wall clock; `null` is as fast as possible.
    pub rate: Option<f64>,
    /// The rate that was reached lately; `null` while it does not run.
    pub real_time_factor: Option<f64>,
    /// Whether it is the playback of a recording.
    #[serde(default)]
    pub replay: bool,
    /// As in its status.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub swarm_id: Option<u64>,
    /// As in its status.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin: Option<Origin>,
    /// The other daemon that has a swarm of this name, if there is one; see `contested`.
    #[serde(default)]
    pub contested_by: Option<String>,
}
