//! Who is there: liveliness tokens, and what silence means.

use std::time::{Duration, Instant};

use jostle_proto::role::refused;
use jostle_proto::{Claim, NodeReply, WhoAmI, claim, keys};
use zenoh::handlers::RingChannel;

use crate::bus::{Bus, Samples, Whom};
use crate::failure::Failure;

/// How long zenoh may take to say who is there.
const LOOKING: Duration = Duration::from_secs(2);

/// A daemon that starts listens before it says that it is there: how long that may take, and how
/// often is looked meanwhile.
const STARTING: Duration = Duration::from_secs(1);
const LOOKING_AGAIN: Duration = Duration::from_millis(50);

/// How long two daemons that were just connected may both claim to serve a name. They settle it
/// within 0.4 s; this leaves the rest for a busy machine.
const YIELDING: Duration = Duration::from_secs(1);

impl Bus {
    /// The nodes that say they host a swarm.
    ///
    /// # Errors
    ///
    /// [`Failure::Unreadable`] when zenoh does not take the key.
    pub async fn hosts_of(&self, swarm: &str) -> Result<Vec<String>, Failure> {
        self.tokens(&keys::alive(&self.prefix, swarm, "*")).await
    }

    /// The nodes that are there.
    ///
    /// # Errors
    ///
    /// [`Failure::Unreadable`] when zenoh does not take the key.
    pub async fn nodes(&self) -> Result<Vec<String>, Failure> {
        self.tokens(&keys::node_alive(&self.prefix, "*")).await
    }

    /// The swarms that are there, on whatever node.
    ///
    /// # Errors
    ///
    /// [`Failure::Unreadable`] when zenoh does not take the key.
    pub async fn swarms(&self) -> Result<Vec<String>, Failure> {
        let prefix = format!("{}/", self.prefix);
        let mut swarms: Vec<String> = self
            .keys_of_tokens(&keys::alive(&self.prefix, "*", "*"))
            .await?
            .iter()
            .filter_map(|key| key.strip_prefix(&prefix)?.split('/').next())
            .map(str::to_owned)
            .collect();
        swarms.sort();
        swarms.dedup();
        Ok(swarms)
    }

    /// The node to ask: the one named, or the only one.
    ///
    /// # Errors
    ///
    /// That there is none, or several.
    pub async fn node(&self) -> Result<String, Failure> {
        if let Some(node) = &self.node {
            return Ok(node.clone());
        }
        let mut there = self.nodes_soon().await?;
        match there.len() {
            0 => Err(self.nobody().await),
            1 => Ok(there.remove(0)),
            _ => Err(Failure::ManyNodes { there }),
        }
    }

    /// The nodes to look at: the one named, or all.
    ///
    /// # Errors
    ///
    /// That there is none.
    pub async fn nodes_to_ask(&self) -> Result<Vec<String>, Failure> {
        if let Some(node) = &self.node {
            return Ok(vec![node.clone()]);
        }
        let there = self.nodes_soon().await?;
        if there.is_empty() {
            return Err(self.nobody().await);
        }
        Ok(there)
    }

    /// The nodes that are there, or are in a moment.
    async fn nodes_soon(&self) -> Result<Vec<String>, Failure> {
        let began = Instant::now();
        loop {
            let there = self.nodes().await?;
            if !there.is_empty() || began.elapsed() > STARTING {
                return Ok(there);
            }
            tokio::time::sleep(LOOKING_AGAIN).await;
        }
    }

    /// The nodes in the keys of liveliness tokens, ordered.
    async fn tokens(&self, key: &str) -> Result<Vec<String>, Failure> {
        let keys = self.keys_of_tokens(key).await?;
        let mut nodes: Vec<String> = keys
            .iter()
            .filter_map(|key| node_of(&self.prefix, key))
            .collect();
        nodes.sort();
        nodes.dedup();
        Ok(nodes)
    }

    /// Fails if several daemons serve the name for longer than [`YIELDING`] or the client's own
    /// limit, since each of them would execute a command. Checks once per connection: while the daemons can reach each other, they
    /// reject it themselves.
    pub(super) async fn check_contested(&self, whom: Whom<'_>) -> Result<(), Failure> {
        let looked = (whom.to_string(), self.lost());
        if self.looked.lock().is_ok_and(|all| all.contains(&looked)) {
            return Ok(());
        }
        let patience = YIELDING.min(Duration::from_secs_f64(self.timeout_secs));
        let deadline = Instant::now() + patience;
        while let Some(servers) = claim::servers(&self.claims(whom).await?) {
            if Instant::now() < deadline {
                tokio::time::sleep(LOOKING_AGAIN).await;
                continue;
            }
            let swarm = match whom {
                Whom::Swarm(swarm) => Some(swarm),
                Whom::Node(_) => None,
            };
            return Err(Failure::refused(claim::refused(swarm, &servers)));
        }
        if let Ok(mut all) = self.looked.lock() {
            all.insert(looked);
        }
        Ok(())
    }

    /// The claims of a name.
    async fn claims(&self, whom: Whom<'_>) -> Result<Vec<Claim>, Failure> {
        let key = match whom {
            Whom::Swarm(swarm) => keys::claim(&self.prefix, swarm, "*", "*", "*"),
            Whom::Node(node) => keys::node_claim(&self.prefix, node, "*", "*"),
        };
        let keys = self.keys_of_tokens(&key).await?;
        let claims = keys.iter();
        Ok(claims
            .filter_map(|key| Claim::read(&self.prefix, key))
            .collect())
    }

    /// The keys of the liveliness tokens that stand.
    async fn keys_of_tokens(&self, key: &str) -> Result<Vec<String>, Failure> {
        let replies = self
            .session
            .liveliness()
            .get(key)
            .timeout(LOOKING)
            .await
            .map_err(Failure::unreadable)?;
        let mut keys = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            if let Ok(token) = reply.result() {
                keys.push(token.key_expr().to_string());
            }
        }
        Ok(keys)
    }

    /// Subscribes to liveliness tokens, those that stand included; the latest win.
    ///
    /// # Errors
    ///
    /// [`Failure::Unreadable`] when zenoh does not take the key.
    pub async fn subscribe_tokens(&self, key: &str, backlog: usize) -> Result<Samples, Failure> {
        self.session
            .liveliness()
            .declare_subscriber(key)
            .history(true)
            .with(RingChannel::new(backlog))
            .await
            .map_err(Failure::unreadable)
    }

    /// A query that nobody takes ends at once without a word; the tokens tell why, and the daemon
    /// whether what was asked for under `key` is permitted.
    pub(super) async fn explain_silence(&self, whom: Whom<'_>, key: &str) -> Failure {
        let there = self.nodes_soon().await;
        let hosts = match whom {
            Whom::Swarm(swarm) => self.hosts_of(swarm).await,
            Whom::Node(_) => Ok(Vec::new()),
        };
        let (hosts, there) = match (hosts, there) {
            (Ok(hosts), Ok(there)) => (hosts, there),
            (Err(failure), _) | (_, Err(failure)) => return failure,
        };
        let is_there = match whom {
            Whom::Swarm(_) => !hosts.is_empty(),
            Whom::Node(node) => there.iter().any(|it| it == node),
        };
        if !is_there
            && let Ok(claims) = self.claims(whom).await
            && let Some(error) = claim::unserved(&claims)
        {
            return Failure::refused(error);
        }
        match whom {
            Whom::Swarm(_) if !hosts.is_empty() => self.explain_refusal(whom, &hosts[0], key).await,
            _ if there.is_empty() => self.nobody().await,
            Whom::Swarm(swarm) => self.no_swarm(swarm).await,
            Whom::Node(node) if there.iter().any(|name| name == node) => {
                self.explain_refusal(whom, node, key).await
            }
            Whom::Node(node) => Failure::UnknownNode {
                node: node.into(),
                there,
            },
        }
    }

    /// The error for a swarm that does not exist; names those that do.
    pub async fn no_swarm(&self, swarm: &str) -> Failure {
        Failure::NoSwarm {
            swarm: swarm.into(),
            there: self.swarms().await.unwrap_or_default(),
        }
    }

    /// What is not permitted never reaches the daemon, which says so when it is asked.
    async fn explain_refusal(&self, whom: Whom<'_>, node: &str, key: &str) -> Failure {
        let verb = key.split_once("/cmd/").map(|(_, verb)| verb);
        // `get/recording` is the only query that requires a role: the role of `record`.
        let verb = verb.or(key.contains("/get/recording?").then_some("record"));
        match (verb, self.whoami(node).await) {
            (Some(verb), Some(who)) if who.role.is_none_or(|role| !role.may(verb)) => {
                Failure::refused(refused(who.person.as_deref().zip(who.role), verb))
            }
            _ => Failure::Silent {
                whom: whom.to_string(),
            },
        }
    }

    /// Who a daemon takes this client for; nothing if it does not say.
    async fn whoami(&self, node: &str) -> Option<WhoAmI> {
        let key = keys::node_get(&self.prefix, node, "whoami");
        let mut query = self.session.get(key).timeout(LOOKING);
        if let Some(token) = &self.token {
            query = query.attachment(token);
        }
        let reply = query.await.ok()?.recv_async().await.ok()?;
        let reply = reply.into_result().ok()?;
        let reply: NodeReply<WhoAmI> = serde_json::from_slice(&reply.payload().to_bytes()).ok()?;
        Some(reply.result)
    }

    /// No node is there: is there anything at all?
    pub async fn nobody(&self) -> Failure {
        let info = self.session.info();
        let connected = info.peers_zid().await.count() + info.routers_zid().await.count() > 0;
        let claims = match connected {
            true => self.claims(Whom::Node("*")).await.unwrap_or_default(),
            false => Vec::new(),
        };
        if let Some(error) = claim::unserved(&claims) {
            Failure::refused(error)
        } else if connected {
            Failure::NoNode {
                endpoint: self.endpoint.clone(),
                prefix: self.prefix.clone(),
            }
        } else {
            Failure::NoDaemon {
                endpoint: self.endpoint.clone(),
                cause: "the connection was lost".into(),
            }
        }
    }
}

/// The node in the key of a swarm's or a node's token.
pub fn node_of(prefix: &str, key: &str) -> Option<String> {
    let rest = key.strip_prefix(prefix)?.strip_prefix('/')?;
    match rest.split('/').collect::<Vec<_>>()[..] {
        ["@node", node, "alive"] | [_, "alive", node] => Some(node.into()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_tell_their_node() {
        let node = |key: &str| node_of("a/jostle", key);
        assert_eq!(node("a/jostle/demo/alive/here").as_deref(), Some("here"));
        assert_eq!(node("a/jostle/@node/here/alive").as_deref(), Some("here"));
        assert_eq!(node("a/jostle/demo/state"), None);
        assert_eq!(node("b/jostle/demo/alive/here"), None);
    }
}
