//! Why a request about recordings is rejected.

use jostle_results::recording::RecordingError;
use thiserror::Error;

/// Why a request about recordings is rejected. It has changed nothing.
#[derive(Clone, Debug, Error)]
pub enum RecordError {
    /// No recording has this name.
    #[error("unknown recording {0:?}: the node's get/recordings lists the recordings")]
    Unknown(String),
    /// A recording has this name.
    #[error("another recording has the name {0:?}: choose another name, or delete that one")]
    Exists(String),
    /// It has failed.
    #[error("recording {0:?} has failed: there is nothing to stop")]
    Failed(String),
    /// The maximum number is running.
    #[error("{0} recordings are running, the maximum: stop one")]
    TooMany(usize),
    /// The maximum number is stored.
    #[error("there are {0} recordings, the maximum: delete one that is over")]
    TooManyKept(usize),
    /// All recordings together exceed the quota.
    #[error(
        "the recordings take {} MiB of {} (recordings_quota_mb): delete one that is over, or raise \
         the quota",
        used >> 20,
        quota >> 20
    )]
    OverQuota {
        /// Their bytes.
        used: u64,
        /// The quota in bytes.
        quota: u64,
    },
    /// The part does not exist.
    #[error(
        "recording {name:?} has {parts} finished parts, and no part {part}: parts count from 0"
    )]
    NoPart {
        /// The recording.
        name: String,
        /// The requested part.
        part: u64,
        /// The number of finished parts.
        parts: u64,
    },
    /// The part is shorter.
    #[error("part {part} of recording {name:?} has {length} bytes, which offset {offset} exceeds")]
    NoOffset {
        /// The recording.
        name: String,
        /// The part.
        part: u64,
        /// The requested offset.
        offset: u64,
        /// The length of the part.
        length: u64,
    },
    /// Its writer has not ended in time.
    #[error("recording {0:?} is still being written: retry in a moment")]
    Ending(String),
    /// A file of the recording cannot be read or written.
    #[error("cannot store the recording: {0}")]
    Unkept(String),
    /// No thread can be started.
    #[error("no thread can be started for the recording: {0}")]
    NoThread(String),
    /// The daemon is stopping.
    #[error("the daemon is stopping: retry after it has restarted")]
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
