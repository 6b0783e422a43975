//! Finds daemons and swarms by their liveliness tokens, and explains missing replies.

use std::time::{Duration, Instant};

use jostle_proto::claim::{self, Claim, Claimant, Standing};
use jostle_proto::role::rejection;
use jostle_proto::{NodeReply, WhoAmI, keys};

use crate::client::{Client, Servers, Target};
use crate::error::Error;
use crate::retry::{Delays, FIRST_DELAY};

/// The timeout of a query for tokens.
pub(crate) const QUERY_TIMEOUT: Duration = Duration::from_secs(2);

/// How long after it listens a daemon may declare its token, and the interval of the queries for it.
const START_TIMEOUT: Duration = Duration::from_secs(1);
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// How long two daemons that were just connected may both claim to serve a name. They resolve it
/// within 0.4 s; the rest is for a busy machine.
const CONTEST_TIMEOUT: Duration = Duration::from_secs(1);

/// How often the cause of a silence is looked for, since a daemon may come and go each time.
const MAX_CAUSES: u32 = 4;

impl Client {
    /// The daemons that host a swarm.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::TimedOut`] after 2 s, or [`Error::Internal`].
    pub async fn hosts_of(&self, swarm: &str) -> Result<Vec<String>, Error> {
        self.tokens(&keys::alive(&self.0.prefix, swarm, "*")).await
    }

    /// The daemons that are reachable.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::TimedOut`] after 2 s, or [`Error::Internal`].
    pub async fn nodes(&self) -> Result<Vec<String>, Error> {
        self.tokens(&keys::node_alive(&self.0.prefix, "*")).await
    }

    /// The swarms of all daemons.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::TimedOut`] after 2 s, or [`Error::Internal`].
    pub async fn swarms(&self) -> Result<Vec<String>, Error> {
        let prefix = format!("{}/", self.0.prefix);
        let mut swarms: Vec<String> = self
            .keys_of_tokens(&keys::alive(&self.0.prefix, "*", "*"))
            .await?
            .iter()
            .filter_map(|key| key.strip_prefix(&prefix)?.split('/').next())
            .map(str::to_owned)
            .collect();
        swarms.sort();
        swarms.dedup();
        Ok(swarms)
    }

    /// The daemon that receives requests to a daemon: that named in the options, or the only one.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::ManyNodes`]; [`Error::NoNode`] or [`Error::NoDaemon`] if there is none.
    pub async fn node(&self) -> Result<String, Error> {
        if let Some(node) = &self.0.node {
            return Ok(node.clone());
        }
        let mut there = self.nodes_in_time().await?;
        match there.len() {
            0 => Err(self.no_node().await),
            1 => Ok(there.remove(0)),
            _ => Err(Error::ManyNodes { there }),
        }
    }

    /// The daemon named in the options, or all.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::NoNode`] or [`Error::NoDaemon`] if there is none.
    pub async fn nodes_to_query(&self) -> Result<Vec<String>, Error> {
        if let Some(node) = &self.0.node {
            return Ok(vec![node.clone()]);
        }
        let there = self.nodes_in_time().await?;
        if there.is_empty() {
            return Err(self.no_node().await);
        }
        Ok(there)
    }

    /// The daemons that are reachable. If none is connected, or it does not reply, waits for it at most
    /// for the timeout of the client.
    async fn nodes_in_time(&self) -> Result<Vec<String>, Error> {
        let deadline = Instant::now() + self.0.timeout;
        loop {
            self.await_connection(deadline).await;
            let lost_before = self.connections_lost();
            let there = self.nodes_soon(self.0.timeout).await;
            let may_change = match &there {
                // A connection may be restored before its loss is looked at.
                Ok(there) => {
                    let is_lost = self.connections_lost() != lost_before;
                    there.is_empty() && (is_lost || !self.is_connected().await)
                }
                Err(error) => matches!(error, Error::TimedOut { .. }),
            };
            if !may_change || self.0.session.is_closed() || Instant::now() >= deadline {
                return there;
            }
        }
    }

    /// The daemons that are reachable; waits for the token of one that starts, and at most
    /// `recovery_timeout` if one recovers its swarms.
    async fn nodes_soon(&self, recovery_timeout: Duration) -> Result<Vec<String>, Error> {
        let start = Instant::now();
        loop {
            let there = self.nodes().await?;
            if !there.is_empty() || !self.is_connected().await {
                return Ok(there);
            }
            let timeout = match self.recovery().await {
                Some(_) => recovery_timeout,
                None => START_TIMEOUT,
            };
            if start.elapsed() >= timeout {
                return Ok(there);
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    }

    /// Waits until the daemons have recovered their swarms.
    ///
    /// # Errors
    ///
    /// [`Error::Rejected`] with `busy` if one has not by the deadline.
    pub(crate) async fn await_recovery(&self, deadline: Instant) -> Result<(), Error> {
        // A daemon declares its token when it has recovered them.
        let there = self.nodes().await.unwrap_or_default();
        let is_there = match &self.0.node {
            Some(node) => there.contains(node),
            None => !there.is_empty(),
        };
        if is_there {
            return Ok(());
        }
        let mut delays = Delays::default();
        while let Some(error) = self.recovery().await {
            let delay = delays.next();
            if Instant::now() + delay >= deadline {
                return Err(error);
            }
            tokio::time::sleep(delay).await;
        }
        Ok(())
    }

    /// The reply of a daemon that recovers its swarms; of the one that was named in the options, or of any.
    /// Such a daemon has no token yet.
    async fn recovery(&self) -> Option<Error> {
        let node = self.0.node.as_deref().unwrap_or("*");
        let key = keys::node_get(&self.0.prefix, node, "hello");
        let mut query = self.0.session.get(key).timeout(QUERY_TIMEOUT);
        if let Some(token) = self.token() {
            query = query.attachment(token);
        }
        let replies = query.await.ok()?;
        while let Ok(reply) = replies.recv_async().await {
            if let Err(error) = reply.into_result()
                && let Ok(error) = serde_json::from_slice(&error.payload().to_bytes())
                && let error = Error::rejected(error)
                && error.is_recovering()
            {
                return Some(error);
            }
        }
        None
    }

    /// The daemons in the keys of liveliness tokens, ordered.
    pub(crate) async fn tokens(&self, key: &str) -> Result<Vec<String>, Error> {
        let keys = self.keys_of_tokens(key).await?;
        let mut nodes: Vec<String> = keys
            .iter()
            .filter_map(|key| node_of(&self.0.prefix, key))
            .collect();
        nodes.sort();
        nodes.dedup();
        Ok(nodes)
    }

    /// Fails if several daemons serve the name for longer than [`CONTEST_TIMEOUT`] or the timeout of
    /// the client, since each of them would execute a command. Checks once per connection: while the
    /// daemons can reach each other, they reject commands themselves.
    /// Returns those that serve it.
    pub(crate) async fn check_contested(&self, target: Target<'_>) -> Result<Servers, Error> {
        let (name, lost) = (target.to_string(), self.connections_lost());
        if let Some((at, servers)) = self.checked(&name)
            && at == lost
        {
            return Ok(servers);
        }
        let timeout = CONTEST_TIMEOUT.min(self.0.timeout);
        let deadline = Instant::now() + timeout;
        let mut claims = self.claims(target).await?;
        while let Some(servers) = claim::servers(&claims) {
            if Instant::now() < deadline {
                tokio::time::sleep(POLL_INTERVAL).await;
                claims = self.claims(target).await?;
                continue;
            }
            let swarm = match target {
                Target::Swarm(swarm) => Some(swarm),
                Target::Node(_) => None,
            };
            return Err(Error::rejected(claim::rejection(swarm, &servers)));
        }
        let servers: Servers = serving(claims).into();
        if let Ok(mut all) = self.0.uncontested.lock() {
            all.insert(name, (lost, servers.clone()));
        }
        Ok(servers)
    }

    /// The daemons that served a name when its claims were checked, and the number of connections lost
    /// before.
    fn checked(&self, name: &str) -> Option<(u64, Servers)> {
        self.0.uncontested.lock().ok()?.get(name).cloned()
    }

    /// Whether the daemons that served a target are not reachable, although others may be: the error of
    /// a request is then due to an interruption.
    pub(crate) async fn is_gone(&self, target: Target<'_>, error: &Error) -> bool {
        if !matches!(
            error,
            Error::NoNode { .. } | Error::UnknownNode { .. } | Error::NoSwarm { .. }
        ) {
            return false;
        }
        match self.checked(&target.to_string()) {
            Some((_, servers)) if !servers.is_empty() => {
                let there = self.nodes().await;
                there.is_ok_and(|there| !servers.iter().any(|it| there.contains(&it.node)))
            }
            _ => false,
        }
    }

    /// The daemons that serve a name.
    pub(crate) async fn serving(&self, target: Target<'_>) -> Result<Vec<Claimant>, Error> {
        Ok(serving(self.claims(target).await?))
    }

    /// The claims of a name.
    async fn claims(&self, target: Target<'_>) -> Result<Vec<Claim>, Error> {
        let key = match target {
            Target::Swarm(swarm) => keys::claim(&self.0.prefix, swarm, "*", "*", "*"),
            Target::Node(node) => keys::node_claim(&self.0.prefix, node, "*", "*"),
        };
        let keys = self.keys_of_tokens(&key).await?;
        let claims = keys.iter();
        Ok(claims
            .filter_map(|key| Claim::read(&self.0.prefix, key))
            .collect())
    }

    /// The keys of the declared liveliness tokens.
    async fn keys_of_tokens(&self, key: &str) -> Result<Vec<String>, Error> {
        let replies = self
            .0
            .session
            .liveliness()
            .get(key)
            .timeout(QUERY_TIMEOUT)
            .await
            .map_err(Error::internal)?;
        let mut keys = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            // The only error is the timeout, after which tokens may be missing.
            let token = reply.result().map_err(|_| Error::TimedOut {
                target: "the daemon".into(),
                secs: QUERY_TIMEOUT.as_secs_f64(),
            })?;
            keys.push(token.key_expr().to_string());
        }
        Ok(keys)
    }

    /// The error for a query without a reply, whose cause zenoh does not report: derived from the
    /// tokens, and from the daemon's reply to `whoami`.
    pub(crate) async fn explain_silence(&self, target: Target<'_>, key: &str) -> Error {
        let mut error = self.cause_of_silence(target, key).await;
        for _ in 1..MAX_CAUSES {
            // A daemon may recover, or a connection be made, after the tokens were looked for.
            let is_there = matches!(error, Error::NoNode { .. })
                && self.nodes().await.is_ok_and(|it| !it.is_empty());
            if !is_there {
                break;
            }
            error = self.cause_of_silence(target, key).await;
        }
        error
    }

    async fn cause_of_silence(&self, target: Target<'_>, key: &str) -> Error {
        let (hosts, there) = match self.hosts_and_nodes(target).await {
            Ok(found) => found,
            Err(error) => return error,
        };
        let is_there = match target {
            Target::Swarm(_) => !hosts.is_empty(),
            Target::Node(node) => there.iter().any(|it| it == node),
        };
        if !is_there
            && let Ok(claims) = self.claims(target).await
            && let Some(error) = claim::unserved(&claims)
        {
            return Error::rejected(error);
        }
        match target {
            _ if there.is_empty() => self.no_node().await,
            Target::Swarm(_) if !hosts.is_empty() => {
                self.explain_refusal(target, &hosts[0], key).await
            }
            Target::Swarm(swarm) => match self.no_swarm(swarm).await {
                // Its token came last.
                Error::NoSwarm { there, .. } if there.iter().any(|it| it == swarm) => {
                    Error::Silent {
                        target: target.to_string(),
                    }
                }
                error => error,
            },
            Target::Node(node) if there.iter().any(|name| name == node) => {
                self.explain_refusal(target, node, key).await
            }
            Target::Node(node) => Error::UnknownNode {
                node: node.into(),
                there,
            },
        }
    }

    /// The daemons that host the swarm of a target, and those that are reachable.
    async fn hosts_and_nodes(
        &self,
        target: Target<'_>,
    ) -> Result<(Vec<String>, Vec<String>), Error> {
        let mut before = self.nodes_soon(Duration::ZERO).await?;
        loop {
            let hosts = match target {
                Target::Swarm(swarm) => self.hosts_of(swarm).await?,
                Target::Node(_) => Vec::new(),
            };
            let there = self.nodes().await?;
            // A daemon that came between the two queries, at the end of its recovery or with a restored
            // connection, has no swarms in the first.
            if !before.is_empty() || there.is_empty() {
                return Ok((hosts, there));
            }
            before = there;
        }
    }

    /// The error for a missing reply if there is no time to ask again: `error`, unless the connection is
    /// lost. zenoh ends the queries of a connection that breaks before it reports the loss.
    pub(crate) async fn explain_unsettled(&self, error: Error) -> Error {
        tokio::time::sleep(FIRST_DELAY).await;
        match self.is_connected().await {
            true => error,
            false => self.no_node().await,
        }
    }

    /// The error for a swarm that does not exist; names those that do.
    ///
    /// Cancel safety: a dropped query changes nothing.
    pub async fn no_swarm(&self, swarm: &str) -> Error {
        Error::NoSwarm {
            swarm: swarm.into(),
            there: self.swarms().await.unwrap_or_default(),
        }
    }

    /// The error for a dropped request: `permission_denied` if the client's role forbids it.
    async fn explain_refusal(&self, target: Target<'_>, node: &str, key: &str) -> Error {
        /// The queries that require a role, and the verb that requires the same one.
        const RESTRICTED: [(&str, &str); 2] =
            [("/get/recording?", "record"), ("/get/audit", "audit")];
        let restricted = || {
            let query = RESTRICTED.iter().find(|(query, _)| key.contains(query));
            query.map(|(_, verb)| *verb)
        };
        let verb = key.split_once("/cmd/").map(|(_, verb)| verb);
        let verb = verb.or_else(restricted);
        match (verb, self.whoami(node).await) {
            (Some(verb), Some(who)) if who.role.is_none_or(|role| !role.may(verb)) => {
                Error::rejected(rejection(who.person.as_deref().zip(who.role), verb))
            }
            _ => Error::Silent {
                target: target.to_string(),
            },
        }
    }

    /// The role of this client; `None` if the daemon does not reply.
    async fn whoami(&self, node: &str) -> Option<WhoAmI> {
        let key = keys::node_get(&self.0.prefix, node, "whoami");
        let mut query = self.0.session.get(key).timeout(QUERY_TIMEOUT);
        if let Some(token) = self.token() {
            query = query.attachment(token);
        }
        let reply = query.await.ok()?.recv_async().await.ok()?;
        let reply = reply.into_result().ok()?;
        let reply: NodeReply<WhoAmI> = serde_json::from_slice(&reply.payload().to_bytes()).ok()?;
        Some(reply.result)
    }

    /// The error if there is no daemon that has recovered its swarms.
    ///
    /// Cancel safety: a dropped query changes nothing.
    pub async fn no_node(&self) -> Error {
        let connected = self.is_connected().await;
        if connected && let Some(error) = self.recovery().await {
            return error;
        }
        let claims = match connected {
            true => self.claims(Target::Node("*")).await.unwrap_or_default(),
            false => Vec::new(),
        };
        if let Some(error) = claim::unserved(&claims) {
            Error::rejected(error)
        } else if connected {
            Error::NoNode {
                endpoint: self.0.endpoint.clone(),
                prefix: self.0.prefix.clone(),
            }
        } else {
            Error::NoDaemon {
                endpoint: self.0.endpoint.clone(),
                cause: "the connection was lost".into(),
            }
        }
    }
}

/// Those of the claimants who serve the name.
fn serving(claims: Vec<Claim>) -> Vec<Claimant> {
    let serving = claims
        .into_iter()
        .filter(|it| it.standing > Standing::Waiting);
    let mut claimants: Vec<Claimant> = serving.map(|it| it.claimant).collect();
    claimants.sort();
    claimants.dedup();
    claimants
}

/// The name of the daemon in the key of its own token or of a swarm's token.
pub(crate) fn node_of(prefix: &str, key: &str) -> Option<String> {
    let rest = key.strip_prefix(prefix)?.strip_prefix('/')?;
    match rest.split('/').collect::<Vec<_>>()[..] {
        ["@node", node, "alive"] | [_, "alive", node] => Some(node.into()),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
