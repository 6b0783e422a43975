//! Who is there: liveliness tokens, and what silence means.

use std::time::{Duration, Instant};

use jostle_proto::role::refused;
use jostle_proto::{NodeReply, WhoAmI, keys};
use zenoh::handlers::RingChannel;

use crate::bus::{Bus, Samples, Whom};
use crate::failure::Failure;

/// How long zenoh may take to say who is there.
const LOOKING: Duration = Duration::from_secs(2);

/// A daemon that starts listens before it says that it is there: how long that may take, and how
/// often is looked meanwhile.
const STARTING: Duration = Duration::from_secs(1);
const LOOKING_AGAIN: Duration = Duration::from_millis(50);

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
        match whom {
            Whom::Swarm(_) if !hosts.is_empty() => self.explain_refusal(whom, &hosts[0], key).await,
            _ if there.is_empty() => self.nobody().await,
            Whom::Swarm(swarm) => Failure::NoSwarm {
                swarm: swarm.into(),
                there: self.swarms().await.unwrap_or_default(),
            },
            Whom::Node(node) if there.iter().any(|name| name == node) => {
                self.explain_refusal(whom, node, key).await
            }
            Whom::Node(node) => Failure::UnknownNode {
                node: node.into(),
                there,
            },
        }
    }

    /// What is not permitted never reaches the daemon, which says so when it is asked.
    async fn explain_refusal(&self, whom: Whom<'_>, node: &str, key: &str) -> Failure {
        let verb = key.split_once("/cmd/").map(|(_, verb)| verb);
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
        if connected {
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
