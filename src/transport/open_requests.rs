//! The HTTP requests that wait for a reply: zenoh does not tell a queryable that nobody waits any more.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use parking_lot::Mutex;

/// The parameter of a query with the number of its HTTP request. Like those of zenoh it begins with `_`,
/// so other daemons ignore it.
pub const PARAMETER: &str = "_http";

/// The HTTP requests that wait. Clones are the same requests.
#[derive(Clone, Default)]
pub struct OpenRequests(Arc<Inner>);

#[derive(Default)]
struct Inner {
    number: AtomicU64,
    /// Whether the client of each request is gone.
    is_gone: Mutex<HashMap<u64, Arc<AtomicBool>>>,
}

/// A request that waits until this is dropped: it has its reply, or its connection was closed.
pub struct OpenRequest {
    all: OpenRequests,
    /// Its number.
    pub number: u64,
}

impl OpenRequests {
    /// Adds a request.
    pub fn begin(&self) -> OpenRequest {
        let number = self.0.number.fetch_add(1, Ordering::Relaxed);
        self.0.is_gone.lock().insert(number, Arc::default());
        OpenRequest {
            all: self.clone(),
            number,
        }
    }

    /// Whether the client of this request is gone, now and later; `None` if there is no such request.
    pub fn is_gone(&self, number: u64) -> Option<Arc<AtomicBool>> {
        self.0.is_gone.lock().get(&number).cloned()
    }
}

impl Drop for OpenRequest {
    fn drop(&mut self) {
        if let Some(is_gone) = self.all.0.is_gone.lock().remove(&self.number) {
            is_gone.store(true, Ordering::Relaxed);
        }
    }
}
