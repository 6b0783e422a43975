//! Which swarms of the previous run are not recovered yet.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use jostle_physics::plural::counted;
use parking_lot::Mutex;

/// The progress of the recovery after a start of the daemon. Until [`end`](Self::end) replies about swarms
/// that are not recovered yet could be wrong.
#[derive(Debug, Default)]
pub struct RecoveryProgress {
    has_ended: AtomicBool,
    /// Every change is one call of the set, so a panic leaves it whole.
    pending: Mutex<BTreeSet<String>>,
    /// The lines and steps that were replayed.
    work: AtomicU64,
}

impl RecoveryProgress {
    /// Notes the swarms that are to be recovered.
    pub fn begin(&self, swarms: impl Iterator<Item = String>) {
        self.pending.lock().extend(swarms);
    }

    /// Notes that clients can reach a swarm, or that it has ended.
    pub fn remove(&self, swarm: &str) {
        if self.is_ongoing() {
            self.pending.lock().remove(swarm);
        }
    }

    /// Notes that a line or a step was replayed.
    pub fn note_work(&self) {
        self.work.fetch_add(1, Ordering::Relaxed);
    }

    /// Grows while swarms are replayed.
    pub fn work(&self) -> u64 {
        self.work.load(Ordering::Relaxed)
    }

    /// Ends the recovery. Returns the swarms that could not be recovered.
    pub fn end(&self) -> BTreeSet<String> {
        let failed = std::mem::take(&mut *self.pending.lock());
        self.has_ended.store(true, Ordering::Release);
        failed
    }

    /// Whether a swarm is still to be recovered.
    pub fn is_pending(&self, swarm: &str) -> bool {
        self.is_ongoing() && self.pending.lock().contains(swarm)
    }

    /// The number of swarms that are still to be recovered; `None` once the recovery has ended.
    pub fn swarms_left(&self) -> Option<usize> {
        self.is_ongoing().then(|| self.pending.lock().len())
    }

    fn is_ongoing(&self) -> bool {
        // Commands in lock-step need no lock.
        !self.has_ended.load(Ordering::Acquire)
    }
}

/// Returns how many swarms are left, as a part of a sentence; empty if it is 0: at the begin, when their number is
/// not known, and at the end.
pub fn still_left(count: usize) -> String {
    match count {
        0 => String::new(),
        count => format!(", {} left", counted(count, "swarm")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_said_of_0_swarms_that_are_left() {
        let left = [0, 1, 4].map(still_left);
        assert_eq!(left, ["", ", 1 swarm left", ", 4 swarms left"]);
    }

    #[test]
    fn a_swarm_is_pending_until_it_is_recovered_or_the_recovery_ends() {
        let progress = RecoveryProgress::default();
        assert_eq!(progress.swarms_left(), Some(0));
        progress.begin(["a", "b"].map(str::to_owned).into_iter());
        assert!(progress.is_pending("a") && !progress.is_pending("c"));
        progress.remove("a");
        assert_eq!(progress.swarms_left(), Some(1));
        assert!(!progress.is_pending("a"));
        assert_eq!(progress.end(), BTreeSet::from(["b".to_owned()]));
        assert!(!progress.is_pending("b"));
        assert_eq!(progress.swarms_left(), None);
    }
}
