//! What a query says: its key, its parameters, the request in it. And how queries come in.

use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};

use jostle_proto::{Request, keys};
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::key_expr::KeyExpr;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

use crate::api::commands::{CommandError, selector, shortened};
use crate::api::context::Clerk;
use crate::convert::Payload;
use crate::transport::zenoh::dispatcher::Intake;
use crate::transport::zenoh::session_pool::LeaseGuard;

/// What a query is about.
#[derive(Clone, Debug)]
pub enum Topic {
    /// A swarm's `state`.
    State(Arc<str>),
    /// A swarm's `get/**`.
    Get(Arc<str>),
    /// A swarm's `cmd/**`.
    Command(Arc<str>),
    /// The deletion of whichever swarm.
    Deletion,
    /// The daemon's `get/**`.
    NodeGet,
    /// The daemon's `cmd/**`.
    NodeCommand,
    /// The daemon's `experiment/**`.
    Experiment,
}

/// Declares a queryable whose callback only hands over.
///
/// # Errors
///
/// When zenoh refuses it.
pub fn queryable(
    session: &Session,
    guard: Option<LeaseGuard>,
    key: &str,
    topic: Topic,
    intake: &SyncSender<Intake>,
    clerk: &Arc<Clerk>,
) -> zenoh::Result<Queryable<()>> {
    let intake: SyncSender<Intake> = intake.clone();
    let clerk = clerk.clone();
    let turns = Arc::new(AtomicUsize::new(0));
    let used = AtomicU32::new(0);
    let Payload {
        bytes, encoding, ..
    } = Payload::json(&CommandError::Busy.to_wire(None));
    let busy = ZBytes::from(bytes);
    session
        .declare_queryable(key)
        .callback(move |query| {
            if let Topic::Command(swarm) = &topic
                && let Some(verb) = unused_before(query.key_expr(), &used)
            {
                // Where there is no room for it commands are found as before.
                let _ = intake.try_send(Intake::Used(swarm.clone(), verb));
            }
            let asked = clerk.desk.take_in(&query, &turns, guard.as_ref());
            let is_taken = asked.is_some_and(|asked| {
                if clerk.reads_at_the_door(&topic, &query, &asked) {
                    return true;
                }
                clerk.waiting.fetch_add(1, Ordering::AcqRel);
                let sent = intake.try_send(Intake::Query(topic.clone(), asked));
                if sent.is_err() {
                    clerk.waiting.fetch_sub(1, Ordering::AcqRel);
                }
                // A daemon that is going takes nothing, and its silence says so.
                !matches!(sent, Err(TrySendError::Full(_)))
            });
            if !is_taken {
                let refusal = query.reply_err(busy.clone());
                let _ = refusal.encoding(encoding).wait();
            }
        })
        .wait()
}

/// The verb of a command, if none came with it before; `used` has a bit for each.
fn unused_before(key: &str, used: &AtomicU32) -> Option<&'static str> {
    let (_, last) = key.rsplit_once('/')?;
    let verb = keys::SWARM_VERBS.iter().position(|verb| *verb == last)?;
    let bit = 1 << verb;
    let is_new =
        used.load(Ordering::Relaxed) & bit == 0 && used.fetch_or(bit, Ordering::Relaxed) & bit == 0;
    is_new.then_some(keys::SWARM_VERBS[verb])
}

/// The token that a query brings along; empty if it brings none.
pub fn token(query: &Query) -> Cow<'_, [u8]> {
    query
        .attachment()
        .map_or(Cow::Borrowed(&[][..]), ZBytes::to_bytes)
}

/// Reads the request in a query, of at most so many bytes.
///
/// # Errors
///
/// [`CommandError`] when it is no JSON object, or has selector parameters beside it.
pub fn request(query: &Query, most_bytes: usize) -> Result<Request, CommandError> {
    no_parameters(query)?;
    let bytes = query.payload().map_or(0, ZBytes::len);
    if bytes > most_bytes {
        return Err(CommandError::TooLong { bytes, most_bytes });
    }
    if let Some(encoding) = query.encoding() {
        let readable = [
            Encoding::APPLICATION_JSON,
            Encoding::TEXT_JSON,
            Encoding::TEXT_PLAIN,
            Encoding::ZENOH_STRING,
            Encoding::ZENOH_BYTES,
        ];
        if !readable.contains(encoding) {
            return Err(CommandError::Encoding(shortened(&encoding.to_string())));
        }
    }
    let payload = query.payload().map(|payload| payload.to_bytes());
    Ok(Request::from_json(payload.as_deref().unwrap_or_default())?)
}

/// Whether a query of states asks for JSON.
///
/// # Errors
///
/// [`CommandError`] for another format or another parameter.
pub fn format(query: &Query) -> Result<bool, CommandError> {
    match selector(query.parameters().iter(), &["format"])?.first() {
        None | Some((_, "cbor")) => Ok(false),
        Some((_, "json")) => Ok(true),
        Some(_) => Err(CommandError::Field {
            field: "format",
            problem: "is not json or cbor",
        }),
    }
}

/// Refuses parameters where none mean anything; those of zenoh's own begin with `_`.
///
/// # Errors
///
/// [`CommandError::Parameter`].
pub fn no_parameters(query: &Query) -> Result<(), CommandError> {
    selector(query.parameters().iter(), &[]).map(drop)
}

/// Whether a query's key expression takes in `key`.
pub fn names(query: &Query, key: &str) -> bool {
    KeyExpr::new(key).is_ok_and(|key| query.key_expr().intersects(&key))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_verb_is_new_once_and_only_verbs_are() {
        let used = AtomicU32::new(0);
        for verb in keys::SWARM_VERBS {
            let key = keys::cmd("jostle", "ants", verb);
            assert_eq!(unused_before(&key, &used), Some(verb));
            assert_eq!(unused_before(&key, &used), None, "{verb} is new twice");
        }
        let used = AtomicU32::new(0);
        for other in ["*", "**", "fly", "set/now"] {
            let key = keys::cmd("jostle", "ants", other);
            assert_eq!(unused_before(&key, &used), None, "{other}");
        }
        assert_eq!(used.into_inner(), 0);
    }
}
