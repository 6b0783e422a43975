//! Why the daemon does not start.

use thiserror::Error;

use crate::auth::AuthError;
use crate::convert::commands::CommandError;
use crate::persistence::recovery::RecoveryError;
use crate::store::StoreError;
use crate::transport::http::GatewayError;
use crate::transport::zenoh::session::SessionError;

/// The exit code if the store fails, or if it is not completely written at a stop.
pub const EXIT_STORE: i32 = 8;

/// Why the daemon does not start.
#[derive(Debug, Error)]
pub enum ServerError {
    /// The zenoh session cannot be opened.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// zenoh rejects the daemon's keys.
    #[error("cannot declare the daemon's keys: {0}")]
    Keys(String),
    /// The daemon's name or its prefix cannot be part of a key.
    #[error("{}", .0.to_wire(None).message)]
    Name(CommandError),
    /// The users and their roles cannot be read.
    #[error("auth_dir: {0}")]
    Rights(#[from] AuthError),
    /// The HTTP server cannot be started.
    #[error(transparent)]
    Gateway(#[from] GatewayError),
    /// The store cannot be opened.
    #[error("{0}")]
    Store(#[from] StoreError),
    /// The swarms cannot be recovered.
    #[error("cannot recover the swarms: {0}")]
    Recovery(#[from] RecoveryError),
    /// The folder of experiments, recordings or uploads cannot be used.
    #[error("cannot use {folder}: {error}")]
    Folder {
        /// The folder.
        folder: String,
        /// The error of the system.
        error: std::io::Error,
    },
    /// A thread cannot be started.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// The token of the page can neither be read nor written.
    #[error("cannot read or write the page's token in the data directory: {0}")]
    Token(std::io::Error),
}
