//! Metrics of a swarm, written by its thread and read by others.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use jostle_physics::stepper::StepReport;
use parking_lot::Mutex;

use crate::metrics::{Activity, Durations, Histogram, add};
use crate::swarm::frame::Frame;

/// Metrics of one swarm. Only its thread writes them.
#[derive(Debug, Default)]
pub struct SwarmMetrics {
    /// Whether the thread is working, for the watchdog.
    pub activity: Activity,
    step_time: Histogram,
    lateness: Histogram,
    degraded: AtomicU64,
    faults: AtomicU64,
    contacts: AtomicU64,
    // Bits of nonnegative doubles, whose order is the order of the numbers.
    residual: AtomicU64,
    residual_max: AtomicU64,
    is_measured: AtomicBool,
    /// A recent state of a swarm that publishes measures.
    measured: Mutex<Option<Arc<Frame>>>,
}

/// Totals of one swarm or of several.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Totals {
    /// Durations of its steps.
    pub step_time: Durations,
    /// Delays of the steps of a swarm with a rate, after they were due.
    pub lateness: Durations,
    /// Steps that missed the target residual.
    pub degraded: u64,
    /// Steps that failed.
    pub faults: u64,
    /// The largest residual of a step.
    pub residual_max: f64,
    /// Frames queued for the publisher.
    pub frames: u64,
    /// Those of them that were dropped for a newer one.
    pub frames_dropped: u64,
}

/// The last step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LastStep {
    /// Its number of contacts.
    pub contacts: u64,
    /// Its residual.
    pub residual: f64,
}

impl SwarmMetrics {
    /// Counts a step: its duration, its delay if it had a due time, and its report.
    pub fn stepped(&self, took: Duration, late: Option<Duration>, report: &StepReport) {
        self.step_time.record(took);
        if let Some(late) = late {
            self.lateness.record(late);
        }
        let residual = report.residual.abs().to_bits();
        self.contacts
            .store(report.contacts as u64, Ordering::Relaxed);
        self.residual.store(residual, Ordering::Relaxed);
        if residual > self.residual_max.load(Ordering::Relaxed) {
            self.residual_max.store(residual, Ordering::Relaxed);
        }
        if report.degraded {
            add(&self.degraded, 1);
        }
    }

    /// Replaces the state of which [`Self::measured`] evaluates measures; takes no lock without one.
    pub fn set_measured(&self, frame: Option<Arc<Frame>>) {
        let is_measured = frame.is_some();
        if self.is_measured.swap(is_measured, Ordering::Relaxed) || is_measured {
            *self.measured.lock() = frame;
        }
    }

    /// A recent state, if the swarm publishes measures.
    pub fn measured(&self) -> Option<Arc<Frame>> {
        self.measured.lock().clone()
    }

    /// Counts a fault.
    pub fn faulted(&self) {
        add(&self.faults, 1);
    }

    /// The totals; frames are counted by the output.
    pub fn totals(&self) -> Totals {
        Totals {
            step_time: self.step_time.read(),
            lateness: self.lateness.read(),
            degraded: self.degraded.load(Ordering::Relaxed),
            faults: self.faults.load(Ordering::Relaxed),
            residual_max: f64::from_bits(self.residual_max.load(Ordering::Relaxed)),
            frames: 0,
            frames_dropped: 0,
        }
    }

    /// The last step.
    pub fn last_step(&self) -> LastStep {
        LastStep {
            contacts: self.contacts.load(Ordering::Relaxed),
            residual: f64::from_bits(self.residual.load(Ordering::Relaxed)),
        }
    }
}

impl Totals {
    /// Adds the totals of others.
    pub fn add(&mut self, others: &Totals) {
        self.step_time.add(&others.step_time);
        self.lateness.add(&others.lateness);
        self.degraded += others.degraded;
        self.faults += others.faults;
        self.residual_max = self.residual_max.max(others.residual_max);
        self.frames += others.frames;
        self.frames_dropped += others.frames_dropped;
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::float_cmp, reason = "exact")]

    use super::*;

    fn report(residual: f64) -> StepReport {
        StepReport {
            contacts: 3,
            active: 0,
            iterations: 1,
            fallback: 0,
            residual,
            degraded: residual > 1e-9,
            ..StepReport::default()
        }
    }

    #[test]
    fn steps_are_counted_with_their_reports() {
        let metrics = SwarmMetrics::default();
        let late = Some(Duration::from_millis(2));
        metrics.stepped(Duration::from_micros(7), late, &report(1e-6));
        metrics.stepped(Duration::from_micros(7), None, &report(1e-12));
        metrics.faulted();
        let totals = metrics.totals();
        assert_eq!((totals.step_time.count(), totals.lateness.count()), (2, 1));
        assert_eq!((totals.degraded, totals.faults), (1, 1));
        assert_eq!(totals.residual_max, 1e-6);
        assert_eq!(
            metrics.last_step(),
            LastStep {
                contacts: 3,
                residual: 1e-12
            }
        );
        let mut both = totals;
        both.add(&totals);
        assert_eq!(both.step_time.count(), 4);
    }
}
