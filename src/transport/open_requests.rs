//! The HTTP requests that wait for a reply: zenoh does not tell a queryable that nobody waits any more.

use std::collections::HashMap;
use std::hash::{BuildHasher as _, RandomState};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::Mutex;

use crate::swarm::awaited::Holder;

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
    /// The connection of each request.
    connections: Mutex<HashMap<u64, Arc<Holder>>>,
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
            connections: Mutex::default(),
        }
    }
}

impl OpenRequests {
    /// Adds a request.
    pub fn begin(&self) -> OpenRequest {
        let number = self.0.number.fetch_add(1, Ordering::Relaxed);
        let connection = Arc::new(Holder::connection(true));
        self.0.connections.lock().insert(number, connection);
        OpenRequest {
            all: self.clone(),
            number,
        }
    }

    /// The connection of the request of this name; `None` if it is not a request to this daemon's HTTP
    /// server. A client may be gone before its query arrives.
    pub fn connection(&self, name: &str) -> Option<Arc<Holder>> {
        let (instance, number) = name.split_once('.')?;
        let (instance, number): (u64, u64) = (instance.parse().ok()?, number.parse().ok()?);
        if instance != self.0.instance {
            return None;
        }
        let known = self.0.connections.lock().get(&number).cloned();
        Some(known.unwrap_or_else(|| Arc::new(Holder::connection(false))))
    }
}

impl Drop for OpenRequest {
    fn drop(&mut self) {
        if let Some(connection) = self.all.0.connections.lock().remove(&self.number) {
            connection.set(false);
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
        let is_gone = || Some(open.connection(&name)?.gone_since().is_some());
        let known = open.connection(&name);
        assert_eq!(is_gone(), Some(false));
        let theirs = other.begin();
        assert_eq!(theirs.number, request.number);
        drop(request);
        assert!(known.is_some_and(|it| it.gone_since().is_some()));
        assert_eq!(is_gone(), Some(true));
        // Another daemon does not know it, and has one of the same number.
        assert!(other.connection(&name).is_none());
        for invalid in ["", "1", "a.b", "-1.2"] {
            assert!(open.connection(invalid).is_none(), "{invalid:?}");
        }
    }
}
