//! The open HTTP connections and WebSockets, and the limits on their number.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use parking_lot::Mutex;
use rustix::process::{Resource, getrlimit};
use tokio::sync::Notify;

/// The upper bound of the cap on open connections.
const MAX_CONNECTIONS: usize = 1024;

/// Open WebSockets in total.
const MAX_SOCKETS: usize = 256;

/// Open WebSockets of one user.
const MAX_SOCKETS_PER_PERSON: usize = 32;

/// The cap on open connections: [`MAX_CONNECTIONS`], or a quarter of the descriptor limit if that
/// is less.
pub fn max_connections() -> usize {
    let descriptors = getrlimit(Resource::Nofile).current;
    let quarter = descriptors.map_or(MAX_CONNECTIONS, |most| {
        usize::try_from(most / 4).unwrap_or(MAX_CONNECTIONS)
    });
    quarter.clamp(1, MAX_CONNECTIONS)
}

/// Why the daemon closed a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloseReason {
    /// The cap was reached, and another connection took its place.
    Evicted,
    /// The cap was reached, and no other connection could be evicted for it.
    Refused,
    HandshakeTimeout,
    HeaderTimeout,
    BodyTimeout,
}

/// The reasons in the metrics.
const LABELS: [&str; 5] = [
    "evicted",
    "refused",
    "handshake_timeout",
    "header_timeout",
    "body_timeout",
];

/// The connections in numbers.
#[derive(Debug)]
pub struct HttpMetrics {
    pub open: u64,
    pub accept_failures: u64,
    /// Connections that the daemon closed, by the label of the reason.
    pub closed: [(&'static str, u64); 5],
}

/// The registry of open connections.
pub struct Connections {
    max: usize,
    max_per_peer: usize,
    registry: Mutex<Registry>,
    accept_failures: AtomicU64,
    closed: [AtomicU64; 5],
}

#[derive(Default)]
struct Registry {
    next_id: u64,
    entries: HashMap<u64, Entry>,
}

struct Entry {
    peer: IpAddr,
    /// When the last request was answered, or the connection was accepted.
    last_complete: Instant,
    /// Whether a request is being answered: an eviction ends its work.
    is_answering: bool,
    /// The user of an open WebSocket, if there are users.
    socket: Option<Option<String>>,
    evicted: Arc<Notify>,
}

impl Connections {
    /// A registry of at most `max` connections. A peer that is not loopback gets a quarter of them.
    pub fn new(max: usize) -> Arc<Self> {
        Arc::new(Connections {
            max,
            max_per_peer: (max / 4).max(1),
            registry: Mutex::default(),
            accept_failures: AtomicU64::new(0),
            closed: Default::default(),
        })
    }

    /// Counts an accept that failed; returns how many have.
    pub fn count_accept_failure(&self) -> u64 {
        self.accept_failures.fetch_add(1, Ordering::Relaxed) + 1
    }

    pub fn count_closed(&self, reason: CloseReason) {
        self.closed[reason as usize].fetch_add(1, Ordering::Relaxed);
    }

    pub fn metrics(&self) -> HttpMetrics {
        HttpMetrics {
            open: self.registry.lock().entries.len() as u64,
            accept_failures: self.accept_failures.load(Ordering::Relaxed),
            closed: std::array::from_fn(|reason| {
                (LABELS[reason], self.closed[reason].load(Ordering::Relaxed))
            }),
        }
    }

    /// Registers a connection. At the cap, evicts the connection without an open WebSocket that has
    /// gone longest without completing a request, first among those without a request; at the cap of one
    /// peer, such a connection of that peer. Returns `None` if there is none to evict.
    pub fn register(self: &Arc<Self>, peer: IpAddr) -> Option<Arc<Slot>> {
        let mut registry = self.registry.lock();
        let of_peer = |entry: &&Entry| entry.peer == peer;
        let used = registry.entries.values().filter(of_peer).count();
        let is_peer_full = !peer.to_canonical().is_loopback() && used >= self.max_per_peer;
        if is_peer_full || registry.entries.len() >= self.max {
            let evicted = registry.evict(|entry| !is_peer_full || of_peer(&entry));
            self.count_closed(evicted.map_or(CloseReason::Refused, |()| CloseReason::Evicted));
            evicted?;
        }
        let id = registry.next_id;
        registry.next_id += 1;
        let evicted = Arc::new(Notify::new());
        let entry = Entry {
            peer,
            last_complete: Instant::now(),
            is_answering: false,
            socket: None,
            evicted: evicted.clone(),
        };
        registry.entries.insert(id, entry);
        Some(Arc::new(Slot {
            id,
            evicted,
            connections: self.clone(),
        }))
    }
}

impl Registry {
    fn evict(&mut self, is_candidate: impl Fn(&Entry) -> bool) -> Option<()> {
        let candidates = self.entries.iter();
        let candidates = candidates.filter(|(_, it)| it.socket.is_none() && is_candidate(it));
        let (&id, _) =
            candidates.min_by_key(|(id, it)| (it.is_answering, it.last_complete, **id))?;
        self.entries.remove(&id)?.evicted.notify_one();
        Some(())
    }
}

/// The registration of one connection, removed when the last reference is dropped.
pub struct Slot {
    id: u64,
    evicted: Arc<Notify>,
    /// The registry.
    pub connections: Arc<Connections>,
}

impl Slot {
    /// Completes when the connection is evicted.
    pub async fn evicted(&self) {
        self.evicted.notified().await;
    }

    /// Records that a request is being answered.
    pub fn begin(&self) {
        if let Some(entry) = self.connections.registry.lock().entries.get_mut(&self.id) {
            entry.is_answering = true;
        }
    }

    /// Records that a request was answered.
    pub fn complete(&self) {
        if let Some(entry) = self.connections.registry.lock().entries.get_mut(&self.id) {
            entry.is_answering = false;
            entry.last_complete = Instant::now();
        }
    }

    /// Records that the connection is a WebSocket from now on, which is not evicted. At most
    /// [`MAX_SOCKETS`] are open, and at most three quarters of all connections, so that WebSockets
    /// alone cannot reach that cap. The error names the limit that is reached.
    pub fn upgrade(&self, person: Option<&str>) -> Result<(), String> {
        let mut registry = self.connections.registry.lock();
        let max = MAX_SOCKETS.min((self.connections.max * 3 / 4).max(1));
        let entries = registry.entries.values();
        let sockets: Vec<_> = entries.filter_map(|it| it.socket.as_ref()).collect();
        let of_person = sockets.iter().filter(|it| it.as_deref() == person);
        if sockets.len() >= max {
            return Err(format!("{max} tabs are open: close one"));
        }
        if let Some(name) = person
            && of_person.count() >= MAX_SOCKETS_PER_PERSON
        {
            return Err(format!(
                "{MAX_SOCKETS_PER_PERSON} tabs of {name} are open: close one"
            ));
        }
        if let Some(entry) = registry.entries.get_mut(&self.id) {
            entry.socket = Some(person.map(str::to_owned));
        }
        Ok(())
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.connections.registry.lock().entries.remove(&self.id);
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::net::Ipv4Addr;

    use super::*;

    const LOCAL: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
    const REMOTE: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 1));

    fn ids(connections: &Arc<Connections>) -> Vec<u64> {
        let mut ids: Vec<u64> = connections
            .registry
            .lock()
            .entries
            .keys()
            .copied()
            .collect();
        ids.sort_unstable();
        ids
    }

    #[test]
    fn the_connection_longest_without_a_request_is_evicted() {
        let connections = Connections::new(3);
        let slots: Vec<_> = (0..3)
            .map(|_| connections.register(LOCAL).unwrap())
            .collect();
        slots[0].upgrade(None).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(2));
        slots[1].complete();
        let fourth = connections.register(LOCAL).unwrap();
        assert_eq!(ids(&connections), [0, 1, 3]);
        slots[1].upgrade(None).unwrap();
        assert!(fourth.upgrade(None).is_err(), "three quarters");
        // Sockets reach a cap only if it is that of one peer.
        let mut registry = connections.registry.lock();
        registry.entries.get_mut(&fourth.id).unwrap().socket = Some(None);
        drop(registry);
        assert!(connections.register(LOCAL).is_none(), "all are WebSockets");
        let HttpMetrics { open, closed, .. } = connections.metrics();
        assert_eq!(
            (open, closed[0], closed[1]),
            (3, ("evicted", 1), ("refused", 1))
        );
        drop(slots);
        assert_eq!(ids(&connections), [3]);
    }

    #[test]
    fn a_connection_that_waits_for_a_reply_is_evicted_last() {
        let connections = Connections::new(3);
        let slots: Vec<_> = (0..3)
            .map(|_| connections.register(LOCAL).unwrap())
            .collect();
        slots[0].begin();
        slots[1].begin();
        std::thread::sleep(std::time::Duration::from_millis(2));
        slots[1].complete();
        let fourth = connections.register(LOCAL).unwrap();
        assert_eq!(ids(&connections), [0, 1, 3]);
        slots[1].begin();
        fourth.begin();
        // All wait.
        let fifth = connections.register(LOCAL).unwrap();
        assert_eq!(ids(&connections), [1, 3, fifth.id]);
    }

    #[test]
    fn a_remote_peer_gets_a_quarter_of_the_connections() {
        let connections = Connections::new(8);
        let local = connections.register(LOCAL).unwrap();
        let remote: Vec<_> = (0..4)
            .map(|_| connections.register(REMOTE).unwrap())
            .collect();
        assert_eq!(ids(&connections), [0, 3, 4]);
        drop((local, remote));
        assert!(ids(&connections).is_empty());
    }

    #[test]
    fn a_person_has_at_most_32_web_sockets_and_all_have_256() {
        let connections = Connections::new(MAX_CONNECTIONS);
        let open = |person| {
            let slot = connections.register(LOCAL).unwrap();
            slot.upgrade(person).map(|()| slot)
        };
        let mut slots: Vec<_> = (0..MAX_SOCKETS_PER_PERSON)
            .map(|_| open(Some("ada")).unwrap())
            .collect();
        assert!(open(Some("ada")).is_err());
        slots.extend((slots.len()..MAX_SOCKETS).map(|_| open(None).unwrap()));
        assert!(open(Some("bob")).is_err());
        slots.pop();
        assert!(open(Some("bob")).is_ok());
        drop(slots);
        assert!(connections.registry.lock().entries.is_empty());
    }
}
