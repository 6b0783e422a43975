//! Why a request about recordings is rejected.

use jostle_results::recording::RecordingError;
use thiserror::Error;

/// Why a request about recordings is rejected. It has changed nothing.
#[derive(Clone, Debug, Error)]
pub enum RecordError {
    #[error("unknown recording {0:?}: the node's get/recordings lists the recordings")]
    Unknown(String),
    #[error("another recording has the name {0:?}: choose another name, or delete that one")]
    Exists(String),
    #[error("recording {0:?} has failed: there is nothing to stop")]
    Failed(String),
    #[error("{0} recordings are running, the maximum: stop one")]
    TooMany(usize),
    #[error("there are {0} recordings, the maximum: delete one that is over")]
    TooManyKept(usize),
    #[error(
        "the recordings take {} MiB of {} (recordings_quota_mb): delete one that is over, or raise \
         the quota",
        used >> 20,
        quota >> 20
    )]
    OverQuota {
        used: u64,
        /// The quota in bytes.
        quota: u64,
    },
    #[error(
        "recording {name:?} has {parts} finished parts, and no part {part}: parts count from 0"
    )]
    NoPart {
        name: String,
        part: u64,
        /// The number of finished parts.
        parts: u64,
    },
    #[error("part {part} of recording {name:?} has {length} bytes, which offset {offset} exceeds")]
    NoOffset {
        name: String,
        part: u64,
        offset: u64,
        length: u64,
    },
    #[error("recording {0:?} is still being written: retry in a moment")]
    Ending(String),
    #[error("cannot store the recording: {0}")]
    NotStored(String),
    #[error("no thread can be started for the recording: {0}")]
    NoThread(String),
    #[error("the daemon is stopping: retry after it has restarted")]
    Stopping,
}

impl From<RecordingError> for RecordError {
    fn from(error: RecordingError) -> Self {
        RecordError::NotStored(error.to_string())
    }
}

impl From<std::io::Error> for RecordError {
    fn from(error: std::io::Error) -> Self {
        RecordError::NotStored(error.to_string())
    }
}
