//! Counters with a single writer thread.
//!
//! The writer uses plain loads and stores, without locks or atomic additions: a few nanoseconds for
//! a step that takes microseconds.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Upper bounds of a histogram's buckets, in microseconds, from the shortest steps to outliers. They
/// are densest around a millisecond, the usual lateness of a step. The last bucket has no bound.
const BOUNDS_MICROS: [u64; 24] = [
    5, 10, 25, 50, 100, 250, 500, 750, 1_000, 1_250, 1_500, 2_000, 2_500, 3_500, 5_000, 7_500,
    10_000, 25_000, 50_000, 100_000, 250_000, 1_000_000, 2_500_000, 10_000_000,
];

const BUCKETS: usize = BOUNDS_MICROS.len() + 1;

/// A histogram of durations with a single writer thread.
#[derive(Debug, Default)]
pub struct Histogram {
    counts: [AtomicU64; BUCKETS],
    nanos: AtomicU64,
}

impl Histogram {
    /// Counts a duration. Called by one thread only.
    pub fn record(&self, took: Duration) {
        let nanos = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        let bucket = BOUNDS_MICROS.partition_point(|bound| *bound * 1000 < nanos);
        add(&self.counts[bucket], 1);
        add(&self.nanos, nanos);
    }

    /// The current counts.
    pub fn read(&self) -> Durations {
        Durations {
            counts: self.counts.each_ref().map(|it| it.load(Ordering::Relaxed)),
            nanos: self.nanos.load(Ordering::Relaxed),
        }
    }
}

/// Durations: the number in each bucket, and their sum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Durations {
    counts: [u64; BUCKETS],
    nanos: u64,
}

impl Durations {
    /// The number of durations.
    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Their sum.
    pub fn secs(&self) -> f64 {
        Duration::from_nanos(self.nanos).as_secs_f64()
    }

    /// For each bucket its upper bound in seconds, the last one infinite, and its own count.
    pub fn buckets(&self) -> impl Iterator<Item = (f64, u64)> {
        let bounds = BOUNDS_MICROS
            .iter()
            .map(|micros| Duration::from_micros(*micros).as_secs_f64())
            .chain([f64::INFINITY]);
        bounds.zip(self.counts)
    }

    /// Adds the counts of `others`.
    pub fn add(&mut self, others: &Durations) {
        for (count, other) in self.counts.iter_mut().zip(others.counts) {
            *count += other;
        }
        self.nanos += others.nanos;
    }
}

/// Adds to a counter that only this thread writes.
pub fn add(counter: &AtomicU64, more: u64) {
    let now = counter.load(Ordering::Relaxed).wrapping_add(more);
    counter.store(now, Ordering::Relaxed);
}

/// Whether a thread is executing a task, and the number of that task, which is odd. The thread reads
/// no clock: the watchdog sees whether the number changes.
#[derive(Debug, Default)]
pub struct Activity(AtomicU64);

impl Activity {
    /// Begins a task, or the next one. Called by one thread only.
    pub fn begin(&self) {
        let now = self.0.load(Ordering::Relaxed);
        self.0.store(now.wrapping_add(1) | 1, Ordering::Relaxed);
    }

    /// Ends the task. Called by one thread only.
    pub fn end(&self) {
        let now = self.0.load(Ordering::Relaxed);
        self.0.store((now | 1).wrapping_add(1), Ordering::Relaxed);
    }

    /// The number of the current task.
    pub fn task(&self) -> Option<u64> {
        let now = self.0.load(Ordering::Relaxed);
        (now % 2 == 1).then_some(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_duration_is_in_the_bucket_whose_bound_it_does_not_exceed() {
        let histogram = Histogram::default();
        for nanos in [0, 5_000, 5_001, 2_000_000, 10_000_000_000, u64::MAX >> 1] {
            histogram.record(Duration::from_nanos(nanos));
        }
        let mut read = histogram.read();
        assert_eq!(read.count(), 6);
        let filled: Vec<(f64, u64)> = read.buckets().filter(|(_, count)| *count > 0).collect();
        assert_eq!(
            filled,
            [
                (5e-6, 2),
                (1e-5, 1),
                (2e-3, 1),
                (10.0, 1),
                (f64::INFINITY, 1)
            ]
        );
        read.add(&histogram.read());
        assert_eq!(read.count(), 12);
        assert!(BOUNDS_MICROS.is_sorted());
    }

    #[test]
    fn each_task_has_another_number() {
        let activity = Activity::default();
        assert_eq!(activity.task(), None);
        let mut before = None;
        for _ in 0..3 {
            activity.begin();
            assert!(activity.task() > before);
            before = activity.task();
            activity.begin();
            assert!(activity.task() > before);
            before = activity.task();
            activity.end();
            activity.end();
            assert_eq!(activity.task(), None);
        }
    }
}
