//! The nouns of the daemon.

use std::time::{SystemTime, UNIX_EPOCH};

use jostle_proto::{
    Hello, NodeReply, NodeStatus, Phase, Role, Schemas, SwarmSummary, Swarms, WhoAmI, keys,
};

use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::auth::Rights;
use crate::convert::commands::CommandError;
use crate::convert::{self, Payload};

/// The nouns with the same reply before and after the swarms are recovered, and the metrics of the moment.
const INDEPENDENT_OF_SWARMS: [&str; 4] = ["whoami", "schema", "audit", "metrics"];

impl Context {
    /// Replies to each noun that the key expression matches.
    pub(crate) fn node_get(&self, incoming: &Incoming) {
        let mut is_known = false;
        for noun in keys::NODE_GETS {
            let key = keys::node_get(&self.prefix, &self.node, noun);
            if !incoming.peer.matches(&key) {
                continue;
            }
            is_known = true;
            // They are expensive and for operators only: a wildcard does not match them.
            if matches!(noun, "recording" | "audit") && incoming.is_wild {
                continue;
            }
            let responder = self.replies.responder(incoming, key);
            if let Some(swarms_left) = self.recovery.swarms_left()
                && !INDEPENDENT_OF_SWARMS.contains(&noun)
            {
                responder.reject(&CommandError::Recovering { swarms_left }, None);
                continue;
            }
            let payload = match noun {
                "recording" => match self.recording(incoming, &responder) {
                    Ok(()) => continue,
                    Err(error) => Err(error),
                },
                "audit" => match self.audit_page(incoming, &responder) {
                    Ok(()) => continue,
                    Err(error) => Err(error),
                },
                "recordings" => match self.recordings(incoming, &responder) {
                    Ok(()) => continue,
                    Err(error) => Err(error),
                },
                noun => incoming
                    .no_parameters()
                    .and_then(|()| self.node_noun(noun, incoming)),
            };
            match payload {
                Ok(payload) => responder.complete(move || Ok(payload)),
                Err(error) => responder.reject(&error, None),
            }
        }
        if !is_known && !incoming.is_wild {
            self.reject_noun(incoming, &keys::NODE_GETS);
        }
    }

    fn node_noun(&self, noun: &str, incoming: &Incoming) -> Result<Payload, CommandError> {
        Ok(match noun {
            "hello" => self.node_reply(self.hello()?),
            "whoami" => self.node_reply(self.whoami(incoming)),
            "status" => self.node_reply(self.node_status()),
            "experiments" => self.node_reply(self.experiments()),
            "schema" => self.node_reply(&self.schemas),
            "metrics" => {
                // The watch starts before the queryables.
                let watch = self.watch.get().ok_or(CommandError::Internal)?;
                let mut metrics = watch.metrics();
                // The health thread counts them once a second.
                metrics.sessions = self.peers.clients();
                self.node_reply(convert::metrics(&metrics))
            }
            _ => self.node_reply(self.swarms()),
        })
    }

    /// The user of the client's token, and the verbs that they may send.
    fn whoami(&self, incoming: &Incoming) -> WhoAmI {
        let (person, role) = match &*self.rights.current() {
            Rights::Open => (None, Some(Role::Operator)),
            known => known.owner(&incoming.token).map_or((None, None), |person| {
                (Some(person.name.clone()), Some(person.role))
            }),
        };
        let may = |verbs: &[&str]| {
            let verbs = verbs.iter();
            let permitted = verbs.filter(|verb| role.is_some_and(|role| role.may(verb)));
            permitted.map(|verb| (*verb).to_owned()).collect()
        };
        WhoAmI {
            person,
            role,
            verbs: may(&keys::SWARM_VERBS),
            node_verbs: may(&keys::NODE_VERBS),
        }
    }

    /// The identity and the limits of the daemon, unless too many clients are connected.
    fn hello(&self) -> Result<Hello, CommandError> {
        let limit = self.max_clients;
        if self.peers.clients() > limit {
            return Err(CommandError::TooManyClients { limit });
        }
        let max_bytes = self.max_request_bytes() as u64;
        Ok(Hello {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            wire_version: jostle_proto::WIRE_VERSION,
            unix_secs: unix_secs(),
            limits: convert::limits(self.registry.limits(), limit, max_bytes),
            http: self.http.clone(),
            data_id: self.data_id.clone(),
        })
    }

    fn swarms(&self) -> Swarms {
        let contests = self.peers.contests();
        let contested_by = |name: &str| {
            let mut contests = contests.iter();
            let contest = contests.find(|(swarm, _)| swarm.as_deref() == Some(name));
            contest.map(|(_, [_, other])| other.node.clone())
        };
        let swarms = self.registry.list().into_iter();
        let swarms = swarms.map(|(name, handle, summary)| SwarmSummary {
            contested_by: contested_by(&name),
            ..convert::summary(&name, &handle.record, &summary)
        });
        Swarms {
            swarms: swarms.collect(),
        }
    }

    fn node_status(&self) -> NodeStatus {
        let swarms: Vec<_> = self
            .registry
            .list()
            .iter()
            .map(|(name, handle, summary)| convert::summary(name, &handle.record, summary))
            .collect();
        let count = |phase| swarms.iter().filter(|swarm| swarm.phase == phase).count() as u64;
        NodeStatus {
            uptime_secs: self.started.elapsed().as_secs_f64(),
            swarms: swarms.len() as u64,
            running: count(Phase::Running),
            faulted: count(Phase::Faulted),
            individuals: swarms.iter().map(|swarm| swarm.n).sum(),
            memory_bytes: self.registry.memory_bytes(),
            experiments_memory_bytes: self.registry.experiments_memory_bytes(),
            clients: self.peers.clients() as u64,
        }
    }

    fn node_reply<T: serde::Serialize>(&self, result: T) -> Payload {
        Payload::json(&NodeReply {
            node: self.node.clone(),
            result,
        })
    }
}

/// The schemas of all messages.
pub fn schemas() -> Schemas {
    let schemas = jostle_proto::contract::schemas().into_iter();
    Schemas {
        wire_version: jostle_proto::WIRE_VERSION,
        schemas: schemas
            .map(|(name, schema)| (name.to_owned(), schema.to_value()))
            .collect(),
    }
}

/// Seconds since 1970, for comparing the clocks of machines.
fn unix_secs() -> f64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0.0, |now| now.as_secs_f64())
}
