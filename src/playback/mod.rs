//! Playback of recordings as if they were swarms, and the uploads of clients.

mod commands;
mod mcap;
mod player;
pub(crate) mod source;
mod uploads;

use thiserror::Error;

pub use mcap::McapSource;
pub use uploads::{MAX_UPLOAD_BYTES, Uploads};

/// Why a recording is not played. The request has changed nothing.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[expect(missing_docs, reason = "the messages say when each is returned")]
pub enum ReplayError {
    #[error("not a recording that can be replayed: {0}")]
    Unreadable(String),
    /// A piece does not continue the previous ones.
    #[error("{0} bytes of this upload are received: continue there, or restart at 0")]
    Piece(u64),
    /// No upload of this name is complete.
    #[error("no recording was uploaded under the name {0:?}: upload it, or name a recording")]
    NotUploaded(String),
    #[error("the daemon has no finished part of a recording {0:?} in MCAP")]
    Unknown(String),
    #[error("the recording has {0} bytes, the maximum is {MAX_UPLOAD_BYTES}: record fewer steps")]
    TooLong(u64),
    #[error("{0} recordings are being uploaded, the maximum: retry in a moment")]
    TooMany(usize),
    #[error("cannot store the recording in data_dir: {0}")]
    NotStored(String),
}
