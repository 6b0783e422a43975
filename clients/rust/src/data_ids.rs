//! Which data the daemons have that commands are sent to: a command may be sent again to another run of a
//! daemon if that has the same data, since these have the replies to the commands that were executed.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use jostle_proto::claim::Claimant;
use jostle_proto::{Hello, NodeReply, keys};

use crate::client::{Client, Target};
use crate::discovery::QUERY_TIMEOUT;
use crate::error::Error;

/// The commands whose replies a daemon forgets when it ends: another run would execute them again.
/// `tests/outages.toml` of the repository lists them for all clients.
pub(crate) const FORGOTTEN: [&str; 5] = ["discard", "experiment", "record", "replay", "seek"];

/// More than the daemons that a client talks to while it lives.
const MAX_KNOWN: usize = 1024;

impl Client {
    /// Reads once per run of a daemon which data it has. If that fails, a command is not sent to another
    /// run. Takes no longer than `left`.
    pub(crate) async fn learn_data_ids(&self, servers: &[Claimant], left: Duration) {
        let deadline = Instant::now() + left;
        for server in servers {
            let is_known = |all: &mut HashMap<_, _>| all.contains_key(&server.instance);
            if self.with_data_ids(is_known) == Some(true) {
                continue;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if let Ok(id) = self.data_id(&server.node, left).await {
                self.with_data_ids(|all| {
                    if all.len() >= MAX_KNOWN {
                        all.clear();
                    }
                    all.insert(server.instance.clone(), id);
                });
            }
        }
    }

    /// Whether the daemon of a target knows whether it has executed the command with this key: the target is
    /// served as `before`, or was deleted, by the same run of a daemon, or by another one with the same
    /// data.
    pub(crate) async fn is_known(
        &self,
        target: Target<'_>,
        key: &str,
        before: &[Claimant],
    ) -> Result<bool, Error> {
        if before.is_empty() {
            return Ok(self.serving(Target::Node("*")).await?.is_empty());
        }
        let mut present = Vec::new();
        for server in before {
            present.extend(self.serving(Target::Node(&server.node)).await?);
        }
        if present.is_empty() {
            return Err(self.no_node().await);
        }
        let now = self.serving(target).await?;
        let is_before = |it: &Claimant| before.contains(it);
        if present.iter().any(is_before) && now.iter().all(is_before) {
            return Ok(true);
        }
        let mut others: Vec<&Claimant> = present.iter().chain(&now).collect();
        others.retain(|it| !is_before(it));
        others.sort();
        others.dedup();
        let is_forgotten = FORGOTTEN
            .iter()
            .any(|verb| key.ends_with(&format!("/cmd/{verb}")));
        let [first] = before else {
            return Ok(false);
        };
        if others.len() > 1 || is_forgotten {
            return Ok(false);
        }
        let known = self.with_data_ids(|all| all.get(&first.instance).cloned());
        match known.flatten().flatten() {
            Some(known) => Ok(self.data_id(&first.node, QUERY_TIMEOUT).await? == Some(known)),
            None => Ok(false),
        }
    }

    /// The id of the data of a daemon; `None` if it has none, or is of an earlier version.
    async fn data_id(&self, node: &str, timeout: Duration) -> Result<Option<String>, Error> {
        let key = keys::node_get(&self.0.prefix, node, "hello");
        let timeout = timeout.min(QUERY_TIMEOUT);
        let hello = self.query_once(Target::Node(node), &key, None, timeout);
        let hello: NodeReply<Hello> = hello.await?.read()?;
        Ok(hello.result.data_id)
    }

    fn with_data_ids<T>(
        &self,
        use_: impl FnOnce(&mut HashMap<String, Option<String>>) -> T,
    ) -> Option<T> {
        Some(use_(&mut *self.0.data_ids.lock().ok()?))
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn the_commands_that_a_daemon_forgets_are_those_of_the_table() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/outages.toml");
        let table: toml::Table = std::fs::read_to_string(path).unwrap().parse().unwrap();
        let listed = table["retries"]["forgotten_commands"].as_array().unwrap();
        let listed: Vec<&str> = listed.iter().filter_map(toml::Value::as_str).collect();
        assert_eq!(listed, FORGOTTEN);
    }
}
