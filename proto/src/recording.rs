//! Recordings that a daemon makes: every k-th state of a swarm, in its data directory.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::LARGEST_WHOLE;
use crate::keys::NAME_RULE;

/// The size at which a recording ends if the request has none: 1 GiB.
pub const DEFAULT_MAX_RECORDING_BYTES: u64 = 1 << 30;

/// A command to a recording; sent to a node.
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
    /// `mcap` or left out. Clients of earlier versions send it; `parquet` is rejected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<String>", extend("x-range" = "\"mcap\""))]
    pub format: Option<RecordingFormat>,
    /// Record the states whose step is a multiple of this, each of them; the swarm's `publish_every`
    /// if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = LARGEST_WHOLE))]
    pub every: Option<u64>,
    /// End when the swarm has taken so many steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = LARGEST_WHOLE))]
    pub steps: Option<u64>,
    /// Leave states out, and count them, while the disk does not keep up; otherwise the swarm waits
    /// for the disk.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub drop_when_behind: bool,
    /// End when the files have so many bytes; 1 GiB if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = LARGEST_WHOLE))]
    pub max_bytes: Option<u64>,
    /// A client is to fetch it and delete it then. The daemon itself deletes none.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub temporary: bool,
}

/// Which recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordingName {
    /// Its name.
    #[schemars(regex(pattern = NAME_RULE))]
    pub recording: String,
}

/// How a recording is written: as MCAP, unless an earlier version wrote it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecordingFormat {
    /// States, orders and events in the encodings in which they are published.
    Mcap,
    /// A table with a row for each individual and state; only earlier versions wrote it.
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
    /// The states whose step is a multiple of this are in it; `null`: an earlier version recorded
    /// what was published.
    pub every: Option<u64>,
    /// What it is doing.
    pub phase: RecordingPhase,
    /// Why it ended or failed, and which of its files are missing or damaged.
    pub reason: Option<String>,
    /// How many states were recorded.
    pub frames: u64,
    /// How many states are missing: those that it left out because the disk did not keep up (without
    /// `drop_when_behind` the swarm waits instead), and those in `lost`.
    pub missed: u64,
    /// How many of them it lost because the daemon ended before their file was whole.
    #[serde(default)]
    pub lost: u64,
    /// Where the last of those were; `null`: none was lost.
    #[serde(default)]
    pub gap: Option<RecordingGap>,
    /// How many of its finished files are missing or damaged; `frames`, `parts` and `bytes` are those of
    /// the others then.
    #[serde(default)]
    pub lost_parts: u64,
    /// How many of its files are whole.
    pub parts: u64,
    /// Their bytes.
    pub bytes: u64,
    /// When it began, in seconds since 1970.
    pub began_unix_secs: u64,
    /// Whether it leaves states out while the disk does not keep up.
    #[serde(default)]
    pub drop_when_behind: bool,
    /// The bytes from which on it ends; `null`: an earlier version began it, without such an end.
    #[serde(default)]
    pub max_bytes: Option<u64>,
    /// Whether a client is to fetch it and delete it then.
    #[serde(default)]
    pub temporary: bool,
}

/// States that a recording lost when the daemon ended, all of them before the next state in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordingGap {
    /// The state up to which none is missing; `null`: the recording begins with the gap.
    pub after: Option<RecordedAt>,
    /// The state from which on it continues.
    pub until: RecordedAt,
    /// How many states are missing.
    pub missed: u64,
}

/// A state, as a recording counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordedAt {
    /// Its epoch.
    pub epoch: u64,
    /// Its step.
    pub step: u64,
}

/// What a recording is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecordingPhase {
    /// It goes on, also when the daemon restarts.
    #[default]
    Recording,
    /// It is over, as its reason says: stopped, complete, as large as its `max_bytes`, or its swarm
    /// was deleted.
    Ended,
    /// It cannot go on, for example on a full disk, or since all recordings together are as large as
    /// they may be, or files of it are missing or damaged; what was recorded before is kept.
    Failed,
}

/// A node's answer to `get/recordings`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Recordings {
    /// All it has, ordered by name.
    pub recordings: Vec<Recording>,
}

/// A node's answer to `get/recording`: a piece of a file that is whole.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordingPiece {
    /// The recording.
    pub recording: String,
    /// The number of the part, from 0.
    pub part: u64,
    /// How many parts are whole now.
    pub parts: u64,
    /// Where in the part the piece begins, in bytes.
    pub offset: u64,
    /// How long the whole part is, in bytes.
    pub length: u64,
    /// The piece, as base64: at most 512 KiB of the part; empty where the part ends.
    pub bytes: String,
}
