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
    damaged: AtomicU64,
    writes: AtomicU64,
    last_nanos: AtomicU64,
    times: Histogram,
}

impl Meter {
    pub(super) fn found_damaged(&self, records: u64) {
        self.damaged.fetch_add(records, Ordering::Relaxed);
    }

    pub(super) fn committed(&self, took: Duration, writes: usize) {
        let nanos = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        self.times.record(took);
        self.last_nanos.store(nanos, Ordering::Relaxed);
        self.writes.fetch_add(writes as u64, Ordering::Relaxed);
    }

    /// Reads the counters; `queued` writes are in the queue.
    pub(super) fn read(&self, queued: usize, bytes_on_disk: u64) -> Health {
        let last = Duration::from_nanos(self.last_nanos.load(Ordering::Relaxed));
        let commit_time = self.times.read();
        Health {
            is_full: self.is_full.load(Ordering::Relaxed),
            is_failing: self.is_failing.load(Ordering::Relaxed),
            is_overrun: self.is_overrun.load(Ordering::Relaxed),
            last_commit_secs: last.as_secs_f64(),
            total_commit_secs: commit_time.secs(),
            commits: commit_time.count(),
            commit_time,
            writes: self.writes.load(Ordering::Relaxed),
            waiting: queued + self.backlog.load(Ordering::Relaxed),
            damaged: self.damaged.load(Ordering::Relaxed),
            bytes_on_disk,
        }
    }
}
