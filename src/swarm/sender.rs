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
    /// What it was made from; earlier versions did not store it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin: Option<Origin>,
}

/// What a swarm was made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// How it was made.
    pub kind: OriginKind,
    /// The swarm that was forked, saved in a snapshot or recorded; `None` if a snapshot does not have its name.
    pub swarm: Option<String>,
    /// Its number in the store, if it is in the store.
    pub swarm_id: Option<u64>,
    /// Its step then.
    pub step: u64,
    /// The number of its last command then, if known.
    pub seq: Option<u64>,
    /// BLAKE3 of its state then, if known.
    pub state_hash: Option<[u8; 32]>,
}

/// How a swarm was made from another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OriginKind {
    /// By `fork`.
    Fork,
    /// By `restore`.
    Restore,
    /// By `replay`.
    Play,
}
