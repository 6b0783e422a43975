//! Counters that one thread writes without waiting and others read.
//!
//! The writer loads and stores, it never locks, allocates or adds atomically: where every step is
//! counted that is some nanoseconds of its microseconds.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Upper bounds of a histogram's buckets, in nanoseconds: from the smallest step to what is an
/// accident, and closest to each other about a millisecond, by which steps may be late. A last bucket
/// holds what is longer.
pub const BOUNDS_NANOS: [u64; 24] = [
    5_000,
    10_000,
    25_000,
    50_000,
    100_000,
    250_000,
    500_000,
    750_000,
    1_000_000,
    1_250_000,
    1_500_000,
    2_000_000,
    2_500_000,
    3_500_000,
    5_000_000,
    7_500_000,
    10_000_000,
    25_000_000,
    50_000_000,
    100_000_000,
    250_000_000,
    1_000_000_000,
    2_500_000_000,
    10_000_000_000,
];

const BUCKETS: usize = BOUNDS_NANOS.len() + 1;

/// How long things took, counted by one thread.
#[derive(Debug, Default)]
pub struct Histogram {
    counts: [AtomicU64; BUCKETS],
    nanos: AtomicU64,
}

impl Histogram {
    /// Counts one more. Only one thread may.
    pub fn record(&self, took: Duration) {
        let nanos = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        let bucket = BOUNDS_NANOS.partition_point(|bound| *bound < nanos);
        add(&self.counts[bucket], 1);
        add(&self.nanos, nanos);
    }

    /// What has been counted.
    pub fn read(&self) -> Durations {
        Durations {
            counts: self.counts.each_ref().map(|it| it.load(Ordering::Relaxed)),
            nanos: self.nanos.load(Ordering::Relaxed),
        }
    }
}

/// How long things took: how many in each bucket, and all together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Durations {
    counts: [u64; BUCKETS],
    nanos: u64,
}

impl Durations {
    /// How many there were.
    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// How long all of them took.
    pub fn secs(&self) -> f64 {
        Duration::from_nanos(self.nanos).as_secs_f64()
    }

    /// The buckets: each upper bound in seconds, the last infinite, and how many are in it alone.
    pub fn buckets(&self) -> impl Iterator<Item = (f64, u64)> {
        let bounds = BOUNDS_NANOS
            .iter()
            .map(|nanos| Duration::from_nanos(*nanos).as_secs_f64())
            .chain([f64::INFINITY]);
        bounds.zip(self.counts)
    }

    /// Adds what others counted.
    pub fn add(&mut self, others: &Durations) {
        for (count, other) in self.counts.iter_mut().zip(others.counts) {
            *count += other;
        }
        self.nanos += others.nanos;
    }
}

/// Adds to what only this thread writes.
pub fn add(counter: &AtomicU64, more: u64) {
    let now = counter.load(Ordering::Relaxed).wrapping_add(more);
    counter.store(now, Ordering::Relaxed);
}

/// Whether a thread is at work, and on what number of it: odd while it works. It needs no clock;
/// who watches it has one, and sees whether the number changes.
#[derive(Debug, Default)]
pub struct Pulse(AtomicU64);

impl Pulse {
    /// Begins a piece of work, or the next one. Only one thread may.
    pub fn beat(&self) {
        let now = self.0.load(Ordering::Relaxed);
        self.0.store(now.wrapping_add(1) | 1, Ordering::Relaxed);
    }

    /// Waits for work from here on. Only one thread may.
    pub fn rest(&self) {
        let now = self.0.load(Ordering::Relaxed);
        self.0.store((now | 1).wrapping_add(1), Ordering::Relaxed);
    }

    /// The number of the piece of work under way; none while it waits for work.
    pub fn at_work(&self) -> Option<u64> {
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
        assert!(BOUNDS_NANOS.is_sorted());
    }

    #[test]
    fn a_pulse_has_another_number_for_every_piece_of_work_and_none_at_rest() {
        let pulse = Pulse::default();
        assert_eq!(pulse.at_work(), None);
        let mut before = None;
        for _ in 0..3 {
            pulse.beat();
            assert!(pulse.at_work() > before);
            before = pulse.at_work();
            pulse.beat();
            assert!(pulse.at_work() > before);
            before = pulse.at_work();
            pulse.rest();
            pulse.rest();
            assert_eq!(pulse.at_work(), None);
        }
    }
}
