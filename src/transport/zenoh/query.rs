//! zenoh queries as requests, and the queryables that receive them.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};

use jostle_proto::keys;
use tracing::debug;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

use crate::api::incoming::{Incoming, Peer, Received, Target};
use crate::convert::Payload;
use crate::convert::commands::CommandError;
use crate::transport::zenoh::gateway::Gateway;
use crate::transport::zenoh::messages::DispatchMessage;
use crate::transport::zenoh::session_pool::LeaseGuard;

/// A query, as the connection to the client that sent it.
struct Connection {
    query: Query,
    /// Keeps the session that received the query open until the reply is sent.
    _guard: Option<LeaseGuard>,
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

    fn matches(&self, key: &str) -> bool {
        KeyExpr::new(key).is_ok_and(|key| self.query.key_expr().intersects(&key))
    }
}

/// Declares a queryable for `target`. Its callback admits a query, or rejects it with `busy`.
///
/// # Errors
///
/// When zenoh rejects the key.
pub fn queryable(
    session: &Session,
    guard: Option<LeaseGuard>,
    key: &str,
    target: Target,
    messages: &SyncSender<DispatchMessage>,
    gateway: &Arc<Gateway>,
) -> zenoh::Result<Queryable<()>> {
    let (messages, gateway) = (messages.clone(), gateway.clone());
    let unanswered = Arc::new(AtomicUsize::new(0));
    let used = AtomicU32::new(0);
    let Payload {
        bytes, encoding, ..
    } = Payload::json(&CommandError::Busy.to_wire(None));
    let busy = ZBytes::from(bytes);
    session
        .declare_queryable(key)
        .callback(move |query| {
            if let Target::Command(swarm) = &target
                && let Some(verb) = first_use(query.key_expr(), &used)
            {
                // If the queue is full, the key stays undeclared, which only costs time.
                let _ = messages.try_send(DispatchMessage::FirstUse(swarm.clone(), verb));
            }
            let bytes = query.payload().map_or(0, ZBytes::len);
            let permit = gateway.admission.admit(bytes, &unanswered);
            let is_admitted = permit.is_some_and(|permit| {
                let received = received(&target, query.clone(), guard.clone());
                let incoming = Incoming::new(received, permit);
                if gateway.handles_inline(&incoming, bytes) {
                    gateway.context.handle(&incoming);
                    return true;
                }
                gateway.queued.fetch_add(1, Ordering::AcqRel);
                let sent = messages.try_send(DispatchMessage::Request(incoming));
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

fn received(target: &Target, query: Query, guard: Option<LeaseGuard>) -> Received {
    let bytes = |bytes: &ZBytes| bytes.to_bytes().into_owned();
    let parameters = query.parameters().iter();
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
            query,
            _guard: guard,
        }),
    }
}

/// The verb of a command, if this is its first use; `used` has a bit for each verb.
fn first_use(key: &str, used: &AtomicU32) -> Option<&'static str> {
    let (_, last) = key.rsplit_once('/')?;
    let verb = keys::SWARM_VERBS.iter().position(|verb| *verb == last)?;
    let bit = 1 << verb;
    let is_new =
        used.load(Ordering::Relaxed) & bit == 0 && used.fetch_or(bit, Ordering::Relaxed) & bit == 0;
    is_new.then_some(keys::SWARM_VERBS[verb])
}

#[cfg(test)]
mod tests {
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
