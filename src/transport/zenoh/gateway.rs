//! The queryables, whose callbacks admit queries as requests, what these share with the dispatcher, and
//! how swarms notify it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};

use jostle_convert::Place;
use jostle_proto::Claimant;
use jostle_proto::verbs::SwarmVerb;
use tracing::debug;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

use crate::api::admission::{Admission, Unanswered};
use crate::api::context::{Context, Peers};
use crate::api::incoming::{Incoming, Peer, Received, Target};
use crate::convert::Payload;
use crate::convert::error::CommandError;
use crate::swarm::awaited::Holder;
use crate::swarm::handle::DeferredReply;
use crate::swarm::runner::SwarmObserver;
use crate::transport::open_requests::{OpenRequests, PARAMETER};
use crate::transport::zenoh::claims::{Claims, Gate, Name};
use crate::transport::zenoh::messages::DispatchMessage;
use crate::transport::zenoh::session_pool::LeaseGuard;
use crate::transport::zenoh::wait_tokens::WaitTokens;

/// The longest request that the receiving thread handles, in bytes.
const MAX_INLINE_BYTES: usize = 16 * 1024;

// An error means that the daemon is stopping.
impl SwarmObserver for SyncSender<DispatchMessage> {
    fn started(&self, name: &str, reply: DeferredReply) {
        let _ = self.send(DispatchMessage::Begun(name.to_owned(), reply));
    }

    fn ended(&self, name: &str, reply: DeferredReply) {
        let _ = self.send(DispatchMessage::Ended(name.to_owned(), reply));
    }
}

/// The connections to clients and to other daemons.
pub struct Connections {
    /// The daemon's session.
    pub session: Session,
    /// The claims to names of this daemon and of others.
    pub claims: Arc<Claims>,
    /// The tokens of waits.
    pub waits: WaitTokens,
}

impl Peers for Connections {
    fn clients(&self) -> usize {
        self.session.info().transports().wait().count()
    }

    fn contests(&self) -> Vec<(Option<String>, [Claimant; 2])> {
        let contests = self.claims.contests().into_iter();
        contests.map(|it| (it.swarm, it.claimants)).collect()
    }

    fn holder_of_wait(&self, swarm: &str, id: &str) -> Arc<Holder> {
        self.waits.holder(swarm, id)
    }
}

/// What the threads that receive queries share with the dispatcher.
pub struct Gateway {
    /// Handles requests.
    pub context: Arc<Context>,
    /// The claims, which decide what this daemon may serve.
    pub claims: Arc<Claims>,
    /// The queue of the dispatcher.
    pub messages: SyncSender<DispatchMessage>,
    /// Limits the requests without a reply.
    pub admission: Admission,
    /// The requests that are queued for the dispatcher, held, or being dispatched.
    pub queued: AtomicUsize,
    /// The HTTP requests that wait for a reply.
    pub open: OpenRequests,
}

impl Gateway {
    /// Whether the thread that received a request handles it, which wakes one thread less. That is the
    /// case if the request is a short command whose handler does not take long, and if no other request
    /// is queued before it.
    pub fn handles_inline(&self, incoming: &Incoming, bytes: usize) -> bool {
        let Target::Command(swarm) = &incoming.target else {
            return false;
        };
        let verb = incoming.key.rsplit('/').next().and_then(SwarmVerb::of);
        let is_first = self.queued.load(Ordering::Acquire) == 0;
        bytes <= MAX_INLINE_BYTES
            && is_first
            && verb.is_some_and(is_short)
            && self.claims.gate(&Name::Swarm(swarm.to_string()), true) == Gate::Open
    }
}

/// A query: the connection to the client that sent it.
struct Connection {
    query: Query,
    /// Keeps the session that received the query open until the reply is sent.
    _guard: Option<LeaseGuard>,
    /// The HTTP connection of the client and the name of the request, if it came over HTTP.
    http: Option<(Arc<Holder>, String)>,
}

impl Peer for Connection {
    fn reply(&self, key: &str, reply: Result<Payload, Payload>) {
        let sent = match reply {
            Ok(Payload {
                bytes, encoding, ..
            }) => self.query.reply(key, bytes).encoding(encoding).wait(),
            Err(Payload {
                bytes, encoding, ..
            }) => self.query.reply_err(bytes).encoding(encoding).wait(),
        };
        if let Err(error) = sent {
            debug!(%error, "failed to send a reply");
        }
    }

    fn is_gone(&self) -> bool {
        let http = self.http.as_ref();
        http.is_some_and(|(connection, _)| connection.gone_since().is_some())
    }

    fn connection(&self) -> Option<(Arc<Holder>, String)> {
        self.http.clone()
    }

    fn matches(&self, key: &str) -> bool {
        KeyExpr::new(key).is_ok_and(|key| self.query.key_expr().intersects(&key))
    }
}

/// Declares a queryable for `target`. Its callback admits a query, or rejects it with `busy`.
pub(super) fn queryable(
    session: &Session,
    guard: Option<LeaseGuard>,
    key: &str,
    target: Target,
    gateway: &Arc<Gateway>,
) -> zenoh::Result<Queryable<()>> {
    let gateway = gateway.clone();
    let unanswered = Unanswered::default();
    let used = AtomicU32::new(0);
    let busy = Payload::json(&CommandError::Busy.to_wire(None, &Place::default()));
    let (busy, encoding) = (ZBytes::from(busy.bytes), busy.encoding);
    session
        .declare_queryable(key)
        .callback(move |query| {
            if let Target::Command(swarm) = &target
                && let Some(verb) = first_use(query.key_expr(), &used)
            {
                // If the queue is full, the key stays undeclared, which only costs time.
                let _ = gateway
                    .messages
                    .try_send(DispatchMessage::FirstUse(swarm.clone(), verb));
            }
            let bytes = query.payload().map_or(0, ZBytes::len);
            let attachment = query.attachment();
            let token = attachment.map(ZBytes::to_bytes);
            let all_bytes =
                bytes + attachment.map_or(0, ZBytes::len) + query.parameters().as_str().len();
            let user = gateway
                .context
                .counted_as(token.as_deref().unwrap_or_default());
            let permit = gateway.admission.admit(all_bytes, &user, &unanswered);
            let is_admitted = permit.is_some_and(|permit| {
                let received = received(&target, query.clone(), guard.clone(), &gateway.open);
                let incoming = Incoming::new(received, permit);
                if gateway.handles_inline(&incoming, bytes) {
                    gateway.context.handle(&incoming);
                    return true;
                }
                gateway.queued.fetch_add(1, Ordering::AcqRel);
                let sent = gateway
                    .messages
                    .try_send(DispatchMessage::Request(incoming));
                if sent.is_err() {
                    gateway.queued.fetch_sub(1, Ordering::AcqRel);
                }
                // A daemon that is stopping does not reply.
                !matches!(sent, Err(TrySendError::Full(_)))
            });
            if !is_admitted {
                let error = query.reply_err(busy.clone());
                let _ = error.encoding(encoding).wait();
            }
        })
        .wait()
}

fn received(
    target: &Target,
    query: Query,
    guard: Option<LeaseGuard>,
    open: &OpenRequests,
) -> Received {
    let bytes = |bytes: &ZBytes| bytes.to_bytes().into_owned();
    let parameters = query.parameters().iter();
    let http = query.parameters().get(PARAMETER);
    Received {
        target: target.clone(),
        key: query.key_expr().as_str().to_owned(),
        is_wild: query.key_expr().is_wild(),
        parameters: parameters
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .collect(),
        payload: query.payload().map(bytes).unwrap_or_default(),
        encoding: query.encoding().map(ToString::to_string),
        token: query.attachment().map(bytes).unwrap_or_default(),
        peer: Box::new(Connection {
            http: http.and_then(|it| Some((open.connection(it)?, it.to_owned()))),
            query,
            _guard: guard,
        }),
    }
}

/// Whether the handler of this verb does not take long.
fn is_short(verb: SwarmVerb) -> bool {
    match verb {
        SwarmVerb::Fork | SwarmVerb::Seek | SwarmVerb::Delete => false,
        SwarmVerb::Run
        | SwarmVerb::Pause
        | SwarmVerb::Step
        | SwarmVerb::Reset
        | SwarmVerb::Set
        | SwarmVerb::Inform
        | SwarmVerb::Uninform
        | SwarmVerb::Inject
        | SwarmVerb::Remove
        | SwarmVerb::Batch
        | SwarmVerb::Join
        | SwarmVerb::Advance
        | SwarmVerb::Leave
        | SwarmVerb::Annotate
        | SwarmVerb::When
        | SwarmVerb::Protect => true,
    }
}

/// The verb of a command, if this is its first use; `used` has a bit for each verb.
fn first_use(key: &str, used: &AtomicU32) -> Option<&'static str> {
    let (_, last) = key.rsplit_once('/')?;
    let verb = SwarmVerb::of(last)?;
    let bit = 1 << verb as u32;
    let is_new =
        used.load(Ordering::Relaxed) & bit == 0 && used.fetch_or(bit, Ordering::Relaxed) & bit == 0;
    is_new.then_some(verb.name())
}

#[cfg(test)]
mod tests {
    use jostle_proto::keys;

    use super::*;

    #[test]
    fn each_verb_is_new_once_and_only_verbs_are() {
        let used = AtomicU32::new(0);
        for verb in keys::SWARM_VERBS {
            let key = keys::cmd("jostle", "ants", verb);
            assert_eq!(first_use(&key, &used), Some(verb));
            assert_eq!(first_use(&key, &used), None, "{verb} is new twice");
        }
        let used = AtomicU32::new(0);
        for other in ["*", "**", "fly", "set/now"] {
            let key = keys::cmd("jostle", "ants", other);
            assert_eq!(first_use(&key, &used), None, "{other}");
        }
        assert_eq!(used.into_inner(), 0);
    }
}
