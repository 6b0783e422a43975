//! Recordings on show: what clients upload, and films made from it.

pub mod film;
pub mod player;
mod reel;
mod uploads;

use thiserror::Error;

pub use reel::Reel;
pub use uploads::{MOST_BYTES, Uploads};

/// Why a recording is not shown. Nothing has changed then.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ReplayError {
    /// It is no recording, or a damaged one.
    #[error("this is no recording that can be replayed: {0}")]
    Unreadable(String),
    /// A piece that does not continue those before it.
    #[error("bytes up to {received} of this upload have come: go on there, or begin anew at 0")]
    Piece {
        /// How many have come.
        received: u64,
    },
    /// Nothing whole was uploaded under the name.
    #[error("no whole recording was uploaded under the name {0:?}: upload it, or name a recording")]
    NotUploaded(String),
    /// The daemon has no such recording.
    #[error("the daemon has no whole part of a recording {0:?} in MCAP")]
    Unknown(String),
    /// It is longer than a daemon takes.
    #[error("the recording has {length} bytes, the most is {MOST_BYTES}: record fewer steps")]
    TooLong {
        /// Its length.
        length: u64,
    },
    /// Too many are uploaded at once.
    #[error("{0} recordings are being uploaded already: try again in a moment")]
    TooMany(usize),
    /// The disk refuses.
    #[error("the recording cannot be kept in data_dir: {0}")]
    Unkept(String),
}
