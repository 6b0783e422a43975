//! Why the users cannot be read or changed.

use std::path::PathBuf;

use thiserror::Error;

/// Why the users cannot be read or changed.
#[derive(Debug, Error)]
pub enum AuthError {
    /// A file cannot be read or written.
    #[error("{path}: {error}")]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        error: std::io::Error,
    },
    /// The folder does not exist or is empty.
    #[error("{0} has no people.json: `jostled auth init --auth-dir {0}` creates it")]
    NoUsers(PathBuf),
    /// A file has an invalid content.
    #[error("{path}: {problem}")]
    Content {
        /// The file.
        path: PathBuf,
        /// The problem.
        problem: String,
    },
    /// Other users of the machine can read a secret.
    #[error("other users can read {0}: `chmod go= {0}`, and issue new secrets if one has read it")]
    Readable(PathBuf),
    /// Other users of the machine can write a file that grants rights.
    #[error("other users can write {0}: `chmod go-w {0}` once you have checked it")]
    Writable(PathBuf),
    /// A file that grants rights belongs to another user of the machine.
    #[error("{0} belongs to another user: `chown` it to the user of the daemon")]
    Foreign(PathBuf),
    /// A file is missing that can be created again.
    #[error("{0} is missing: `jostled auth init` with the daemon's names creates it")]
    Missing(PathBuf),
    /// The authority's key is elsewhere.
    #[error("{0} is missing, and no certificate can be issued without it: put it back meanwhile")]
    NoAuthority(PathBuf),
    /// The name of a user is invalid.
    #[error(
        "invalid user name {0:?}: use 1 to 64 of a-z, 0-9 and _, the first a letter or digit; \
         jostled is reserved"
    )]
    Name(String),
    /// The name or address of a machine is invalid.
    #[error("{0:?} is neither a name nor an address of a machine, such as lab.example or 10.0.0.1")]
    Host(String),
    /// The daemon listens on every address, and has no name.
    #[error(
        "{0} is every address of this machine: give the name by which others reach it, \
         --host lab.example"
    )]
    NoHost(String),
    /// The port differs at each start.
    #[error("{0} picks a new port at each start, but credentials contain a fixed one: give a port")]
    AnyPort(String),
    /// The endpoint has no port.
    #[error("{0:?} has no port: give tls/ADDRESS:PORT")]
    NoPort(String),
    /// An earlier version did not record the names of the certificate.
    #[error(
        "an earlier version issued the certificate without a record of its names: give all of \
         them, --host {0} and so on"
    )]
    HostsUnknown(String),
    /// The user exists.
    #[error("user {0} exists: `jostled auth remove {0}` first, for new secrets or another role")]
    Exists(String),
    /// One command contains a name twice.
    #[error("{0} is given twice: give each name once")]
    Duplicate(String),
    /// The user does not exist.
    #[error("unknown user {0:?}: `jostled auth list` lists the users")]
    Unknown(String),
    /// A key or certificate cannot be made.
    #[error("cannot issue a certificate: {0}")]
    Certificate(#[from] rcgen::Error),
}
