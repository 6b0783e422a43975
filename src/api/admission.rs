//! Limits for the requests that have no reply yet.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Requests to one queryable that may be unanswered; further ones are rejected with `busy`. So many
/// are answered within a few milliseconds, and they delay the requests to other swarms no longer:
/// with 256 twice as long, with 64 or 16 no shorter. A hundred at once are served.
const MAX_UNANSWERED: usize = 128;

/// Bytes of all unanswered requests; further ones are rejected with `busy`.
const MAX_UNANSWERED_BYTES: usize = 64 * 1024 * 1024;

/// Counts the bytes of all unanswered requests. Clones share the count.
#[derive(Clone, Default)]
pub struct Admission(Arc<AtomicUsize>);

/// The place of a request among those that are unanswered, until this is dropped.
pub struct Permit {
    bytes: usize,
    all_bytes: Arc<AtomicUsize>,
    unanswered: Arc<AtomicUsize>,
}

impl Admission {
    /// Admits a request of so many bytes, unless the limits are reached. `unanswered` counts the
    /// requests to its queryable.
    pub fn admit(&self, bytes: usize, unanswered: &Arc<AtomicUsize>) -> Option<Permit> {
        let others = unanswered.fetch_add(1, Ordering::Relaxed);
        let other_bytes = self.0.fetch_add(bytes, Ordering::Relaxed);
        // Dropping it restores both counts.
        let permit = Permit {
            bytes,
            all_bytes: self.0.clone(),
            unanswered: unanswered.clone(),
        };
        let is_full = bytes > 0 && other_bytes >= MAX_UNANSWERED_BYTES;
        (others < MAX_UNANSWERED && !is_full).then_some(permit)
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        self.all_bytes.fetch_sub(self.bytes, Ordering::Relaxed);
        self.unanswered.fetch_sub(1, Ordering::Relaxed);
    }
}
