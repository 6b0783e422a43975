//! Playbacks: recordings that a daemon shows as swarms.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::LARGEST_WHOLE;
use crate::keys::NAME_RULE;

/// A command to a playback; sent to a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ReplayArgs {
    /// Upload a piece of a recording. Pieces are sent in order; a repeated one is accepted.
    Upload(UploadArgs),
    /// Show a recording under a name, paused at its first frame: the one that was uploaded under
    /// this name, or one that the daemon has recorded.
    Open(OpenArgs),
}

/// A piece of a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UploadArgs {
    /// The name of the playback.
    #[schemars(regex(pattern = NAME_RULE))]
    pub name: String,
    /// Where in the file the piece begins, in bytes; 0 begins a new upload.
    #[schemars(range(max = LARGEST_WHOLE))]
    pub offset: u64,
    /// How long the whole file is, in bytes.
    #[schemars(range(max = LARGEST_WHOLE))]
    pub length: u64,
    /// The piece, as base64.
    #[schemars(extend("x-range" = "base64 of a piece of the file"))]
    pub bytes: String,
}

/// A recording to show, and its name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OpenArgs {
    /// The name of the playback.
    #[schemars(regex(pattern = NAME_RULE))]
    pub name: String,
    /// A recording of the daemon; left out, the one uploaded under this name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(regex(pattern = NAME_RULE))]
    pub recording: Option<String>,
}

/// The reply to `replay`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReplayResult {
    /// Number of uploaded bytes, which is the offset of the next piece; `null` after `open`.
    pub uploaded: Option<u64>,
    /// The playback after `open`; `null` after `upload`.
    pub replay: Option<Replay>,
}

/// A playback of a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Replay {
    /// The swarm that was recorded.
    pub of: String,
    /// The number of the present frame, from 1.
    pub frame: u64,
    /// Number of frames.
    pub frames: u64,
    /// Time units since its first frame.
    pub position: f64,
    /// Time units from its first frame to its last, resets and gaps left out.
    pub duration: f64,
}

/// Moves a playback to the last frame that is not later. Exactly one field must be given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SeekArgs {
    /// A step; if the swarm was reset, of the epoch that is shown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = LARGEST_WHOLE))]
    pub step: Option<u64>,
    /// A time; if the swarm was reset, of the epoch that is shown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e12))]
    pub time: Option<f64>,
    /// A share of the whole recording: 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub fraction: Option<f64>,
}
