//! Why the daemon does not start.

use jostle_convert::Place;
use thiserror::Error;

use crate::audit::AuditError;
use crate::auth::AuthError;
use crate::convert::commands::CommandError;
use crate::store::StoreError;
use crate::transport::http::GatewayError;
use crate::transport::zenoh::session::SessionError;

/// The exit code if the store fails, or if it is not completely written at a stop.
pub const EXIT_STORE: i32 = 8;

/// Why the daemon does not start.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages say when each is returned")]
pub enum ServerError {
    #[error(transparent)]
    Session(#[from] SessionError),
    #[error("cannot declare the daemon's keys: {0}")]
    Keys(String),
    /// The daemon's name or its prefix cannot be part of a key.
    #[error("{}", .0.to_wire(None, &Place::default()).message)]
    Name(CommandError),
    #[error("auth_dir: {0}")]
    Rights(#[from] AuthError),
    #[error(transparent)]
    Gateway(#[from] GatewayError),
    #[error("{0}")]
    Store(#[from] StoreError),
    #[error("cannot open the audit log: {0}")]
    Audit(#[from] AuditError),
    #[error(
        "{0} has recordings or experiments but no database: restore a backup, or move the folder away"
    )]
    NoDatabase(String),
    #[error("cannot recover the swarms: {0}")]
    Recovery(StoreError),
    /// The folder of experiments, recordings or uploads cannot be used.
    #[error("cannot use {folder}: {error}")]
    Folder {
        folder: String,
        error: std::io::Error,
    },
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
    #[error("cannot read or write the page's token in the data directory: {0}")]
    Token(std::io::Error),
}
