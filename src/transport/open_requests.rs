//! The HTTP requests that wait for a reply: zenoh does not tell a queryable that nobody waits any more.

use std::collections::HashMap;
use std::hash::{BuildHasher as _, RandomState};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use parking_lot::Mutex;

/// The parameter of a query that names its HTTP request. Like those of zenoh it begins with `_`, so no
/// daemon rejects it.
pub const PARAMETER: &str = "_http";

/// The HTTP requests that wait. Clones are the same requests.
#[derive(Clone, Default)]
pub struct OpenRequests(Arc<Inner>);

struct Inner {
    /// Differs between daemons, which receive queries of each other's HTTP servers.
    instance: u64,
    number: AtomicU64,
    /// Whether the client of each request is gone.
    is_gone: Mutex<HashMap<u64, Arc<AtomicBool>>>,
}

/// A request that waits until this is dropped: it has its reply, or its connection was closed.
pub struct OpenRequest {
    all: OpenRequests,
    number: u64,
}

impl OpenRequest {
    /// Its name, the value of [`PARAMETER`].
    pub fn name(&self) -> String {
        format!("{}.{}", self.all.0.instance, self.number)
    }
}

impl Default for Inner {
    fn default() -> Self {
        Inner {
            instance: RandomState::new().hash_one(()),
            number: AtomicU64::new(0),
            is_gone: Mutex::default(),
        }
    }
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

    /// Whether the client of the request of this name is gone, now and later; `None` if it is not a
    /// request to this daemon's HTTP server. A client may be gone before its query arrives.
    pub fn is_gone(&self, name: &str) -> Option<Arc<AtomicBool>> {
        let (instance, number) = name.split_once('.')?;
        let (instance, number): (u64, u64) = (instance.parse().ok()?, number.parse().ok()?);
        if instance != self.0.instance {
            return None;
        }
        let known = self.0.is_gone.lock().get(&number).cloned();
        Some(known.unwrap_or_else(|| Arc::new(AtomicBool::new(true))))
    }
}

impl Drop for OpenRequest {
    fn drop(&mut self) {
        if let Some(is_gone) = self.all.0.is_gone.lock().remove(&self.number) {
            is_gone.store(true, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_client_is_gone_once_its_request_is_dropped_also_before_its_query_arrives() {
        let (open, other) = (OpenRequests::default(), OpenRequests::default());
        let request = open.begin();
        let name = request.name();
        let is_gone = || open.is_gone(&name).map(|it| it.load(Ordering::Relaxed));
        let known = open.is_gone(&name);
        assert_eq!(is_gone(), Some(false));
        let theirs = other.begin();
        assert_eq!(theirs.number, request.number);
        drop(request);
        assert!(known.is_some_and(|it| it.load(Ordering::Relaxed)));
        assert_eq!(is_gone(), Some(true));
        // Another daemon does not know it, and has one of the same number.
        assert!(other.is_gone(&name).is_none());
        for invalid in ["", "1", "a.b", "-1.2"] {
            assert!(open.is_gone(invalid).is_none(), "{invalid:?}");
        }
    }
}
