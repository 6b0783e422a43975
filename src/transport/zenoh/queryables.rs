//! What swarms can be reached by: the queryables and the liveliness token of each.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use jostle_proto::keys;
use tracing::debug;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::Queryable;
use zenoh::{Session, Wait};

use crate::api::context::Clerk;
use crate::transport::zenoh::dispatcher::Intake;
use crate::transport::zenoh::query::{Topic, queryable};
use crate::transport::zenoh::session_pool::{Lease, SessionPool};

/// How long the keys of a deleted swarm still answer, that it is not there.
///
/// zenoh 1.10 loses a query that arrives while its queryable is being undeclared: its sender is
/// left in silence until its own timeout. When many create and delete one name that happened
/// every few dozen times; after this long nobody is likely to ask any more.
pub const LINGER: Duration = Duration::from_secs(2);

/// What all swarms can be reached by.
pub struct Doors {
    session: Session,
    pool: SessionPool,
    prefix: String,
    node: String,
    intake: SyncSender<Intake>,
    clerk: Arc<Clerk>,
    doors: BTreeMap<String, Door>,
    /// The liveliness token and the queryables of the daemon itself.
    node_keys: Option<(LivelinessToken, [Queryable<()>; 4])>,
    swept: Instant,
}

/// What one swarm can be reached by.
struct Door {
    /// Held exactly while the swarm is there.
    token: Option<LivelinessToken>,
    /// When the swarm was deleted.
    deleted: Option<Instant>,
    _queryables: [Queryable<()>; 3],
    /// Those of the verbs that were used.
    keys: Vec<KeyExpr<'static>>,
    lease: Lease,
}

impl Doors {
    /// No doors yet. Queries are handed to `intake`, or turned away where the clerk's desk is full.
    pub fn new(
        session: Session,
        pool: SessionPool,
        prefix: String,
        node: String,
        intake: SyncSender<Intake>,
        clerk: Arc<Clerk>,
    ) -> Self {
        Doors {
            session,
            pool,
            prefix,
            node,
            intake,
            clerk,
            doors: BTreeMap::new(),
            node_keys: None,
            swept: Instant::now(),
        }
    }

    /// Opens a swarm's keys. Queryables come before the token: whoever sees it finds them.
    ///
    /// # Errors
    ///
    /// When zenoh refuses a session or a key.
    pub fn open(&mut self, swarm: &str) -> zenoh::Result<()> {
        let mut door = match self.doors.remove(swarm) {
            Some(door) => door,
            None => {
                let lease = self.pool.lease()?;
                Door {
                    token: None,
                    deleted: None,
                    _queryables: self.queryables(&lease, swarm)?,
                    keys: Vec::new(),
                    lease,
                }
            }
        };
        let key = keys::alive(&self.prefix, swarm, &self.node);
        door.token = Some(door.lease.liveliness().declare_token(key).wait()?);
        door.deleted = None;
        self.doors.insert(swarm.to_owned(), door);
        Ok(())
    }

    /// Opens the daemon's own keys, the token last.
    ///
    /// # Errors
    ///
    /// When zenoh refuses a key.
    pub fn open_node(&mut self) -> zenoh::Result<()> {
        let (prefix, node) = (&self.prefix, &self.node);
        let queryable = |key: String, topic| {
            queryable(&self.session, None, &key, topic, &self.intake, &self.clerk)
        };
        let queryables = [
            queryable(keys::node_get(prefix, node, "**"), Topic::NodeGet)?,
            queryable(keys::node_cmd(prefix, node, "**"), Topic::NodeCommand)?,
            queryable(keys::cmd(prefix, "*", "delete"), Topic::Deletion)?,
            queryable(
                format!("{prefix}/@node/{node}/experiment/**"),
                Topic::Experiment,
            )?,
        ];
        let token = self.session.liveliness();
        let token = token.declare_token(keys::node_alive(prefix, node)).wait()?;
        self.node_keys = Some((token, queryables));
        Ok(())
    }

    /// Closes the daemon's own keys, the token first.
    pub fn close_node(&mut self) {
        if let Some((token, queryables)) = self.node_keys.take() {
            drop(token);
            drop(queryables);
        }
    }

    /// Closes a swarm's keys at once, the token first: another daemon serves it.
    pub fn shut(&mut self, swarm: &str) {
        if let Some(mut door) = self.doors.remove(swarm) {
            drop(door.token.take());
        }
    }

    /// Takes a swarm's token away; its keys close a while later. Tells whether it had any.
    pub fn close(&mut self, swarm: &str) -> bool {
        let Some(door) = self.doors.get_mut(swarm) else {
            return false;
        };
        door.deleted = Some(Instant::now());
        door.token.take().is_some()
    }

    /// Whether a swarm's own keys answer.
    pub fn has(&self, swarm: &str) -> bool {
        self.doors.contains_key(swarm)
    }

    /// Closes the keys of swarms that are long gone.
    pub fn sweep(&mut self) {
        if self.swept.elapsed() >= LINGER {
            self.swept = Instant::now();
            self.doors
                .retain(|_, door| door.deleted.is_none_or(|at| at.elapsed() < LINGER));
        }
    }

    /// Has zenoh know the key of a verb that was used: from then on it remembers where such commands
    /// go. Each of a key it does not know it compares with the keys of all swarms, while every other
    /// query and answer waits.
    pub fn declare_key(&mut self, swarm: &str, verb: &str) {
        let Some(door) = self.doors.get_mut(swarm) else {
            return;
        };
        let key = keys::cmd(&self.prefix, swarm, verb);
        match door.lease.declare_keyexpr(key).wait() {
            Ok(key) => door.keys.push(key),
            Err(error) => debug!(swarm, verb, %error, "commands are found as before"),
        }
    }

    fn queryables(&self, lease: &Lease, swarm: &str) -> zenoh::Result<[Queryable<()>; 3]> {
        let name: Arc<str> = swarm.into();
        let queryable = |key: String, topic| {
            let guard = Some(lease.guard());
            queryable(lease, guard, &key, topic, &self.intake, &self.clerk)
        };
        Ok([
            queryable(keys::state(&self.prefix, swarm), Topic::State(name.clone()))?,
            queryable(
                keys::get(&self.prefix, swarm, "**"),
                Topic::Get(name.clone()),
            )?,
            queryable(keys::cmd(&self.prefix, swarm, "**"), Topic::Command(name))?,
        ])
    }
}
