//! The contents of an experiment's files as texts.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};

use super::Files;

/// The contents of an experiment's files as texts; that of `start` in base64.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncodedFiles {
    /// The text of the TOML.
    pub toml: String,
    /// The text of the CSV that `points` names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points: Option<String>,
    /// The snapshot that `start` names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<String>,
    /// The text of the CSV that `setpoints` names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub setpoints: Option<String>,
}

impl From<Files> for EncodedFiles {
    fn from(files: Files) -> Self {
        Self {
            toml: files.toml,
            points: files.points,
            start: files.start.map(|it| STANDARD.encode(it)),
            setpoints: files.setpoints,
        }
    }
}

impl TryFrom<EncodedFiles> for Files {
    type Error = base64::DecodeError;

    fn try_from(files: EncodedFiles) -> Result<Self, Self::Error> {
        Ok(Self {
            toml: files.toml,
            points: files.points,
            start: files.start.map(|it| STANDARD.decode(it)).transpose()?,
            setpoints: files.setpoints,
        })
    }
}
