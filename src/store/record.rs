//! Records and writes, and what they count for against a quota.

/// Bytes that a line of the audit log counts for besides its texts.
const LINE_BYTES: usize = 256;

/// Size of a record in the file besides its body.
const OVERHEAD_BYTES: usize = 64;

/// An entry of a swarm's journal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Row {
    /// Its number: a swarm's rows count from 1 without gaps.
    pub number: u64,
    /// The epoch it belongs to.
    pub epoch: u64,
    /// The step it belongs to.
    pub step: u64,
    /// Its kind, opaque to the store.
    pub kind: u8,
    /// Its content.
    pub body: Vec<u8>,
}

/// The complete state of a swarm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checkpoint {
    /// The last row it contains. A later checkpoint of the same number replaces it.
    pub number: u64,
    /// The epoch it belongs to.
    pub epoch: u64,
    /// The step it belongs to.
    pub step: u64,
    /// Its content.
    pub body: Vec<u8>,
}

/// A checkpoint without its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CheckpointInfo {
    /// The last row it contains.
    pub number: u64,
    /// The epoch it belongs to.
    pub epoch: u64,
    /// The step it belongs to.
    pub step: u64,
}

/// Rows up to the first that is damaged.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Rows {
    /// Consecutive rows.
    pub rows: Vec<Row>,
    /// The next row, if it is damaged or missing.
    pub damaged_at: Option<u64>,
}

/// The stored reply to a request with an id.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredReply {
    /// The client that sent it.
    pub client: Option<String>,
    /// Its `request_id`.
    pub request_id: String,
    /// A hash of the request.
    pub digest: [u8; 32],
    /// Its swarm.
    pub swarm: String,
    /// The swarm's row that it was written with.
    pub number: u64,
    /// Whether it was executed.
    pub is_ok: bool,
    /// The encoding of the body.
    pub encoding: String,
    /// The reply.
    pub body: Vec<u8>,
}

/// A line of the audit log.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AuditLine {
    /// Its number, from 1.
    pub number: u64,
    /// The user; empty if nobody known.
    pub user: String,
    /// What the client calls itself.
    pub client: Option<String>,
    /// The verb.
    pub verb: String,
    /// What it concerns.
    pub name: Option<String>,
    /// The wall-clock time of its first command, in milliseconds since 1970.
    pub first_ms: u64,
    /// The same for the last one.
    pub last_ms: u64,
    /// The rest, opaque to the store.
    pub body: Vec<u8>,
}

impl AuditLine {
    /// Bytes that it counts for.
    pub(super) fn bytes(&self) -> usize {
        let text = |text: &Option<String>| text.as_ref().map_or(0, String::len);
        let texts = self.user.len() + self.verb.len() + text(&self.client) + text(&self.name);
        LINE_BYTES + texts
    }
}

/// A change to the store. The name of a swarm may be any text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Write {
    /// Creates a swarm. Its rows follow its first checkpoint.
    Create {
        /// Its name.
        swarm: String,
        /// Its metadata, opaque to the store.
        about: Vec<u8>,
        /// The state that its rows follow.
        first: Checkpoint,
    },
    /// Appends a row to the journal of a swarm.
    Append {
        /// The swarm.
        swarm: String,
        /// Its next row.
        row: Row,
    },
    /// Adds a checkpoint, not older than the newest one.
    SaveCheckpoint {
        /// The swarm.
        swarm: String,
        /// Its state after a row that exists.
        checkpoint: Checkpoint,
    },
    /// Deletes the rows and checkpoints of a swarm after a row, so that others can follow it although
    /// the next row is damaged. The file is copied first.
    Truncate {
        /// The swarm.
        swarm: String,
        /// The last row that stays.
        after: u64,
    },
    /// Deletes a swarm with its rows and checkpoints. Replies stay.
    Delete {
        /// The swarm.
        swarm: String,
    },
    /// Adds a reply.
    InsertReply(StoredReply),
    /// Deletes the replies to a request, if there are any.
    DeleteReply {
        /// The client of the request.
        client: Option<String>,
        /// Its id.
        request_id: String,
    },
    /// Adds a line of the audit log, or replaces times and body of the one with its number. It is
    /// dropped if the store cannot write for long.
    Audit(AuditLine),
}

impl Write {
    /// The swarm that it changes; `None` for replies and the audit log.
    pub(super) fn swarm(&self) -> Option<&str> {
        match self {
            Write::Create { swarm, .. }
            | Write::Append { swarm, .. }
            | Write::SaveCheckpoint { swarm, .. }
            | Write::Truncate { swarm, .. }
            | Write::Delete { swarm } => Some(swarm),
            Write::InsertReply(_) | Write::DeleteReply { .. } | Write::Audit(_) => None,
        }
    }

    /// Its size in memory.
    pub(super) fn bytes(&self) -> usize {
        OVERHEAD_BYTES
            + match self {
                Write::Create {
                    swarm,
                    about,
                    first,
                } => swarm.len() + about.len() + first.body.len(),
                Write::Append { swarm, row } => swarm.len() + row.body.len(),
                Write::SaveCheckpoint { swarm, checkpoint } => swarm.len() + checkpoint.body.len(),
                Write::Truncate { swarm, .. } | Write::Delete { swarm } => swarm.len(),
                Write::InsertReply(reply) => reply.body.len() + reply.request_id.len(),
                Write::DeleteReply { request_id, .. } => request_id.len(),
                Write::Audit(line) => line.bytes() + line.body.len(),
            }
    }
}

/// Bytes that a record with a body of this length counts for against a quota.
pub(super) fn cost(body_bytes: usize) -> u64 {
    (body_bytes + OVERHEAD_BYTES) as u64
}

impl Checkpoint {
    /// The checkpoint without its content.
    pub fn info(&self) -> CheckpointInfo {
        CheckpointInfo {
            number: self.number,
            epoch: self.epoch,
            step: self.step,
        }
    }
}
