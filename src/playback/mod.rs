//! Playback of recordings as if they were swarms, and the uploads of clients.

mod commands;
mod mcap;
pub mod player;
pub mod source;
mod uploads;

use thiserror::Error;

pub use mcap::McapSource;
pub use uploads::{MAX_UPLOAD_BYTES, Uploads};

/// Why a recording is not played. The request has changed nothing.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ReplayError {
    /// It is not a recording, or damaged.
    #[error("not a recording that can be replayed: {0}")]
    Unreadable(String),
    /// A piece does not continue the previous ones.
    #[error("{received} bytes of this upload are received: continue there, or restart at 0")]
    Piece {
        /// The number of received bytes.
        received: u64,
    },
    /// No upload of this name is complete.
    #[error("no recording was uploaded under the name {0:?}: upload it, or name a recording")]
    NotUploaded(String),
    /// The daemon has no such recording.
    #[error("the daemon has no finished part of a recording {0:?} in MCAP")]
    Unknown(String),
    /// It exceeds the maximum length.
    #[error(
        "the recording has {length} bytes, the maximum is {MAX_UPLOAD_BYTES}: record fewer steps"
    )]
    TooLong {
        /// Its length.
        length: u64,
    },
    /// The maximum number of uploads is in progress.
    #[error("{0} recordings are being uploaded, the maximum: retry in a moment")]
    TooMany(usize),
    /// A file cannot be written.
    #[error("cannot store the recording in data_dir: {0}")]
    Unkept(String),
}
