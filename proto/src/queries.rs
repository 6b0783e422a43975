//! Replies on the `get` keys.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use std::collections::BTreeMap;

use serde_json::Value;

use crate::verbs::{Mode, OnTimeout};
use crate::{Certificate, Event, LARGEST_WHOLE, Order, ParameterValues, Phase, Replay, Usual};

/// The status of a swarm; its phase, step and time are in the envelope.
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
    /// The earlier versions of the model that computed steps of it or of what it was made from, since
    /// their start or reset, oldest first; left out without any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub earlier_models: Vec<EarlierModel>,
    /// Whether `protect` protects it from `delete` and `reset`.
    #[serde(default, skip_serializing_if = "crate::is_false")]
    #[schemars(extend("default" = false))]
    pub protected: bool,
    /// The step it will pause at; `null` if it has no end.
    pub until_step: Option<u64>,
    /// Time units per second of wall clock; `null` is as fast as possible.
    pub rate: Option<f64>,
    /// The rate that it reached lately; `null` while it does not run.
    pub real_time_factor: Option<f64>,
    /// Whether it lately omitted steps that were due, since they take longer than `rate` allows on the
    /// cores that it gets.
    #[serde(default)]
    pub behind_rate: bool,
    /// How many states a second it publishes at most while it runs: what `rate`, `dt` and
    /// `publish_every` ask for, or the daemon's `max_hz` if that is less; left out for a
    /// playback and in replies of earlier daemons.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published_hz: Option<f64>,
    /// The size of the group.
    pub n: u64,
    /// Number of informed individuals.
    pub informed: u64,
    /// The seed of all random draws.
    pub seed: u64,
    /// The time step, body sizes over free speed.
    pub dt: f64,
    /// The parameters that `set` can change.
    pub parameters: ParameterValues,
    /// Number of commands that wait for their step.
    pub scheduled: u64,
    /// The conditions that it waits for, in the order of their commands; left out without any. See
    /// `when`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub when: Option<Vec<String>>,
    /// The same conditions: their ids, actions and clients; left out without any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<WaitingCondition>,
    /// The conditions for which clients wait by `get/wait`; left out without any. They are no part
    /// of the state.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub waits: Vec<WaitingClient>,
    /// Number of controllers that have joined.
    #[serde(default)]
    pub controllers: u64,
    /// The controllers that the swarm waits for in lock-step.
    #[serde(default)]
    pub waiting_for: Vec<Awaited>,
    /// BLAKE3 of the state, in hexadecimal; zeros for a replay, which has frames and no state.
    pub state_hash: String,
    /// Order and drift.
    pub order: Order,
    /// The accuracy of the state.
    pub certificate: Certificate,
    /// The oldest stored checkpoint; `null` while it cannot be read.
    pub history_from: Option<HistoryFrom>,
    /// The position, if it is a playback.
    #[serde(default)]
    pub replay: Option<Replay>,
    /// The fraction of the history that a running `verify` has replayed, 0 to 1; `null` if none is
    /// running.
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

/// An earlier version of the model that computed steps of a swarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EarlierModel {
    /// The version.
    pub model_version: u32,
    /// The epoch of the last state that it computed.
    pub epoch: u64,
    /// The step of that state.
    pub step: u64,
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
    /// `pause`, `commands` or `event`.
    pub action: WaitingAction,
    /// The name of its event; left out without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub event: Option<String>,
    /// The client that sent it, as the request names it; `null` if it is not known.
    pub client: Option<String>,
    /// False if the condition does not hold since its measures need too much time or too many
    /// earlier states: the group has grown, or an earlier version accepted more of them. Left out
    /// if it is evaluated.
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

/// A controller that the others wait for in lock-step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Awaited {
    /// Its name.
    pub controller: String,
    /// Seconds that they have waited.
    pub secs: f64,
    /// Its deadline, seconds.
    pub deadline_secs: f64,
}

/// The controllers that have joined a swarm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControllerList {
    /// The controllers that have joined, by name.
    pub controllers: Vec<Controller>,
}

/// A controller that has joined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Controller {
    /// Its name.
    pub controller: String,
    /// `lockstep` or `free_running`.
    pub mode: Mode,
    /// The ids of the individuals that it steers.
    pub ids: Vec<u32>,
    /// Seconds that others wait for it, or that its set-points apply.
    pub deadline_secs: f64,
    /// What happens to its individuals when it is late.
    pub on_timeout: OnTimeout,
    /// Whether it may set turning rates and speeds.
    pub driving: bool,
    /// The step that it has advanced to; `null` unless in lock-step.
    pub target_step: Option<u64>,
    /// Number of deadlines missed in a row.
    pub misses: u32,
    /// Seconds that others have waited for it; `null` if they do not.
    pub waited_secs: Option<f64>,
    /// The outcomes of its puts.
    pub puts: Puts,
}

/// Numbers of a controller's puts, by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Puts {
    /// Applied ones.
    pub applied: u64,
    /// Those that were not newer than one before, or of another epoch.
    pub stale: u64,
    /// Those that a newer one overtook before the next step.
    pub overtaken: u64,
    /// Those that were unreadable, out of range, not permitted, or for individuals of another
    /// controller.
    pub refused: u64,
}

/// The oldest stored checkpoint of a swarm: the history after it can be replayed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HistoryFrom {
    /// Its epoch.
    pub epoch: u64,
    /// Its step.
    pub step: u64,
}

/// The result of a replay of a swarm's history.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Verified {
    /// The step of the checkpoint that it began at.
    pub from_step: u64,
    /// The step that it ended at.
    pub to_step: u64,
    /// Number of hashes that were compared: those in the history, and the present one of a paused
    /// swarm.
    pub hashes: u64,
    /// The first step whose hash differs; `null` if there is none.
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
    /// The text of the CSV of set-points that the file names; left out if it names none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub setpoints: Option<String>,
    /// The step of the swarm.
    #[schemars(range(max = LARGEST_WHOLE))]
    pub steps: u64,
    /// BLAKE3 of the state at that step, in hexadecimal. The run ends with it, unless commands were
    /// applied at that step: then the run takes one more step.
    pub state_hash: String,
}

/// All parameters of a swarm except its start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Parameters {
    /// All but the start, in the order of the spec.
    pub parameters: Vec<Parameter>,
}

/// A parameter of a swarm, with the data of a form or a slider.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Parameter {
    /// Its name in the spec.
    pub name: String,
    /// A description in one line.
    pub doc: String,
    /// Its unit; `1` if it has none.
    pub unit: String,
    /// The type of its values: `number`, `integer` or `choice`.
    pub kind: ParameterKind,
    /// The smallest value; `null` if there is none.
    pub minimum: Option<f64>,
    /// The value must be above this; `null` if there is no such bound.
    pub exclusive_minimum: Option<f64>,
    /// The largest value at present; `null` if there is none.
    pub maximum: Option<f64>,
    /// Its usual values; `null` if it has none, and of daemons of earlier versions.
    #[serde(default)]
    pub usual: Option<Usual>,
    /// The values of a choice, without their numbers; empty otherwise.
    pub choices: Vec<Value>,
    /// Whether `null` is a value.
    pub nullable: bool,
    /// The default; `null` if it must be given.
    pub default: Value,
    /// The present value.
    pub value: Value,
    /// Whether a command can change it.
    pub live: bool,
    /// The verbs that change it.
    pub changed_by: Vec<String>,
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

/// Measures of the newest state of a swarm, or a histogram of it.
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

/// A page of the events that a daemon stores of a swarm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Events {
    /// The events of the page, oldest first.
    pub events: Vec<Event>,
    /// The number of the oldest stored event; `null` if there is none.
    pub oldest: Option<u64>,
    /// The number of the newest event: query until it is reached; 0 before the first.
    pub newest: u64,
}

/// A page of the commands that a daemon stores of a swarm.
///
/// The spec and these commands determine the state of the swarm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Journal {
    /// The entries of the page, oldest first.
    pub entries: Vec<JournalEntry>,
    /// The `seq` of the oldest stored entry; `null` if there is none.
    pub oldest: Option<u64>,
    /// The `seq` of the newest entry; 0 before the first.
    pub newest: u64,
    /// The line of the journal at which the next page begins: query again with it as `line`, also
    /// if this page has no entries; left out after the last page, and in
    /// replies of earlier daemons.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next: Option<u64>,
}

/// A command that a swarm applied.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JournalEntry {
    /// The number of the command; each change of a `batch` has one, and its entry has that of the
    /// last.
    pub seq: u64,
    /// The epoch in which it was applied.
    pub epoch: u64,
    /// The step at which it was applied.
    pub step: u64,
    /// `step · dt`, body sizes over free speed.
    pub time: f64,
    /// The daemon's wall clock, seconds since 1970, UTC; `null` if it is not known, as in entries
    /// of older daemons.
    #[serde(default)]
    pub unix_secs: Option<f64>,
    /// Its verb.
    pub verb: String,
    /// Its arguments as they were sent.
    pub args: Value,
    /// The name of the client that sent it.
    pub client: Option<String>,
    /// The id of the request.
    pub request_id: Option<String>,
}

/// A page of the audit log: who sent which commands, oldest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Audit {
    /// The lines that the request selects, as many as one reply holds.
    pub lines: Vec<AuditLine>,
    /// The number of the oldest stored line; `null` if there is none.
    pub oldest: Option<u64>,
    /// The number of the newest line; 0 before the first.
    pub newest: u64,
    /// Number of selected lines that are damaged, and therefore missing.
    pub damaged: u64,
}

/// Equal commands of one client within a minute.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuditLine {
    /// The number of the line, from 1.
    pub number: u64,
    /// The daemon's wall clock when it received the first of them, seconds since 1970, UTC.
    pub unix_secs: f64,
    /// The same for the last of them.
    pub last_unix_secs: f64,
    /// Number of commands.
    pub count: u64,
    /// The user of the token; `null` from a daemon without users, and for an unknown token.
    pub user: Option<String>,
    /// The name that the client gives itself; `null` if it gives none.
    pub client: Option<String>,
    /// The verb.
    pub verb: String,
    /// What an `experiment`, `record` or `replay` does, such as `cancel`; `null` for other verbs.
    pub action: Option<String>,
    /// The swarm, experiment or recording; of `create`, `restore` and `replay` the new swarm.
    pub name: Option<String>,
    /// How the commands ended. Those missing to `count` had no outcome when the line was stored.
    pub outcomes: Vec<AuditOutcome>,
}

/// How commands ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AuditOutcome {
    /// `ok`, the code of the error, such as `permission_denied`, or `abandoned` of a command that
    /// ended because its client was gone.
    pub outcome: String,
    /// Number of commands that ended so.
    pub count: u64,
}

/// The name, version and limits of a daemon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Hello {
    /// The daemon's version.
    pub version: String,
    /// The version of the contract that it speaks.
    pub wire_version: u32,
    /// Its clock: seconds since 1970, UTC.
    pub unix_secs: f64,
    /// Its limits.
    pub limits: Limits,
    /// The address of its HTTP server, such as `https://0.0.0.0:8443`; left out if it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub http: Option<String>,
    /// Its data folder, by a number that the daemon drew when it began the folder's database; a
    /// restored backup has another one. A daemon with the same id has the replies to commands that
    /// were executed, so that a command can be sent again after a restart. Left out if the daemon
    /// could not store it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data_id: Option<String>,
}

/// The limits of a daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Limits {
    /// Number of individuals of a swarm.
    pub max_individuals: u64,
    /// Number of swarms.
    pub max_swarms: u64,
    /// Memory of all swarms together, bytes.
    pub max_memory_bytes: u64,
    /// Length of a request, bytes; a longer one is rejected, and zenoh drops one of more than 1 MiB
    /// without an error.
    pub max_message_bytes: u64,
    /// Number of connected clients; beyond it `get/hello` is rejected with `resource_exhausted`.
    pub max_clients: u64,
    /// Published states per second and swarm.
    pub max_hz: u64,
}

/// The status of a daemon.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NodeStatus {
    /// Seconds since it started.
    pub uptime_secs: f64,
    /// Number of swarms.
    pub swarms: u64,
    /// Number of running swarms.
    pub running: u64,
    /// Number of faulted swarms.
    pub faulted: u64,
    /// Number of individuals in all swarms.
    pub individuals: u64,
    /// Memory reserved for the swarms and the running experiment, bytes.
    pub memory_bytes: u64,
    /// Of it, memory reserved for the running experiment, bytes.
    #[serde(default)]
    pub experiments_memory_bytes: u64,
    /// Number of connected clients.
    pub clients: u64,
}

/// The JSON Schemas (2020-12) of every message.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Schemas {
    /// The version of the contract that they describe.
    pub wire_version: u32,
    /// The schemas by the name of the message, such as `step.args` and `step.reply`.
    pub schemas: BTreeMap<String, Value>,
}

/// The swarms of a daemon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Swarms {
    /// The swarms, ordered by name.
    pub swarms: Vec<SwarmSummary>,
}

/// A swarm in the list of a daemon.
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
    /// `step · dt`, body sizes over free speed.
    pub time: f64,
    /// The number of individuals.
    pub n: u64,
    /// How many individuals are informed.
    pub informed: u64,
    /// The polar order parameter, 0 to 1.
    pub order: f64,
    /// Time units per second of wall clock; `null` is as fast as possible.
    pub rate: Option<f64>,
    /// The rate that was reached lately; `null` while it does not run.
    pub real_time_factor: Option<f64>,
    /// Whether it is the playback of a recording.
    #[serde(default)]
    pub replay: bool,
    /// As in its status.
    #[serde(default, skip_serializing_if = "crate::is_false")]
    #[schemars(extend("default" = false))]
    pub protected: bool,
    /// As in its status.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub earlier_models: Vec<EarlierModel>,
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
