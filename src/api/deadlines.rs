//! When promises are to be kept at the latest, and what is said if they were not.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crate::api::responder::Promise;
use crate::convert::Payload;

/// Deadlines kept without looking for those that no longer matter.
const DEADLINES_BEFORE_SWEEP: usize = 4096;

/// When promises are to be kept at the latest. Whoever watches them is woken by a time that comes
/// before all others, and not by every promise: in a flood those are ten thousands a second.
#[derive(Default)]
pub(crate) struct Deadlines {
    dues: Mutex<Dues>,
    changed: Condvar,
}

#[derive(Default)]
struct Dues {
    heap: BinaryHeap<Reverse<Due>>,
    /// How many there are to be before those are dropped that no longer matter.
    sweep_at: usize,
    is_stopped: bool,
}

/// A promise, when it is to be kept, and what is said if it was not.
pub(crate) struct Due {
    at: Instant,
    number: u64,
    promise: Promise,
    excuse: Box<dyn FnOnce() -> Payload + Send>,
}

impl Deadlines {
    /// Watches over one more.
    pub(crate) fn add(&self, due: Due) {
        let mut dues = self.lock();
        if dues.is_stopped {
            return;
        }
        if dues.heap.len() >= dues.sweep_at {
            dues.heap.retain(|Reverse(due)| !due.promise.is_kept());
            dues.sweep_at = (2 * dues.heap.len()).max(DEADLINES_BEFORE_SWEEP);
        }
        let is_first = dues
            .heap
            .peek()
            .is_none_or(|Reverse(first)| due.at < first.at);
        dues.heap.push(Reverse(due));
        drop(dues);
        if is_first {
            self.changed.notify_one();
        }
    }

    /// Refuses what is not kept in time, until stopped.
    pub(crate) fn watch(&self) {
        let mut dues = self.lock();
        while !dues.is_stopped {
            let Some(Reverse(first)) = dues.heap.peek() else {
                let woken = self.changed.wait(dues);
                dues = woken.unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            let left = first.at.saturating_duration_since(Instant::now());
            if !left.is_zero() {
                let woken = self.changed.wait_timeout(dues, left);
                dues = woken.unwrap_or_else(PoisonError::into_inner).0;
                continue;
            }
            let due = dues.heap.pop();
            drop(dues);
            if let Some(Reverse(Due {
                promise, excuse, ..
            })) = due
                && !promise.is_kept()
            {
                promise.keep(move || Err(excuse()));
            }
            dues = self.lock();
        }
        // What is owed holds the desk, and letting go of a query may wait for a frozen client.
        let left = std::mem::take(&mut dues.heap);
        drop(dues);
        drop(left);
    }

    /// Has whoever watches end.
    pub(crate) fn stop(&self) {
        self.lock().is_stopped = true;
        self.changed.notify_one();
    }

    fn lock(&self) -> MutexGuard<'_, Dues> {
        self.dues.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Due {
    /// Has a promise kept at the latest then.
    pub(crate) fn new(
        at: Instant,
        promise: Promise,
        excuse: Box<dyn FnOnce() -> Payload + Send>,
    ) -> Self {
        static NUMBERS: AtomicU64 = AtomicU64::new(0);
        Due {
            at,
            number: NUMBERS.fetch_add(1, Ordering::Relaxed),
            promise,
            excuse,
        }
    }
}

impl PartialEq for Due {
    fn eq(&self, other: &Self) -> bool {
        self.number == other.number
    }
}

impl Eq for Due {}

impl PartialOrd for Due {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Due {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at, self.number).cmp(&(other.at, other.number))
    }
}
