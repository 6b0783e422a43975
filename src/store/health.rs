//! How the store is doing.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use crate::metrics::{Durations, Histogram};

/// How the store is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Health {
    /// The last attempt to write found no space.
    pub is_full: bool,
    /// The last attempt to write failed otherwise.
    pub is_failing: bool,
    /// More waits for space than should be kept in memory: whoever submits rows without waiting
    /// for them has to stop until it is written.
    pub is_overrun: bool,
    /// How long the last commit took, its sync included.
    pub last_commit_secs: f64,
    /// How long all commits took.
    pub total_commit_secs: f64,
    /// How long each commit took.
    pub commit_time: Durations,
    /// Commits.
    pub commits: u64,
    /// Writes committed.
    pub writes: u64,
    /// Writes that wait.
    pub waiting: usize,
    /// Lazy submits refused because they contradicted what is stored.
    pub refused: u64,
    /// Damaged or missing records that readers have met.
    pub damaged: u64,
    /// What the database and its WAL take, in bytes.
    pub bytes_on_disk: u64,
}

/// The counters behind [`Health`].
#[derive(Default)]
pub(super) struct Meter {
    pub(super) is_full: AtomicBool,
    pub(super) is_failing: AtomicBool,
    pub(super) is_overrun: AtomicBool,
    pub(super) kept: AtomicUsize,
    pub(super) refused: AtomicU64,
    pub(super) damaged: AtomicU64,
    commits: AtomicU64,
    writes: AtomicU64,
    last_nanos: AtomicU64,
    times: Histogram,
    total_nanos: AtomicU64,
}

impl Meter {
    /// Counts a commit.
    pub(super) fn committed(&self, took: Duration, writes: usize) {
        let nanos = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        self.times.record(took);
        self.last_nanos.store(nanos, Ordering::Relaxed);
        self.total_nanos.fetch_add(nanos, Ordering::Relaxed);
        self.commits.fetch_add(1, Ordering::Relaxed);
        self.writes.fetch_add(writes as u64, Ordering::Relaxed);
    }

    /// Reads the counters; `queued` writes wait in the queue.
    pub(super) fn read(&self, queued: usize, bytes_on_disk: u64) -> Health {
        let secs =
            |nanos: &AtomicU64| Duration::from_nanos(nanos.load(Ordering::Relaxed)).as_secs_f64();
        Health {
            is_full: self.is_full.load(Ordering::Relaxed),
            is_failing: self.is_failing.load(Ordering::Relaxed),
            is_overrun: self.is_overrun.load(Ordering::Relaxed),
            last_commit_secs: secs(&self.last_nanos),
            total_commit_secs: secs(&self.total_nanos),
            commit_time: self.times.read(),
            commits: self.commits.load(Ordering::Relaxed),
            writes: self.writes.load(Ordering::Relaxed),
            waiting: queued + self.kept.load(Ordering::Relaxed),
            refused: self.refused.load(Ordering::Relaxed),
            damaged: self.damaged.load(Ordering::Relaxed),
            bytes_on_disk,
        }
    }
}
