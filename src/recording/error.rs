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
