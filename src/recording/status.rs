//! The status of a recording: in memory, and in its folder.

use std::sync::Arc;

use jostle_results::recording::{Format, Written};
use serde::{Deserialize, Serialize};

use super::queue::FrameQueue;
use crate::jobs::StatusFile;

/// What a recording is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// It is running.
    Recording,
    /// It is over, as its reason says.
    Ended,
    /// An error ended it.
    Failed,
}

/// The status of a recording, as it is stored. While it is running, the counts are those of the last
/// finished part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// The swarm.
    pub swarm: String,
    /// The format of its parts. Earlier versions recorded Parquet as well.
    pub format: Format,
    /// The steps of its states are multiples of this; `None` in recordings of published states by
    /// an earlier version.
    pub every: Option<u64>,
    /// Whether states are dropped while the queue is full; otherwise the swarm waits.
    #[serde(default)]
    pub drop_when_behind: bool,
    /// The size at which it ends.
    #[serde(default)]
    pub max_bytes: Option<u64>,
    /// The remaining steps, if their number is limited.
    #[serde(default)]
    pub steps_left: Option<u64>,
    /// Whether a client deletes it after it has fetched it.
    #[serde(default)]
    pub temporary: bool,
    /// What it is doing.
    pub phase: Phase,
    /// Why it ended or failed.
    pub reason: Option<String>,
    /// The number of states.
    pub frames: u64,
    /// The number of dropped states.
    pub missed: u64,
    /// The number of finished parts.
    pub parts: u64,
    /// The bytes of these parts.
    pub bytes: u64,
    /// When it was started.
    pub began_unix_secs: u64,
}

impl StatusFile for Status {
    const NAME: &'static str = "recording.json";
}

impl Status {
    pub(super) fn count(&mut self, written: Written, missed: u64) {
        let Written {
            frames,
            parts,
            bytes,
        } = written;
        (self.frames, self.parts, self.bytes) = (frames, parts, bytes);
        self.missed = missed;
    }
}

/// A recording in memory.
pub(super) struct Entry {
    pub(super) status: Status,
    /// The queue of its writer while it is running.
    pub(super) queue: Option<Arc<FrameQueue>>,
}

impl Entry {
    /// Whether it was running when the daemon ended and has not been resumed.
    pub(super) fn is_interrupted(&self) -> bool {
        self.status.phase == Phase::Recording && self.queue.is_none()
    }

    /// The present status.
    pub(super) fn report(&self) -> Status {
        let mut status = self.status.clone();
        if let Some(queue) = &self.queue {
            let (written, missed) = queue.progress();
            status.count(written, missed);
        }
        status
    }

    /// The bytes of its files, including the unfinished part.
    pub(super) fn size(&self) -> u64 {
        match &self.queue {
            Some(queue) => queue.size(),
            None => self.status.bytes,
        }
    }
}
