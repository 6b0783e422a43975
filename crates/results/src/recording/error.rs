//! The error type of recordings.

use std::io;
use std::path::{Path, PathBuf};

use crate::table::TableError;

/// An error of writing, reading or recovering a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file name has none of the known extensions.
    #[error("record to {}: its name ends in neither .parquet nor .mcap", path.display())]
    UnknownKind {
        /// The file.
        path: PathBuf,
    },
    /// A file or folder of that name exists.
    #[error("record to {}: it already exists", path.display())]
    Exists {
        /// The file or folder.
        path: PathBuf,
    },
    /// A recording of that name was killed and left its partial file.
    #[error(
        "record to {}: a recording that was killed left {}: \
         `jostle record --recover {}` makes a whole file of it",
        path.display(), partial.display(), path.display()
    )]
    Unfinished {
        /// The file.
        path: PathBuf,
        /// The partial file.
        partial: PathBuf,
    },
    /// Another process is writing the file.
    #[error("{}: a running recording writes this file", path.display())]
    BeingWritten {
        /// The partial file.
        path: PathBuf,
    },
    /// The recording is complete, but converting it to the requested file failed.
    #[error(
        "{source}; {} holds the whole recording: fix the cause, then `jostle record --recover {}` \
         creates the file", partial.display(), path.display()
    )]
    Unconverted {
        /// The file.
        path: PathBuf,
        /// The partial file.
        partial: PathBuf,
        /// The reason.
        source: Box<RecordingError>,
    },
    /// The disk is full. Earlier frames are kept; the frame that met this error is not recorded.
    #[error("record to {}: the disk is full; the frames recorded before are kept", path.display())]
    Full {
        /// The file.
        path: PathBuf,
    },
    /// A system call failed.
    #[error("record to {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The MCAP writer failed.
    #[error("record to {}: {reason}", path.display())]
    Mcap {
        /// The file.
        path: PathBuf,
        /// The writer's message.
        reason: String,
    },
    /// The file is no recording, incomplete or damaged.
    #[error("{}: {reason}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The defect.
        reason: String,
    },
    /// The Parquet writer failed.
    #[error(transparent)]
    Table(#[from] TableError),
}

/// Converts the error of a Parquet recording that is read.
pub fn unreadable(error: TableError) -> RecordingError {
    match error {
        TableError::Malformed { path, reason } => RecordingError::Unreadable { path, reason },
        TableError::Io { path, source } => io_error(&path, source),
        error => error.into(),
    }
}

/// Converts a system error; a full disk or quota becomes [`RecordingError::Full`].
pub fn io_error(path: &Path, source: io::Error) -> RecordingError {
    let path = path.to_owned();
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => RecordingError::Full { path },
        _ => RecordingError::Io { path, source },
    }
}
