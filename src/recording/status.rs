//! The status of a recording: in memory, and in its folder.

use std::sync::Arc;
use std::time::SystemTime;

use jostle_proto::RecordingPhase as Phase;
use jostle_results::recording::{Format, Recorder, Written};
use serde::{Deserialize, Serialize};

use crate::jobs::StatusFile;
use crate::swarm::output::Subscription;

/// The epoch and the step of a state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Position {
    pub epoch: u64,
    pub step: u64,
}

impl From<(u64, u64)> for Position {
    fn from((epoch, step): (u64, u64)) -> Self {
        Position { epoch, step }
    }
}

/// States that a recording lacks, because the daemon ended before the part with them was complete.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gap {
    /// The state up to which nothing is missing; `None` if the recording begins with the gap.
    pub after: Option<Position>,
    /// The state at which the recording continues.
    pub until: Position,
    /// The number of missing states.
    pub missed: u64,
}

/// What a recording lacks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lost {
    /// The number of parts that are missing or damaged, as far as they are known; at least 1.
    pub parts: u64,
    /// Which, with the remedy.
    pub reason: String,
    /// What is there and can be read.
    pub there: Written,
}

/// The status of a recording, as it is stored. While it is running, the counts are those when the last
/// part was finished.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
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
    pub phase: Phase,
    pub reason: Option<String>,
    pub frames: u64,
    /// The number of dropped states, and of those in gaps.
    pub missed: u64,
    /// The number of states in gaps.
    #[serde(default)]
    pub lost: u64,
    /// The newest gaps, in order.
    #[serde(default)]
    pub gaps: Vec<Gap>,
    /// The first state that it contains if it is a multiple of `every`; `None` in recordings that an
    /// earlier version began.
    #[serde(default)]
    pub began_at: Option<Position>,
    /// The number of finished parts.
    pub parts: u64,
    /// The bytes of these parts; while it is running, also those of the part that is being written.
    pub bytes: u64,
    /// The bytes of the finished parts; `None` in recordings by an earlier version.
    #[serde(default)]
    pub part_bytes: Option<u64>,
    /// How many numbers below that of the next part no finished part has: an earlier version resumed it
    /// without these.
    #[serde(default)]
    pub skipped: u64,
    /// The number of finished parts that are missing or damaged; not stored.
    #[serde(skip)]
    pub lost_parts: u64,
    pub began_unix_secs: u64,
}

impl StatusFile for Status {
    const NAME: &'static str = "recording.json";
}

impl Status {
    pub fn new(swarm: String) -> Self {
        let began = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        Status {
            swarm,
            began_unix_secs: began.unwrap_or_default().as_secs(),
            ..Status::default()
        }
    }

    /// Counts what is in the finished parts.
    pub(super) fn count(&mut self, written: Written) {
        let Written {
            frames,
            parts,
            bytes,
        } = written;
        (self.frames, self.parts, self.bytes) = (frames, parts, bytes);
        self.part_bytes = Some(bytes);
    }

    /// Counts the part that is being written, too.
    pub(super) fn count_progress(&mut self, recorder: &Recorder) {
        self.count(recorder.written());
        self.bytes = recorder.progress().bytes;
    }
}

pub(super) struct Entry {
    /// Its status; while it is running, `missed` and `steps_left` are those of its start.
    pub(super) status: Status,
    /// The bytes of its files, including the unfinished part.
    pub(super) size: u64,
    /// The subscription of its writer while it is running.
    pub(super) subscription: Option<Arc<Subscription>>,
    /// What it lacked when its files were last compared with its status.
    pub(super) lost: Option<Lost>,
    /// When its folder had last changed then, unless it may have changed again at that time.
    pub(super) checked: Option<SystemTime>,
}

impl Entry {
    /// A recording without a writer.
    pub(super) fn idle(status: Status) -> Self {
        Entry {
            size: status.bytes,
            status,
            subscription: None,
            lost: None,
            checked: None,
        }
    }

    /// Whether it was running when the daemon ended and has not been resumed.
    pub(super) fn is_interrupted(&self) -> bool {
        self.status.phase == Phase::Recording && self.subscription.is_none()
    }

    pub(super) fn report(&self) -> Status {
        let mut status = self.status.clone();
        if let Some(subscription) = &self.subscription {
            status.missed += subscription.frames().1;
            // `None` until an interrupted recording has opened its files.
            status.steps_left = subscription.steps_left().or(status.steps_left);
        }
        status
    }
}
