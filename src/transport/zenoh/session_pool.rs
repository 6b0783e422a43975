//! A pool of zenoh sessions that share one runtime, so that no session runs out of numbers for keys.
//!
//! A session of zenoh 1.10 numbers the keys that it declares with a 16-bit counter and never reuses a
//! number. After the counter has wrapped, a new key replaces another one that still has its number, and
//! queries and samples of both are lost or delivered under the wrong key. Publishers, subscribers and
//! queryables declare their keys, so that one session lasts for some 9,000 swarms. Therefore the keys of
//! a swarm are declared in a session of this pool, which opens another session before the counter can
//! wrap. All of them share the listeners and connections of one runtime.

use std::ops::Deref;
use std::sync::Arc;

use jostle_proto::keys::SWARM_VERBS;
use parking_lot::Mutex;
use tracing::debug;
use zenoh::internal::runtime::DynamicRuntime;
use zenoh::{Session, Wait};

/// The most leases of one session, which has 16 bits for the numbers of its keys. zenoh retains a few
/// hundred bytes of each session until its runtime is closed, so the sessions should be few.
const MAX_LEASES: usize = (u16::MAX as usize - 1) / MAX_KEYS;

/// The most keys that may be declared with one lease: those of a swarm's three queryables, and one for
/// each verb. The publishers of a swarm have four keys, a subscription to it three.
const MAX_KEYS: usize = 3 + SWARM_VERBS.len();

/// The sessions. Clones share them.
#[derive(Clone)]
pub struct SessionPool {
    runtime: DynamicRuntime,
    sessions: Arc<Mutex<Sessions>>,
}

#[derive(Default)]
struct Sessions {
    /// New leases are of the last one; the others stay open for their leases.
    open: Vec<Lease>,
    /// The number of leases of the last one so far.
    leases: usize,
    is_closed: bool,
}

/// A session of the pool, for at most `MAX_KEYS` different keys. Hold it as long as the declarations:
/// the pool may close a session without a lease.
#[derive(Clone)]
pub struct Lease {
    session: Session,
    users: Arc<()>,
}

/// Keeps the session of a lease open, as the lease does. Unlike a lease, it may be held by a callback of
/// the session.
#[derive(Clone)]
pub struct LeaseGuard(#[expect(dead_code, reason = "held for its reference count")] Arc<()>);

impl Lease {
    /// A guard of this lease: until it is dropped, the session can reply to queries that it received.
    pub fn guard(&self) -> LeaseGuard {
        LeaseGuard(self.users.clone())
    }
}

impl Deref for Lease {
    type Target = Session;

    fn deref(&self) -> &Session {
        &self.session
    }
}

impl SessionPool {
    /// An empty pool for sessions of `runtime`.
    pub fn new(runtime: DynamicRuntime) -> Self {
        SessionPool {
            runtime,
            sessions: Arc::default(),
        }
    }

    /// Leases a session.
    pub fn lease(&self) -> zenoh::Result<Lease> {
        let mut sessions = self.sessions.lock();
        if sessions.is_closed {
            return Err("the daemon is stopping".into());
        }
        if let Some(last) = sessions.open.last()
            && sessions.leases < MAX_LEASES
        {
            let lease = last.clone();
            sessions.leases += 1;
            return Ok(lease);
        }
        let lease = Lease {
            session: zenoh::session::init(self.runtime.clone()).wait()?,
            users: Arc::default(),
        };
        let unused = sessions
            .open
            .extract_if(.., |it| Arc::strong_count(&it.users) == 1);
        let unused: Vec<_> = unused.collect();
        sessions.open.push(lease.clone());
        sessions.leases = 1;
        debug!(
            open = sessions.open.len(),
            closing = unused.len(),
            "new zenoh session"
        );
        drop(sessions);
        close(unused);
        Ok(lease)
    }

    /// Closes all sessions and their declarations, and grants no more leases.
    pub fn close(&self) {
        let mut sessions = self.sessions.lock();
        sessions.is_closed = true;
        let open = std::mem::take(&mut sessions.open);
        drop(sessions);
        close(open);
    }
}

fn close(sessions: Vec<Lease>) {
    for session in sessions {
        if let Err(error) = session.close().wait() {
            debug!(%error, "failed to close a session of the pool");
        }
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use zenoh::Config;
    use zenoh::internal::runtime::RuntimeBuilder;

    use super::*;

    async fn pool() -> SessionPool {
        let mut config = Config::default();
        for (key, value) in [
            ("listen/endpoints", "[]"),
            ("scouting/multicast/enabled", "false"),
        ] {
            config.insert_json5(key, value).unwrap();
        }
        let runtime = RuntimeBuilder::new(config).build().await.unwrap();
        SessionPool::new(runtime.into())
    }

    fn open(pool: &SessionPool) -> usize {
        pool.sessions.lock().open.len()
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn sessions_are_replaced_kept_while_leased_and_closed_after() {
        let pool = pool().await;
        let lease_all = || (0..MAX_LEASES).for_each(|_| drop(pool.lease().unwrap()));
        let first = pool.lease().unwrap();
        for _ in 1..MAX_LEASES {
            assert!(pool.lease().unwrap().session == first.session);
        }
        assert_eq!(open(&pool), 1);
        let second = pool.lease().unwrap();
        assert!(second.session != first.session);
        assert_eq!(open(&pool), 2);
        lease_all();
        assert_eq!(open(&pool), 3, "two of them have a lease");
        let (closed, guard) = (second.session.clone(), second.guard());
        drop(second);
        lease_all();
        assert!(!closed.is_closed(), "a guard keeps it open");
        drop(guard);
        lease_all();
        assert_eq!(open(&pool), 2, "the first one, and the one that is leased");
        assert!(closed.is_closed() && !first.is_closed());
        pool.close();
        assert!(first.is_closed());
        assert!(pool.lease().is_err());
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn queryables_answer_after_more_keys_than_a_session_has_numbers() {
        const NUMBERS: usize = u16::MAX as usize + 1;
        // The first ones have the numbers that a counter gives again after it has wrapped.
        const KEPT: usize = 100;
        const NEW: usize = 1_000;
        let pool = pool().await;
        let queryable = |key: String| {
            let lease = pool.lease().unwrap();
            let reply = {
                let key = key.clone();
                move |query: zenoh::query::Query| query.reply(&key, key.as_str()).wait().unwrap()
            };
            let declared = lease.declare_queryable(key).callback(reply).wait();
            (declared.unwrap(), lease)
        };
        // Another session: a query to a session's own queryable takes another way.
        let asking = zenoh::session::init(pool.runtime.clone()).wait().unwrap();
        let ask = async |key: &str| {
            let replies = asking.get(key).await.unwrap();
            let reply = replies.recv_async().await.expect(key);
            let reply = reply.into_result().unwrap();
            assert_eq!(reply.payload().try_to_string().unwrap(), key);
            assert!(replies.recv_async().await.is_err(), "{key}: two replies");
        };
        let kept = |k: usize| format!("swarms/kept-{k}/state");
        let _kept: Vec<_> = (0..KEPT).map(|k| queryable(kept(k))).collect();
        for lease in 0..(NUMBERS - NEW / 2 - KEPT) / MAX_KEYS {
            let session = pool.lease().unwrap();
            for key in 0..MAX_KEYS {
                let key = format!("swarms/{lease}/{key}");
                session.declare_keyexpr(key).wait().unwrap();
            }
        }
        for k in 0..NEW {
            let key = format!("swarms/new-{k}/state");
            let _new = queryable(key.clone());
            ask(&key).await;
        }
        for k in 0..KEPT {
            ask(&kept(k)).await;
        }
        pool.close();
        asking.close().await.unwrap();
    }
}
