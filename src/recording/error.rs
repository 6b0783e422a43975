//! Why nothing is recorded.

use jostle_results::recording::RecordingError;
use thiserror::Error;

/// Why what was to be done with a recording is refused. Nothing has changed then.
#[derive(Clone, Debug, Error)]
pub enum RecordError {
    /// There is no such recording.
    #[error("there is no recording {0:?}: the node's get/recordings lists what there is")]
    Unknown(String),
    /// Another recording has this name.
    #[error("there is a recording {0:?}: choose another name, or delete that one")]
    Exists(String),
    /// It cannot go on.
    #[error("recording {0:?} has failed: there is nothing to stop")]
    Failed(String),
    /// Too many go on.
    #[error("{0} recordings go on, which is the most: stop one")]
    TooMany(usize),
    /// Too many are kept.
    #[error("there are {0} recordings, which is the most: delete one that has ended")]
    TooManyKept(usize),
    /// All recordings together are too large.
    #[error(
        "the recordings take {} MiB, and recordings_quota_mb allows {}: delete one that has ended, \
         or raise it",
        used >> 20,
        quota >> 20
    )]
    OverQuota {
        /// Their bytes.
        used: u64,
        /// The bytes that they may have.
        quota: u64,
    },
    /// There is no such part.
    #[error(
        "recording {name:?} has {parts} whole parts, so there is no part {part}: parts count from 0"
    )]
    NoPart {
        /// The recording.
        name: String,
        /// The part asked for.
        part: u64,
        /// How many are whole.
        parts: u64,
    },
    /// A part is not that long.
    #[error(
        "part {part} of recording {name:?} has {length} bytes, and offset {offset} is beyond them"
    )]
    NoOffset {
        /// The recording.
        name: String,
        /// The part.
        part: u64,
        /// Where it was to be read from.
        offset: u64,
        /// How long it is.
        length: u64,
    },
    /// It ends, and is not done with that yet.
    #[error("recording {0:?} still writes what it has: try again in a moment")]
    Ending(String),
    /// It cannot be written.
    #[error("the recording cannot be kept: {0}")]
    Unkept(String),
    /// No thread could be started.
    #[error("no thread can be started for the recording: {0}")]
    NoThread(String),
    /// The daemon stops.
    #[error("the daemon is closing: send it again when it is back")]
    Stopping,
}

impl From<RecordingError> for RecordError {
    fn from(error: RecordingError) -> Self {
        RecordError::Unkept(error.to_string())
    }
}

impl From<std::io::Error> for RecordError {
    fn from(error: std::io::Error) -> Self {
        RecordError::Unkept(error.to_string())
    }
}
