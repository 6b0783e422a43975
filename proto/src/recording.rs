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

/// The status of a recording of a daemon; of a deleted one, its last status.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Recording {
    /// Its name, and that of its folder in `recordings` of the daemon's data directory.
    pub recording: String,
    /// The name of the recorded swarm.
    pub swarm: String,
    /// `mcap`, or `parquet` if an earlier version recorded it.
    pub format: RecordingFormat,
    /// It has the states whose step is a multiple of this; `null` is the published states, of an
    /// earlier version.
    pub every: Option<u64>,
    /// Its phase.
    pub phase: RecordingPhase,
    /// Why it ended or failed, and which of its files are missing or damaged.
    pub reason: Option<String>,
    /// Number of recorded states.
    pub frames: u64,
    /// Number of missing states: those that were dropped because the disk was too slow (without
    /// `drop_when_behind` the swarm waits instead), and those in `lost`.
    pub missed: u64,
    /// Number of them that were lost because the daemon ended before their file was complete.
    #[serde(default)]
    pub lost: u64,
    /// Where the last of these were; `null` if none was lost.
    #[serde(default)]
    pub gap: Option<RecordingGap>,
    /// Number of finished files that are missing or damaged; `frames`, `parts` and `bytes` are
    /// those of the others then.
    #[serde(default)]
    pub lost_parts: u64,
    /// Number of complete files.
    pub parts: u64,
    /// Bytes of these files.
    pub bytes: u64,
    /// Its beginning, seconds since 1970, UTC.
    pub began_unix_secs: u64,
    /// Whether it drops states while the disk is too slow; otherwise the swarm waits.
    #[serde(default)]
    pub drop_when_behind: bool,
    /// The size in bytes at which it ends; `null` for a recording of an earlier version, which has
    /// no limit.
    #[serde(default)]
    pub max_bytes: Option<u64>,
    /// Whether the client that fetches it is to delete it afterwards.
    #[serde(default)]
    pub temporary: bool,
}

/// States that a recording lost because the daemon ended before their file was complete.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordingGap {
    /// The state up to which none is missing; `null` if the recording begins with the gap.
    pub after: Option<RecordedAt>,
    /// The state at which the recording continues.
    pub until: RecordedAt,
    /// Number of missing states.
    pub missed: u64,
}

/// The epoch and step of a state in a recording.
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

/// The recordings of a daemon.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Recordings {
    /// The recordings, ordered by name.
    pub recordings: Vec<Recording>,
}

/// A piece of a complete part of a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordingPiece {
    /// The name of the recording.
    pub recording: String,
    /// The number of the part, from 0.
    pub part: u64,
    /// Number of complete parts.
    pub parts: u64,
    /// The offset of the piece in the part, bytes.
    pub offset: u64,
    /// The length of the part, bytes.
    pub length: u64,
    /// The piece, as base64: at most 512 KiB of the part; empty at the end of the part.
    pub bytes: String,
}
