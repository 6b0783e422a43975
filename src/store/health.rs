//! Condition and counters of the store.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use crate::metrics::{Durations, Histogram};

/// Condition and counters of the store.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Health {
    /// The last write failed because the disk is full.
    pub is_full: bool,
    /// The last write failed for another reason.
    pub is_failing: bool,
    /// The backlog exceeds its limits: submitters of deferred rows have to stop until it is written.
    pub is_overrun: bool,
    /// Duration of the last commit, including its sync.
    pub last_commit_secs: f64,
    /// Total duration of all commits.
    pub total_commit_secs: f64,
    /// Histogram of commit durations.
    pub commit_time: Durations,
    /// Number of commits.
    pub commits: u64,
    /// Number of committed writes.
    pub writes: u64,
    /// Writes in the queue and the backlog.
    pub waiting: usize,
    /// Deferred submits that were rejected because they contradict what is stored.
    pub refused: u64,
    /// Damaged or missing records found by reads.
    pub damaged: u64,
    /// Size of the database and its WAL.
    pub bytes_on_disk: u64,
}

/// The counters behind [`Health`].
#[derive(Default)]
pub(super) struct Meter {
    pub(super) is_full: AtomicBool,
    pub(super) is_failing: AtomicBool,
    pub(super) is_overrun: AtomicBool,
    pub(super) backlog: AtomicUsize,
    pub(super) refused: AtomicU64,
    damaged: AtomicU64,
    commits: AtomicU64,
    writes: AtomicU64,
    last_nanos: AtomicU64,
    times: Histogram,
    total_nanos: AtomicU64,
}

impl Meter {
    /// Counts records that a read found damaged or missing.
    pub(super) fn found_damaged(&self, records: u64) {
        self.damaged.fetch_add(records, Ordering::Relaxed);
    }

    /// Counts a commit.
    pub(super) fn committed(&self, took: Duration, writes: usize) {
        let nanos = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        self.times.record(took);
        self.last_nanos.store(nanos, Ordering::Relaxed);
        self.total_nanos.fetch_add(nanos, Ordering::Relaxed);
        self.commits.fetch_add(1, Ordering::Relaxed);
        self.writes.fetch_add(writes as u64, Ordering::Relaxed);
    }

    /// Reads the counters; `queued` writes are in the queue.
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
            waiting: queued + self.backlog.load(Ordering::Relaxed),
            refused: self.refused.load(Ordering::Relaxed),
            damaged: self.damaged.load(Ordering::Relaxed),
            bytes_on_disk,
        }
    }
}
