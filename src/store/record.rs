//! The records: what is kept, the seal of each, and what it counts for against a quota.

use super::seal::{Seal, Sealer, digest};

/// What a record takes in the file beside its body.
const OVERHEAD_BYTES: usize = 64;

/// An entry of a swarm's journal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Row {
    /// Its place: a swarm's rows count from 1 without gaps.
    pub number: u64,
    /// The epoch it belongs to.
    pub epoch: u64,
    /// The step it belongs to.
    pub step: u64,
    /// What it is; the store does not care.
    pub kind: u8,
    /// Its content.
    pub body: Vec<u8>,
}

/// A whole state.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checkpoint {
    /// The last row it contains. A later checkpoint with the same number takes its place.
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
pub struct Mark {
    /// The last row it contains.
    pub number: u64,
    /// The epoch it belongs to.
    pub epoch: u64,
    /// The step it belongs to.
    pub step: u64,
}

/// Rows, up to the first that is damaged.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Rows {
    /// Consecutive rows.
    pub rows: Vec<Row>,
    /// The row after them, when it is damaged or missing.
    pub damaged_at: Option<u64>,
}

/// What a named request came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// Who says to have sent it.
    pub client: Option<String>,
    /// What they called it.
    pub request_id: String,
    /// A hash of the request.
    pub digest: [u8; 32],
    /// The swarm it was for.
    pub swarm: String,
    /// The swarm's row it was written with.
    pub number: u64,
    /// Whether it was carried out.
    pub is_ok: bool,
    /// The encoding of the body.
    pub encoding: String,
    /// What was answered.
    pub body: Vec<u8>,
}

/// A change to what is stored. A swarm's name is text; nothing is asked of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Write {
    /// A new swarm. Its rows go on after its first checkpoint.
    Create {
        /// Its name.
        swarm: String,
        /// What it is; the store does not care.
        about: Vec<u8>,
        /// What its rows start from.
        first: Checkpoint,
    },
    /// The next row of a swarm.
    Append {
        /// The swarm.
        swarm: String,
        /// Its next row.
        row: Row,
    },
    /// A checkpoint, no older than the newest one.
    Keep {
        /// The swarm.
        swarm: String,
        /// Its state after the row it names, which is there.
        checkpoint: Checkpoint,
    },
    /// A swarm's rows and checkpoints after a row go, so that others can follow it: what is damaged
    /// cannot be gone on from. The file as it was is kept aside first.
    Cut {
        /// The swarm.
        swarm: String,
        /// The last row that stays.
        after: u64,
    },
    /// A swarm with all its rows and checkpoints. Answers stay.
    Delete {
        /// The swarm.
        swarm: String,
    },
    /// What a named request came to.
    Answer(Answer),
    /// The answer to a named request is deleted, if it is there.
    Forget {
        /// The client of the request.
        client: Option<String>,
        /// Its id.
        request_id: String,
    },
}

impl Write {
    /// The swarm it changes; an answer changes none.
    pub(super) fn swarm(&self) -> Option<&str> {
        match self {
            Write::Create { swarm, .. }
            | Write::Append { swarm, .. }
            | Write::Keep { swarm, .. }
            | Write::Cut { swarm, .. }
            | Write::Delete { swarm } => Some(swarm),
            Write::Answer(_) | Write::Forget { .. } => None,
        }
    }

    /// What it takes in memory, in bytes.
    pub(super) fn bytes(&self) -> usize {
        OVERHEAD_BYTES
            + match self {
                Write::Create {
                    swarm,
                    about,
                    first,
                } => swarm.len() + about.len() + first.body.len(),
                Write::Append { swarm, row } => swarm.len() + row.body.len(),
                Write::Keep { swarm, checkpoint } => swarm.len() + checkpoint.body.len(),
                Write::Cut { swarm, .. } | Write::Delete { swarm } => swarm.len(),
                Write::Answer(answer) => answer.body.len() + answer.request_id.len(),
                Write::Forget { request_id, .. } => request_id.len(),
            }
    }
}

/// What a body of this length counts for against a quota, in bytes.
pub(super) fn cost(body_bytes: usize) -> u64 {
    (body_bytes + OVERHEAD_BYTES) as u64
}

/// Seals the record of a swarm.
pub(super) fn seal_swarm(name: &str, id: i64, about: &[u8]) -> Seal {
    Sealer::new("swarm")
        .bytes(name.as_bytes())
        .numbers([id.cast_unsigned()])
        .bytes(about)
        .seal()
}

impl Row {
    /// Seals it as a row of `swarm`.
    pub(super) fn seal(&self, swarm: &str, id: i64) -> Seal {
        Sealer::new("row")
            .bytes(swarm.as_bytes())
            .numbers([
                id.cast_unsigned(),
                self.number,
                self.epoch,
                self.step,
                self.kind.into(),
            ])
            .bytes(&self.body)
            .seal()
    }
}

impl Checkpoint {
    /// It without its content.
    pub fn mark(&self) -> Mark {
        Mark {
            number: self.number,
            epoch: self.epoch,
            step: self.step,
        }
    }
}

impl Mark {
    /// Seals it as a checkpoint of `swarm` whose body has this digest.
    pub(super) fn seal(&self, swarm: &str, id: i64, digest: &[u8]) -> Seal {
        Sealer::new("checkpoint")
            .bytes(swarm.as_bytes())
            .numbers([id.cast_unsigned(), self.number, self.epoch, self.step])
            .bytes(digest)
            .seal()
    }

    /// The checkpoint with this content, if it is the one that was sealed.
    pub(super) fn with(self, body: Vec<u8>, sealed: &[u8]) -> Option<Checkpoint> {
        let Mark {
            number,
            epoch,
            step,
        } = self;
        (digest(&body) == sealed).then_some(Checkpoint {
            number,
            epoch,
            step,
            body,
        })
    }
}

impl Answer {
    /// Seals it as the answer `id`.
    pub(super) fn seal(&self, id: u64) -> Seal {
        let client = self.client.as_deref().unwrap_or("");
        Sealer::new("answer")
            .numbers([
                id,
                self.client.is_some().into(),
                self.number,
                self.is_ok.into(),
            ])
            .bytes(client.as_bytes())
            .bytes(self.request_id.as_bytes())
            .bytes(&self.digest)
            .bytes(self.swarm.as_bytes())
            .bytes(self.encoding.as_bytes())
            .bytes(&self.body)
            .seal()
    }
}
