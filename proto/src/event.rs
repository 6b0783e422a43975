//! What happened to a swarm.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Error, Phase};

/// A published event. A gap in the numbers shows a reader that it missed some.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Event {
    /// The swarm's name.
    pub swarm: String,
    /// Counts the swarm's events from 1.
    pub number: u64,
    /// Grows whenever `step` does not continue what was published before.
    pub epoch: u64,
    /// The step at which it happened.
    pub step: u64,
    /// `step · dt`.
    pub time: f64,
    /// The phase of the swarm after it.
    pub phase: Phase,
    /// The daemon's wall clock when it happened: seconds since 1970, UTC, to the millisecond;
    /// `null` if it is not known.
    #[serde(default)]
    pub unix_secs: Option<f64>,
    /// What happened.
    pub event: EventKind,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum EventKind {
    /// The swarm was created.
    Created {
        /// The verb that created it: `create`, `restore`, `fork` or `replay`; `null` if it is not
        /// known, as for a swarm that an earlier version created.
        #[serde(default)]
        verb: Option<String>,
        /// The client, as the request names it.
        #[serde(default)]
        client: Option<String>,
        /// The id that its client gave it.
        #[serde(default)]
        request_id: Option<String>,
    },
    /// Its phase changed.
    Phase {
        /// Why.
        reason: Option<String>,
    },
    /// A command was applied.
    Command {
        /// Counts the swarm's applied commands.
        seq: u64,
        /// Its verb.
        verb: String,
        /// Its arguments as received.
        args: serde_json::Value,
        /// The client, as the request names it.
        client: Option<String>,
        /// The id that its client gave it.
        request_id: Option<String>,
    },
    /// A command waits for its step.
    Scheduled {
        /// The step at which it will be executed.
        applies_at_step: u64,
        /// Its verb.
        verb: String,
        /// Its arguments as received.
        args: serde_json::Value,
        /// The client, as the request names it.
        client: Option<String>,
        /// The id that its client gave it.
        request_id: Option<String>,
    },
    /// A scheduled command was rejected at its step.
    Refused {
        /// Its verb.
        verb: String,
        /// Its arguments as received.
        args: serde_json::Value,
        /// The client, as the request names it.
        client: Option<String>,
        /// The id that its client gave it.
        request_id: Option<String>,
        /// Why.
        error: Error,
    },
    /// Individuals informed for a time are uninformed again.
    Lapsed {
        /// Their ids, ascending.
        ids: Vec<u32>,
    },
    /// A step failed; the last good state is kept.
    Fault {
        /// Why.
        reason: String,
    },
    /// A recording of the swarm by the daemon failed; what was recorded before is kept.
    RecordingFailed {
        /// The recording's name.
        recording: String,
        /// Why.
        reason: String,
    },
    /// The swarm was deleted; the last event.
    Deleted {
        /// The client, as the request names it.
        #[serde(default)]
        client: Option<String>,
        /// The id that its client gave it.
        #[serde(default)]
        request_id: Option<String>,
    },
}
