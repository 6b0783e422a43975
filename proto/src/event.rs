//! What happened to a swarm.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Error, Phase};

/// One published event. Its number tells a reader what it missed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Event {
    /// The swarm's name.
    pub swarm: String,
    /// Counts the swarm's events from 1.
    pub number: u64,
    /// Grows whenever `step` does not continue what was published before.
    pub epoch: u64,
    /// The step it happened at.
    pub step: u64,
    /// `step · dt`.
    pub time: f64,
    /// What the swarm does from then on.
    pub phase: Phase,
    /// The daemon's wall clock when it happened: seconds since 1970, UTC, to the millisecond; `null`
    /// if it is not known.
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
    Created {},
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
        /// Its arguments as they came.
        args: serde_json::Value,
        /// Who says to have sent it.
        client: Option<String>,
        /// What the sender called it.
        request_id: Option<String>,
    },
    /// A command waits for its step.
    Scheduled {
        /// The step it will be carried out at.
        applies_at_step: u64,
        /// Its verb.
        verb: String,
        /// Its arguments as they came.
        args: serde_json::Value,
        /// Who says to have sent it.
        client: Option<String>,
        /// What the sender called it.
        request_id: Option<String>,
    },
    /// A command that waited for its step was not carried out after all.
    Refused {
        /// Its verb.
        verb: String,
        /// Its arguments as they came.
        args: serde_json::Value,
        /// Who says to have sent it.
        client: Option<String>,
        /// What the sender called it.
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
    /// A recording that the daemon made of the swarm has failed; what was recorded before is kept.
    RecordingFailed {
        /// The recording's name.
        recording: String,
        /// Why.
        reason: String,
    },
    /// The swarm was deleted; the last event.
    Deleted {},
}
