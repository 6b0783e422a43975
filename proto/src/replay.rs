//! Recordings that a daemon shows as if they were swarms.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::LARGEST_WHOLE;
use crate::keys::NAME_RULE;

/// What is to be done about a replay; sent to a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ReplayArgs {
    /// Take in a piece of a recording. Pieces come in order; one that came before is as good.
    Upload(UploadArgs),
    /// Show a recording under a name, paused at its first frame: the one that was uploaded under
    /// this name, or one that the daemon has recorded.
    Open(OpenArgs),
}

/// A piece of a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UploadArgs {
    /// The name it is to be shown under.
    #[schemars(regex(pattern = NAME_RULE))]
    pub name: String,
    /// Where in the file the piece begins, in bytes; 0 begins a new upload.
    #[schemars(range(max = LARGEST_WHOLE))]
    pub offset: u64,
    /// How long the whole file is, in bytes.
    #[schemars(range(max = LARGEST_WHOLE))]
    pub length: u64,
    /// The piece, as base64.
    pub bytes: String,
}

/// What to show under which name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OpenArgs {
    /// The name it is shown under, as swarms are.
    #[schemars(regex(pattern = NAME_RULE))]
    pub name: String,
    /// The daemon's own recording; left out, what was uploaded under this name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(regex(pattern = NAME_RULE))]
    pub recording: Option<String>,
}

/// What a node did about a replay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReplayResult {
    /// Bytes that have come of what is uploaded: where the next piece begins. `null` once it is
    /// shown.
    pub uploaded: Option<u64>,
    /// What is shown, once it is.
    pub replay: Option<Replay>,
}

/// A recording that is shown, and where it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Replay {
    /// The swarm that was recorded.
    pub of: String,
    /// The number of the frame it is at, from 1.
    pub frame: u64,
    /// How many frames it has.
    pub frames: u64,
    /// Time units since its first frame.
    pub position: f64,
    /// Time units from its first frame to its last, resets and gaps left out.
    pub duration: f64,
}

/// Has a replay go to the last frame that is not later than this. Exactly one is to be given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SeekArgs {
    /// A step; where the swarm was reset, of the run that is shown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = LARGEST_WHOLE))]
    pub step: Option<u64>,
    /// A time; where the swarm was reset, of the run that is shown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e12))]
    pub time: Option<f64>,
    /// A share of the whole recording: 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub fraction: Option<f64>,
}
