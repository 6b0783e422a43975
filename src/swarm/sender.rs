//! The client that sent a command, and the one that created a swarm.

use serde::{Deserialize, Serialize};

/// A command as it was sent, for its event and the journal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sender {
    /// The verb's name.
    pub verb: &'static str,
    /// The arguments as they were sent, JSON.
    pub args: String,
    /// The name that the client gave.
    pub client: Option<String>,
    /// The id that the client gave to the request.
    pub request_id: Option<String>,
    /// The digest of the request, which detects another request with the same id.
    pub digest: Option<[u8; 32]>,
}

/// The request that created a swarm.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Creation {
    /// `create`, `restore`, `fork` or `replay`.
    pub verb: String,
    /// The name that the client gave.
    pub client: Option<String>,
    /// The id that the client gave to the request.
    pub request_id: Option<String>,
    /// The user of a daemon with users, to whom the swarm belongs.
    pub owner: Option<String>,
    /// The wall-clock time, in seconds since 1970, if known.
    pub unix_secs: Option<f64>,
    /// The step of the swarm when it was created.
    pub step: u64,
}
