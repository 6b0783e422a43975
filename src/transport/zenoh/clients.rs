//! The sessions of the clients: the user of each, and which of them zenoh is closing.
//!
//! zenoh passes the user name of a session only to its own access control and to transport event
//! handlers, so this module implements such a handler.

use std::sync::Arc;
use std::time::Instant;

use parking_lot::Mutex;
use zenoh_transport::multicast::TransportMulticast;
use zenoh_transport::unicast::TransportUnicast;
use zenoh_transport::{
    DummyTransportMulticastEventHandler, DummyTransportPeerEventHandler, TransportEventHandler,
    TransportMulticastEventHandler, TransportPeer, TransportPeerEventHandler,
};

/// The fewest entries at which those of closed sessions are removed.
const MIN_SWEEP_ENTRIES: usize = 64;

/// The sessions that are open or being closed.
#[derive(Default)]
pub struct Sessions {
    known: Mutex<SessionTable>,
}

#[derive(Default)]
struct SessionTable {
    entries: Vec<Entry>,
    /// The number of entries at which those of closed sessions are removed.
    sweep_at: usize,
}

struct Entry {
    client: Client,
    transport: TransportUnicast,
    /// When it was first seen to be closing.
    closing: Option<Instant>,
}

/// The client of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Client {
    /// The user whose password opened it, if the daemon has users.
    pub person: Option<String>,
    /// The id of the session.
    pub zid: String,
    /// The address that it connects from.
    pub address: String,
}

impl std::fmt::Display for Client {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let person = self.person.as_deref();
        let person = person.unwrap_or("a client without a name");
        write!(f, "{person} (zid {}, {})", self.zid, self.address)
    }
}

impl Sessions {
    /// The clients of the sessions that zenoh is closing, in the order in which this was first seen.
    ///
    /// zenoh closes the links of a session, then removes its declarations, then removes the session.
    pub fn closing(&self) -> Vec<Client> {
        let mut known = self.known.lock();
        let mut closing = Vec::new();
        for entry in &mut known.entries {
            // An error means that zenoh has removed the session.
            let links = entry.transport.get_links();
            if links.is_ok_and(|links| links.is_empty()) {
                let since = *entry.closing.get_or_insert_with(Instant::now);
                closing.push((since, entry.client.clone()));
            }
        }
        closing.sort_by_key(|(since, _)| *since);
        closing.into_iter().map(|(_, client)| client).collect()
    }
}

/// Adds each session that is opened.
pub struct Handler(pub Arc<Sessions>);

impl TransportEventHandler for Handler {
    fn new_unicast(
        &self,
        peer: TransportPeer,
        transport: TransportUnicast,
    ) -> zenoh::Result<Arc<dyn TransportPeerEventHandler>> {
        let person = transport.get_auth_ids()?.username().cloned();
        let address = peer.links.first().map(|link| link.dst.to_string());
        let client = Client {
            person,
            zid: peer.zid.to_string(),
            address: address.unwrap_or_default(),
        };
        let mut known = self.0.known.lock();
        if known.entries.len() >= known.sweep_at {
            known
                .entries
                .retain(|entry| entry.transport.get_zid().is_ok());
            known.sweep_at = MIN_SWEEP_ENTRIES.max(2 * known.entries.len());
        }
        known.entries.push(Entry {
            client,
            transport,
            closing: None,
        });
        Ok(Arc::new(DummyTransportPeerEventHandler))
    }

    fn new_multicast(
        &self,
        _: TransportMulticast,
    ) -> zenoh::Result<Arc<dyn TransportMulticastEventHandler>> {
        Ok(Arc::new(DummyTransportMulticastEventHandler))
    }
}
