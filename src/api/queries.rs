//! What is asked of swarms and of the daemon, and changes nothing.

use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use jostle_proto::{
    Hello, HistoryFrom, NodeReply, NodeStatus, Phase, Role, Schemas, SwarmSummary, Swarms, WhoAmI,
    keys,
};
use zenoh::Wait;
use zenoh::query::Query;

use crate::api::commands::{CommandError, shortened, wait};
use crate::api::context::Clerk;
use crate::api::error::refusal;
use crate::api::pagination;
use crate::api::responder::{Asked, Promise};
use crate::auth::Rights;
use crate::convert::{self, Payload};
use crate::store::Store;
use crate::swarm::frame::{Frame, Place};
use crate::swarm::handle::Ticket;
use crate::swarm::outcome::Outcome;
use crate::swarm::waiters::Waiter;
use crate::transport::zenoh::query::{format, names, no_parameters, token};

/// What is asked of one swarm by its own key: the first waits, the others cost much.
const OF_ONE: [&str; 3] = ["wait", "verify", "snapshot"];

impl Clerk {
    /// Answers with the state as it is.
    pub(crate) fn state(&self, swarm: &Arc<str>, asked: &Asked) {
        let key = keys::state(&self.prefix, swarm);
        let as_json = match format(&asked.query) {
            Ok(as_json) => as_json,
            Err(error) => return self.desk.promise(asked, key).refuse(&error, None),
        };
        let promise = self.desk.promise(asked, key);
        let (press, name) = (self.press.clone(), swarm.clone());
        self.look(swarm, &promise, move |_, seen| {
            let frame = press.find(&name).map_or(0, |it| it.frames());
            let state = convert::state(&name, &seen, frame);
            if as_json {
                Payload::json(&state)
            } else {
                Payload::cbor(&state)
            }
        });
    }

    /// Answers every noun that the query names; wildcards are welcome.
    pub(crate) fn get(&self, swarm: &Arc<str>, asked: &Asked) {
        let query = &asked.query;
        let is_concrete = !query.key_expr().is_wild();
        let mut is_known = false;
        for noun in keys::SWARM_GETS {
            let key = keys::get(&self.prefix, swarm, noun);
            if !names(query, &key) || (OF_ONE.contains(&noun) && !is_concrete) {
                continue;
            }
            is_known = true;
            if noun == "wait" {
                let promise = self.desk.promise(&asked.aside(), key);
                self.wait(swarm, &promise, query);
                continue;
            }
            if noun == "verify" {
                let promise = self.desk.promise(&asked.aside(), key);
                self.verify(swarm, &promise, query);
                continue;
            }
            if noun == "snapshot" {
                let promise = self.desk.promise(asked, key);
                self.snapshot(swarm, &promise, query);
                continue;
            }
            let promise = self.desk.promise(asked, key);
            let read = match noun {
                "events" | "journal" => pagination::read(query.parameters().iter()),
                _ => no_parameters(query).map(|()| (0, 0)),
            };
            let (after, limit) = match read {
                Ok(read) => read,
                Err(error) => {
                    promise.refuse(&error, None);
                    continue;
                }
            };
            let (name, handle) = (swarm.clone(), self.host.find(swarm));
            let (limits, store) = (self.host.limits(), self.store.clone());
            let verifying = self.verifications.share(swarm);
            self.look(swarm, &promise, move |place, seen| match (noun, handle) {
                ("spec", Some(handle)) => {
                    let spec = jostle_convert::spec::to_proto(&handle.recipe, seen.seed);
                    Payload::json(&convert::reply(&name, &place, spec))
                }
                ("controllers", _) => {
                    let controllers = convert::controllers(&seen);
                    Payload::json(&convert::reply(&name, &place, controllers))
                }
                ("parameters", _) => {
                    let parameters = convert::parameters(&seen, limits);
                    Payload::json(&convert::reply(&name, &place, parameters))
                }
                ("events", Some(handle)) => {
                    let events =
                        convert::events(&name, handle.history.events(after, limit), refusal);
                    Payload::json(&convert::reply(&name, &place, events))
                }
                ("journal", Some(handle)) => {
                    let journal = convert::journal(handle.history.entries(after, limit));
                    Payload::json(&convert::reply(&name, &place, journal))
                }
                _ => status(&store, verifying, &name, &place, &seen),
            });
        }
        if is_known {
            return;
        }
        if is_concrete {
            self.unknown_noun(asked, &keys::SWARM_GETS);
            return;
        }
        let key = query.key_expr().as_str();
        let noun = key.rsplit_once('/').map_or(key, |(_, noun)| noun);
        if OF_ONE.contains(&noun) {
            let error = CommandError::Field {
                field: "swarm",
                problem: "is a wildcard: wait, verify and snapshot are of one swarm, by its own key",
            };
            self.desk
                .promise(asked, key.to_owned())
                .refuse(&error, None);
        }
    }

    fn wait(&self, swarm: &Arc<str>, promise: &Promise, query: &Query) {
        let (awaited, patience) = match wait::read(query.parameters().iter()) {
            Ok(read) => read,
            Err(error) => return promise.refuse(&error, None),
        };
        let (name, store) = (swarm.clone(), self.store.clone());
        let verifications = self.verifications.clone();
        let abandoned = promise.clone();
        self.send(
            swarm,
            promise,
            (patience, CommandError::not_yet),
            |answer| {
                Ticket::Wait(Waiter {
                    awaited,
                    is_abandoned: Box::new(move || abandoned.is_kept()),
                    answer: Box::new(move |answered| {
                        answer(answered, move |place, outcome| match outcome {
                            Outcome::Seen(seen) => {
                                let verifying = verifications.share(&name);
                                status(&store, verifying, &name, &place, &seen)
                            }
                            other => convert::outcome(&name, &place, other, None),
                        });
                    }),
                })
            },
        );
    }

    pub(crate) fn node_get(&self, asked: &Asked) {
        let query = &asked.query;
        let mut is_known = false;
        for noun in keys::NODE_GETS {
            let key = keys::node_get(&self.prefix, &self.node, noun);
            if !names(query, &key) {
                continue;
            }
            is_known = true;
            if noun == "recording" {
                // Expensive, and meaningless without the name of a recording: not for wildcards.
                if !query.key_expr().is_wild() {
                    let promise = self.desk.promise(asked, key);
                    if let Err(error) = self.recording(asked, &promise) {
                        promise.refuse(&error, None);
                    }
                }
                continue;
            }
            let promise = self.desk.promise(asked, key);
            if let Err(error) = no_parameters(query) {
                promise.refuse(&error, None);
                continue;
            }
            let payload = match noun {
                "hello" => match self.hello() {
                    Ok(hello) => self.node_reply(hello),
                    Err(error) => {
                        promise.refuse(&error, None);
                        continue;
                    }
                },
                "whoami" => self.node_reply(self.who_asks(query)),
                "status" => self.node_reply(self.node_status()),
                "experiments" => self.experiments(),
                "recordings" => self.node_reply(convert::recordings(self.recordings.list())),
                "schema" => self.node_reply(&self.schemas),
                "metrics" => match self.watch.get() {
                    Some(watch) => self.node_reply(convert::metrics(&watch.figures())),
                    // It is watched before anybody can ask.
                    None => continue,
                },
                _ => self.node_reply(self.swarms()),
            };
            promise.keep(move || Ok(payload));
        }
        if !is_known && !query.key_expr().is_wild() {
            self.unknown_noun(asked, &keys::NODE_GETS);
        }
    }

    /// Who asks, by the token that came along, and what they may.
    fn who_asks(&self, query: &Query) -> WhoAmI {
        let (person, role) = match &*self.rights.current() {
            Rights::Everybody => (None, Some(Role::Operator)),
            known => known.owner(&token(query)).map_or((None, None), |person| {
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

    /// Who the daemon is, to as many as it has room for.
    fn hello(&self) -> Result<Hello, CommandError> {
        if self.clients() > self.max_clients {
            return Err(CommandError::TooManyClients {
                limit: self.max_clients,
            });
        }
        let (limits, most_bytes) = (self.host.limits(), self.most_bytes() as u64);
        Ok(Hello {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            wire_version: jostle_proto::WIRE_VERSION,
            unix_secs: unix_secs(),
            limits: convert::limits(limits, self.max_clients, most_bytes),
            http: self.http.clone(),
        })
    }

    /// How many clients are connected.
    fn clients(&self) -> usize {
        self.session.info().transports().wait().count()
    }

    fn swarms(&self) -> Swarms {
        let contests = self.claims.contests();
        let contested_by = |name: &str| {
            let mut contests = contests.iter();
            let contest = contests.find(|it| it.swarm.as_deref() == Some(name))?;
            Some(contest.claimants[1].node.clone())
        };
        let swarms = self.host.list().into_iter();
        let swarms = swarms.map(|(name, summary)| SwarmSummary {
            contested_by: contested_by(&name),
            ..convert::summary(&name, &summary)
        });
        Swarms {
            swarms: swarms.collect(),
        }
    }

    fn node_status(&self) -> NodeStatus {
        let swarms: Vec<_> = self
            .host
            .list()
            .iter()
            .map(|(name, summary)| convert::summary(name, summary))
            .collect();
        let count = |phase| swarms.iter().filter(|swarm| swarm.phase == phase).count() as u64;
        NodeStatus {
            uptime_secs: self.started.elapsed().as_secs_f64(),
            swarms: swarms.len() as u64,
            running: count(Phase::Running),
            faulted: count(Phase::Faulted),
            individuals: swarms.iter().map(|swarm| swarm.n).sum(),
            memory_bytes: self.host.memory_bytes(),
            clients: self.clients() as u64,
        }
    }

    fn node_reply<T: serde::Serialize>(&self, result: T) -> Payload {
        Payload::json(&NodeReply {
            node: self.node.clone(),
            result,
        })
    }

    fn unknown_noun(&self, asked: &Asked, known: &'static [&'static str]) {
        let key = asked.query.key_expr().as_str();
        let noun = key.split_once("/get/").map_or(key, |(_, noun)| noun);
        let error = CommandError::UnknownNoun {
            noun: shortened(noun),
            known,
        };
        let promise = self.desk.promise(asked, key.to_owned());
        promise.refuse(&error, None);
    }
}

/// A swarm's status.
fn status(
    store: &Store,
    verifying: Option<f64>,
    swarm: &str,
    place: &Place,
    seen: &Frame,
) -> Payload {
    // What cannot be read is told of in the log, and here left open.
    let oldest = store.history_from(swarm).ok().flatten();
    let history_from = oldest.map(|mark| HistoryFrom {
        epoch: mark.epoch,
        step: mark.step,
    });
    let status = jostle_proto::Status {
        verifying,
        ..convert::status(seen, history_from)
    };
    Payload::json(&convert::reply(swarm, place, status))
}

/// The schemas of every message, as `get/schema` answers them.
pub fn schemas() -> Schemas {
    let schemas = jostle_proto::contract::schemas().into_iter();
    Schemas {
        wire_version: jostle_proto::WIRE_VERSION,
        schemas: schemas
            .map(|(name, schema)| (name.to_owned(), schema.to_value()))
            .collect(),
    }
}

/// Seconds since 1970; for people to compare clocks by, never for pacing.
fn unix_secs() -> f64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0.0, |now| now.as_secs_f64())
}
