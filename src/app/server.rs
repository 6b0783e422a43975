//! A running daemon.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;

use tracing::warn;
use zenoh::pubsub::Subscriber;
use zenoh::{Session, Wait};

use crate::api::responder::Replies;
use crate::audit::AuditLog;
use crate::experiments::ExperimentManager;
use crate::health::HealthMonitor;
use crate::recording::Recordings;
use crate::store::Store;
use crate::swarm::registry::SwarmRegistry;
use crate::transport::http::{Credentials, Gateway};
use crate::transport::zenoh::bus_watch::BusWatch;
use crate::transport::zenoh::claims::ClaimSubscribers;
use crate::transport::zenoh::messages::DispatchMessage;
use crate::transport::zenoh::publisher::Publisher;
use crate::transport::zenoh::session::OpenRuntime;
use crate::transport::zenoh::session_pool::SessionPool;
use crate::transport::zenoh::wait_tokens::WaitTokensSubscriber;

/// A running daemon.
pub struct Server {
    /// The swarms it hosts.
    pub registry: Arc<SwarmRegistry>,
    /// Its store.
    pub store: Store,
    pub(super) connection: Connection,
    pub(super) bus: Arc<BusWatch>,
    pub(super) publisher: Arc<Publisher>,
    pub(super) replies: Replies,
    pub(super) messages: SyncSender<DispatchMessage>,
    /// The zenoh endpoints it listens on, such as `tcp/127.0.0.1:7447`.
    pub endpoints: Vec<String>,
    /// Its health checks.
    pub watch: Arc<HealthMonitor>,
    pub(super) gateway: Option<Gateway>,
    pub(super) credentials: Credentials,
    pub(super) experiments: ExperimentManager,
    pub(super) recordings: Recordings,
    pub(super) audit: AuditLog,
}

/// The zenoh session with its subscribers and the runtime below it, closed and dropped in this order:
/// zenoh panics when a subscriber is undeclared after the runtime was closed.
pub(super) struct Connection {
    pub(super) session: Session,
    pub(super) pool: SessionPool,
    pub(super) _subscribers: ([Subscriber<()>; 2], ClaimSubscribers, WaitTokensSubscriber),
    pub(super) _runtime: OpenRuntime,
}

impl Server {
    /// The address of its HTTP server, if it has one.
    pub fn http(&self) -> Option<SocketAddr> {
        self.gateway.as_ref().map(Gateway::address)
    }

    /// The URL of its HTTP server, if it has one.
    pub fn url(&self) -> Option<String> {
        self.gateway.as_ref().map(Gateway::url)
    }

    /// The URL of the page with the token that permits commands, if all clients share one token. It
    /// must not be logged.
    pub fn page(&self) -> Option<String> {
        let Credentials::PageToken(token) = &self.credentials else {
            return None;
        };
        Some(format!("http://{}/#token={}", self.http()?, token.text()))
    }

    /// The id of its zenoh session.
    pub fn zid(&self) -> String {
        self.connection.session.zid().to_string()
    }

    /// The number of clients that are connected.
    pub fn sessions(&self) -> usize {
        self.connection.session.info().transports().wait().count()
    }
}

impl Drop for Connection {
    /// Closes the daemon's own session first: its liveliness token and claims are in it.
    fn drop(&mut self) {
        if let Err(error) = self.session.close().wait() {
            warn!(%error, "failed to close the session");
        }
        self.pool.close();
    }
}
