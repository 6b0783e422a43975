//! What the threads that receive queries share with the dispatcher, and how swarms notify both.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::SyncSender;

use jostle_proto::Claimant;
use zenoh::{Session, Wait};

use crate::api::admission::Admission;
use crate::api::context::{Context, Peers};
use crate::api::incoming::{Incoming, Target};
use crate::swarm::outcome::DeferredReply;
use crate::swarm::runner::SwarmObserver;
use crate::transport::zenoh::claims::{Claims, Gate, Name};
use crate::transport::zenoh::messages::DispatchMessage;
use crate::transport::zenoh::publisher::Publisher;

/// The longest request that the receiving thread handles, in bytes.
const MAX_INLINE_BYTES: usize = 16 * 1024;

/// Notifies the dispatcher and the publisher of changes of swarms.
pub struct LifecycleNotifier {
    messages: SyncSender<DispatchMessage>,
    publisher: Arc<Publisher>,
}

impl LifecycleNotifier {
    /// A notifier of this dispatcher and this publisher.
    pub fn new(messages: SyncSender<DispatchMessage>, publisher: Arc<Publisher>) -> Self {
        LifecycleNotifier {
            messages,
            publisher,
        }
    }
}

impl SwarmObserver for LifecycleNotifier {
    fn output_ready(&self, name: &str) {
        self.publisher.notify(name);
    }

    fn is_watched(&self, name: &str, is_moving: bool) -> bool {
        self.publisher.has_subscribers(name, is_moving)
    }

    fn started(&self, name: &str, reply: DeferredReply) {
        // An error means that the daemon is stopping.
        let message = DispatchMessage::Begun(name.to_owned(), reply);
        let _ = self.messages.send(message);
    }

    fn ended(&self, name: &str, reply: DeferredReply) {
        let message = DispatchMessage::Ended(name.to_owned(), reply);
        let _ = self.messages.send(message);
    }
}

/// The connections to clients and to other daemons.
pub struct Connections {
    /// The daemon's session.
    pub session: Session,
    /// The claims to names of this daemon and of others.
    pub claims: Arc<Claims>,
}

impl Peers for Connections {
    fn clients(&self) -> usize {
        self.session.info().transports().wait().count()
    }

    fn contests(&self) -> Vec<(Option<String>, [Claimant; 2])> {
        let contests = self.claims.contests().into_iter();
        contests.map(|it| (it.swarm, it.claimants)).collect()
    }
}

/// What the threads that receive queries share with the dispatcher.
pub struct Gateway {
    /// Handles requests.
    pub context: Arc<Context>,
    /// The claims, which decide what this daemon may serve.
    pub claims: Arc<Claims>,
    /// Limits the requests without a reply.
    pub admission: Admission,
    /// The requests that are queued for the dispatcher, held, or being dispatched.
    pub queued: AtomicUsize,
}

impl Gateway {
    /// Whether the thread that received a request handles it, which wakes one thread less. That is the
    /// case if the request is a short command whose handler does not take long, and if no other request
    /// is queued before it.
    pub fn handles_inline(&self, incoming: &Incoming, bytes: usize) -> bool {
        let Target::Command(swarm) = incoming.target() else {
            return false;
        };
        let verb = incoming.key().rsplit('/').next();
        let is_slow = verb.is_none_or(|verb| matches!(verb, "fork" | "seek" | "delete"));
        let is_first = self.queued.load(Ordering::Acquire) == 0;
        bytes <= MAX_INLINE_BYTES
            && is_first
            && !is_slow
            && self.claims.gate(&Name::Swarm(swarm.to_string()), true) == Gate::Open
    }
}
