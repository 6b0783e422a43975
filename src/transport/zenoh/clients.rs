//! The clients' sessions: under which name each was opened, and which of them zenoh is closing.
//!
//! zenoh passes the user name of a session only to its own access control and to transport event
//! handlers, so this module implements such a handler.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use zenoh_transport::multicast::TransportMulticast;
use zenoh_transport::unicast::TransportUnicast;
use zenoh_transport::{
    DummyTransportMulticastEventHandler, DummyTransportPeerEventHandler, TransportEventHandler,
    TransportMulticastEventHandler, TransportPeer, TransportPeerEventHandler,
};

/// Entries after which those of closed sessions are removed.
const MIN_SWEPT: usize = 64;

/// The sessions that are open, or being closed.
#[derive(Default)]
pub struct Sessions {
    known: Mutex<Known>,
}

#[derive(Default)]
struct Known {
    entries: Vec<Entry>,
    /// The number of entries at which those of closed sessions are removed.
    sweep_at: usize,
}

struct Entry {
    client: Client,
    transport: TransportUnicast,
    /// Since when it is seen to be closing.
    closing: Option<Instant>,
}

/// Whose session it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Client {
    /// The person whose password opened it, where people are known.
    pub person: Option<String>,
    /// What zenoh calls it.
    pub zid: String,
    /// Where it connects from.
    pub address: String,
}

impl std::fmt::Display for Client {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Client {
            person,
            zid,
            address,
        } = self;
        let person = person.as_deref().unwrap_or("a client without a name");
        write!(f, "{person} (zid {zid}, {address})")
    }
}

impl Sessions {
    /// The sessions that zenoh is closing, the one first that has been for longest, each with the
    /// moment when this was first seen.
    ///
    /// zenoh takes the links of a session away, then removes its declarations, and then forgets it.
    pub fn closing(&self) -> Vec<(Client, Instant)> {
        let mut known = self.lock();
        let mut closing = Vec::new();
        for entry in &mut known.entries {
            // An error says that zenoh has forgotten it.
            if entry
                .transport
                .get_links()
                .is_ok_and(|links| links.is_empty())
            {
                let since = *entry.closing.get_or_insert_with(Instant::now);
                closing.push((entry.client.clone(), since));
            }
        }
        closing.sort_by_key(|(_, since)| *since);
        closing
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What zenoh calls when a session is opened.
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
        let mut known = self.0.lock();
        if known.entries.len() >= known.sweep_at {
            known
                .entries
                .retain(|entry| entry.transport.get_zid().is_ok());
            known.sweep_at = MIN_SWEPT.max(2 * known.entries.len());
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
