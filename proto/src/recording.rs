//! Recordings that a daemon makes: what a swarm shows, in its data directory, whoever looks on.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::LARGEST_WHOLE;
use crate::keys::NAME_RULE;

/// What is to be done with a recording; sent to a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum RecordArgs {
    /// Record a swarm from now on.
    Begin(BeginRecordingArgs),
    /// End it; what was recorded is kept.
    Stop(RecordingName),
    /// Remove it with its files; one that goes on is ended.
    Delete(RecordingName),
}

/// What to record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BeginRecordingArgs {
    /// The swarm.
    #[schemars(regex(pattern = NAME_RULE))]
    pub swarm: String,
    /// What to call it; the swarm's name and a number if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(regex(pattern = NAME_RULE))]
    pub recording: Option<String>,
    /// How to write it.
    #[serde(default)]
    pub format: RecordingFormat,
    /// Only states that are at least so many steps apart; all that are shown if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = LARGEST_WHOLE))]
    pub every: Option<u64>,
}

/// Which recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordingName {
    /// Its name.
    #[schemars(regex(pattern = NAME_RULE))]
    pub recording: String,
}

/// How a recording is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecordingFormat {
    /// States, orders and events as they are published, byte for byte.
    #[default]
    Mcap,
    /// A table with a row for each individual and state.
    Parquet,
}

/// How a recording stands; of a deleted one, how it stood.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Recording {
    /// Its name, and its folder's below `recordings` in the daemon's data directory.
    pub recording: String,
    /// The swarm.
    pub swarm: String,
    /// How it is written.
    pub format: RecordingFormat,
    /// Only states at least so many steps apart are in it; `null`: all that were shown.
    pub every: Option<u64>,
    /// What it is doing.
    pub phase: RecordingPhase,
    /// Why it ended or failed.
    pub reason: Option<String>,
    /// How many states were recorded.
    pub frames: u64,
    /// How many states came faster than they could be written, and are not in it.
    pub missed: u64,
    /// How many of its files are whole.
    pub parts: u64,
    /// Their bytes.
    pub bytes: u64,
    /// When it began, in seconds since 1970.
    pub began_unix_secs: u64,
}

/// What a recording is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecordingPhase {
    /// It goes on, also when the daemon starts anew.
    Recording,
    /// It was stopped, or its swarm was deleted.
    Ended,
    /// It cannot go on; what was recorded before is kept.
    Failed,
}

/// A node's answer to `get/recordings`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Recordings {
    /// All it has, ordered by name.
    pub recordings: Vec<Recording>,
}
