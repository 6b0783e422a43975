//! What happened to a swarm.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Error, Phase};

/// An event of a swarm. A gap in the numbers shows a reader that it missed some.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Event {
    /// The swarm's name.
    pub swarm: String,
    /// The number of the event, from 1.
    pub number: u64,
    /// Increases when `step` does not continue what was published before.
    pub epoch: u64,
    /// The step of the event.
    pub step: u64,
    /// `step · dt`, body sizes over free speed.
    pub time: f64,
    /// The phase after the event.
    pub phase: Phase,
    /// The daemon's wall clock, seconds since 1970, UTC; `null` if it is not known.
    #[serde(default)]
    pub unix_secs: Option<f64>,
    /// What happened.
    pub event: EventKind,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum EventKind {
    /// The swarm was created; its first event.
    Created {
        /// The verb that created it: `create`, `restore`, `fork` or `replay`; `null` if it is not
        /// known, as for a swarm that an earlier version created.
        #[serde(default)]
        verb: Option<String>,
        /// The name of the client that sent the command.
        #[serde(default)]
        client: Option<String>,
        /// The id of the request.
        #[serde(default)]
        request_id: Option<String>,
    },
    /// Its phase changed.
    Phase {
        /// The cause.
        reason: Option<String>,
    },
    /// A command was applied.
    Command {
        /// Number of commands applied to the swarm.
        seq: u64,
        /// The verb of the command.
        verb: String,
        /// The arguments of the command, as they were sent.
        args: serde_json::Value,
        /// The name of the client that sent the command.
        client: Option<String>,
        /// The id of the request.
        request_id: Option<String>,
    },
    /// A command waits for its step.
    Scheduled {
        /// The step that the command waits for.
        applies_at_step: u64,
        /// The verb of the command.
        verb: String,
        /// The arguments of the command, as they were sent.
        args: serde_json::Value,
        /// The name of the client that sent the command.
        client: Option<String>,
        /// The id of the request.
        request_id: Option<String>,
    },
    /// A scheduled command was rejected.
    Refused {
        /// The verb of the command.
        verb: String,
        /// The arguments of the command, as they were sent.
        args: serde_json::Value,
        /// The name of the client that sent the command.
        client: Option<String>,
        /// The id of the request.
        request_id: Option<String>,
        /// Why the command was rejected.
        error: Error,
    },
    /// The time of informed individuals ended, and they are uninformed.
    Lapsed {
        /// The ids of the individuals concerned, ascending.
        ids: Vec<u32>,
    },
    /// A step failed; the swarm keeps its last good state.
    Fault {
        /// The cause.
        reason: String,
    },
    /// Another version of the model goes on from its last stored state; it replays the commands after
    /// that state.
    Model {
        /// The version that computed that state.
        from: u32,
        /// The version that computes the steps from there on.
        to: u32,
    },
    /// A recording of the daemon failed; its files are kept.
    RecordingFailed {
        /// The name of the daemon's recording.
        recording: String,
        /// The cause.
        reason: String,
    },
    /// The swarm was deleted; its last event.
    Deleted {
        /// The name of the client that sent the command.
        #[serde(default)]
        client: Option<String>,
        /// The id of the request.
        #[serde(default)]
        request_id: Option<String>,
    },
}
