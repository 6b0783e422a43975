//! The keys of the daemon and of its swarms: queryables and liveliness tokens.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use jostle_proto::keys;
use tracing::debug;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::Queryable;
use zenoh::{Session, Wait};

use crate::api::incoming::Target;
use crate::transport::zenoh::gateway::{Gateway, queryable};
use crate::transport::zenoh::session_pool::{Lease, SessionPool};

/// How long the keys of a deleted swarm stay declared, and reply that it does not exist.
///
/// zenoh 1.10 loses a query that arrives while its queryable is being undeclared: the client then
/// waits until its own timeout. When many clients create and delete one name that happened every few
/// dozen times; after this long a query is unlikely.
pub const LINGER: Duration = Duration::from_secs(2);

/// The keys of the daemon and of its swarms.
pub struct SwarmEndpoints {
    session: Session,
    pool: SessionPool,
    prefix: String,
    node: String,
    gateway: Arc<Gateway>,
    swarms: BTreeMap<String, Endpoint>,
    /// The liveliness token and the queryables of the daemon itself, undeclared in this order.
    node_keys: Option<(Option<LivelinessToken>, [Queryable<()>; 4])>,
    swept: Instant,
}

/// The keys of one swarm, undeclared in this order: the token first.
struct Endpoint {
    /// Declared exactly while the swarm exists.
    token: Option<LivelinessToken>,
    /// When the swarm was deleted.
    deleted: Option<Instant>,
    _queryables: [Queryable<()>; 3],
    /// The declared keys of the verbs that were used.
    keys: Vec<KeyExpr<'static>>,
    lease: Lease,
}

impl SwarmEndpoints {
    /// No keys yet.
    pub fn new(
        session: Session,
        pool: SessionPool,
        prefix: String,
        node: String,
        gateway: Arc<Gateway>,
    ) -> Self {
        SwarmEndpoints {
            session,
            pool,
            prefix,
            node,
            gateway,
            swarms: BTreeMap::new(),
            node_keys: None,
            swept: Instant::now(),
        }
    }

    /// Declares the keys of a swarm: the queryables before the token, so that a client that sees the
    /// token finds them.
    pub(super) fn open(&mut self, swarm: &str) -> zenoh::Result<()> {
        let mut endpoint = self.take(swarm)?;
        let key = keys::alive(&self.prefix, swarm, &self.node);
        endpoint.token = Some(endpoint.lease.liveliness().declare_token(key).wait()?);
        endpoint.deleted = None;
        self.swarms.insert(swarm.to_owned(), endpoint);
        Ok(())
    }

    /// Declares the queryables of a swarm that is to be recovered, but no token yet.
    pub(super) fn prepare(&mut self, swarm: &str) -> zenoh::Result<()> {
        let endpoint = self.take(swarm)?;
        self.swarms.insert(swarm.to_owned(), endpoint);
        Ok(())
    }

    /// Removes the keys of a swarm from the map, or declares them.
    fn take(&mut self, swarm: &str) -> zenoh::Result<Endpoint> {
        if let Some(endpoint) = self.swarms.remove(swarm) {
            return Ok(endpoint);
        }
        let lease = self.pool.lease()?;
        Ok(Endpoint {
            token: None,
            deleted: None,
            _queryables: self.queryables(&lease, swarm)?,
            keys: Vec::new(),
            lease,
        })
    }

    /// Declares the daemon's own keys.
    pub(super) fn open_node(&mut self) -> zenoh::Result<()> {
        let (prefix, node) = (&self.prefix, &self.node);
        let queryable =
            |key: String, topic| queryable(&self.session, None, &key, topic, &self.gateway);
        let queryables = [
            queryable(keys::node_get(prefix, node, "**"), Target::NodeGet)?,
            queryable(keys::node_cmd(prefix, node, "**"), Target::NodeCommand)?,
            queryable(keys::cmd(prefix, "*", "delete"), Target::Deletion)?,
            queryable(
                format!("{prefix}/@node/{node}/experiment/**"),
                Target::Experiment,
            )?,
        ];
        self.node_keys = Some((None, queryables));
        Ok(())
    }

    /// Declares the daemon's own keys, if they are not declared yet, and then its token: a client that sees
    /// the daemon finds its swarms.
    pub(super) fn announce_node(&mut self) -> zenoh::Result<()> {
        if self.node_keys.is_none() {
            self.open_node()?;
        }
        let token = self.session.liveliness();
        let key = keys::node_alive(&self.prefix, &self.node);
        let token = token.declare_token(key).wait()?;
        if let Some((declared, _)) = &mut self.node_keys {
            *declared = Some(token);
        }
        Ok(())
    }

    /// Undeclares the daemon's own keys.
    pub fn close_node(&mut self) {
        self.node_keys = None;
    }

    /// Undeclares the keys of a swarm at once: another daemon serves it.
    pub fn close_now(&mut self, swarm: &str) {
        self.swarms.remove(swarm);
    }

    /// Undeclares the token of a swarm, and its keys after [`LINGER`]. Returns whether it had a token.
    pub fn close(&mut self, swarm: &str) -> bool {
        let Some(endpoint) = self.swarms.get_mut(swarm) else {
            return false;
        };
        endpoint.deleted = Some(Instant::now());
        endpoint.token.take().is_some()
    }

    /// Whether a key is `cmd/delete` of a swarm whose keys are declared.
    pub fn serves(&self, key: &str) -> bool {
        let swarm = key.strip_prefix(&self.prefix);
        let swarm = swarm.and_then(|key| key.strip_prefix('/')?.strip_suffix("/cmd/delete"));
        swarm.is_none_or(|swarm| self.swarms.contains_key(swarm))
    }

    /// Undeclares the keys of swarms that were deleted [`LINGER`] ago.
    pub fn sweep(&mut self) {
        if self.swept.elapsed() >= LINGER {
            self.swept = Instant::now();
            self.swarms
                .retain(|_, endpoint| endpoint.deleted.is_none_or(|at| at.elapsed() < LINGER));
        }
    }

    /// Declares the key of a verb that was used: zenoh then caches the route of such commands. It
    /// compares a key that is not declared with the keys of all swarms, and delays all other queries
    /// and replies meanwhile.
    pub fn declare_key(&mut self, swarm: &str, verb: &str) {
        let Some(endpoint) = self.swarms.get_mut(swarm) else {
            return;
        };
        let key = keys::cmd(&self.prefix, swarm, verb);
        match endpoint.lease.declare_keyexpr(key).wait() {
            Ok(key) => endpoint.keys.push(key),
            Err(error) => {
                debug!(swarm, verb, %error, "failed to declare a key; commands still arrive");
            }
        }
    }

    fn queryables(&self, lease: &Lease, swarm: &str) -> zenoh::Result<[Queryable<()>; 3]> {
        let name: Arc<str> = swarm.into();
        let queryable = |key: String, topic| {
            let guard = Some(lease.guard());
            queryable(lease, guard, &key, topic, &self.gateway)
        };
        Ok([
            queryable(
                keys::state(&self.prefix, swarm),
                Target::State(name.clone()),
            )?,
            queryable(
                keys::get(&self.prefix, swarm, "**"),
                Target::Get(name.clone()),
            )?,
            queryable(keys::cmd(&self.prefix, swarm, "**"), Target::Command(name))?,
        ])
    }
}
