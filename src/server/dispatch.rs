//! A query in, an order or an answer out. One thread, which never waits for a swarm.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::{Duration, Instant};

use jostle_proto::verbs::CreateArgs;
use jostle_proto::{NodeReply, NodeStatus, Phase, Request, Swarms, keys};
use tracing::{info, warn};
use zenoh::query::Query;
use zenoh::{Session, Wait};

use crate::command::{self, Command, CommandError, DEFAULT_TIMEOUT, create, wait};
use crate::host::{Created, Herald, Host};
use crate::publish::Press;
use crate::server::answer::{Desk, Keeper, Promise};
use crate::server::doors::{Doors, LINGER};
use crate::server::query::{Topic, format, names, no_parameters, request};
use crate::server::session::MAX_MESSAGE_BYTES;
use crate::swarm::frame::{Frame, Place};
use crate::swarm::handle::Ticket;
use crate::swarm::order::{Answer, Answered, Outcome};
use crate::swarm::waiters::Waiter;
use crate::wire::{self, Payload};

/// Queries that may wait to be dispatched; what comes on top is refused at once.
pub const MOST_QUERIES: usize = 1024;

/// What the dispatching thread takes.
pub enum Intake {
    /// A query on one of the daemon's keys.
    Query(Topic, Query),
    /// A swarm is built.
    Begun(String, Box<dyn FnOnce() + Send>),
    /// A swarm has ended.
    Ended(String, Box<dyn FnOnce() + Send>),
    /// The daemon stops.
    Stop,
}

/// Tells the dispatching and the publishing thread of swarms.
pub struct Crier {
    intake: SyncSender<Intake>,
    press: Arc<Press>,
}

impl Crier {
    /// A crier to these two.
    pub fn new(intake: SyncSender<Intake>, press: Arc<Press>) -> Self {
        Crier { intake, press }
    }
}

impl Herald for Crier {
    fn ring(&self, name: &str) {
        self.press.ring(name);
    }

    fn is_watched(&self, name: &str) -> bool {
        self.press.is_watched(name)
    }

    fn begun(&self, name: &str, built: Box<dyn FnOnce() + Send>) {
        // Once the dispatching thread has ended the daemon is going.
        let _ = self.intake.send(Intake::Begun(name.to_owned(), built));
    }

    fn ended(&self, name: &str, ended: Box<dyn FnOnce() + Send>) {
        let _ = self.intake.send(Intake::Ended(name.to_owned(), ended));
    }
}

/// The dispatching thread's belongings.
pub struct Dispatcher {
    /// The daemon's session.
    pub session: Session,
    /// The first chunk of every key.
    pub prefix: String,
    /// The daemon's name.
    pub node: String,
    /// The swarms.
    pub host: Arc<Host>,
    /// Where answers go.
    pub desk: Desk,
    /// Where states go.
    pub press: Arc<Press>,
    /// When the daemon started.
    pub started: Instant,
    /// What swarms can be reached by.
    pub doors: Doors,
}

impl Dispatcher {
    /// Dispatches until told to stop.
    pub fn run(mut self, intake: &Receiver<Intake>) {
        loop {
            match intake.recv_timeout(LINGER) {
                Ok(Intake::Query(topic, query)) => self.query(&topic, query),
                Ok(Intake::Begun(swarm, built)) => self.begun(&swarm, built),
                Ok(Intake::Ended(swarm, ended)) => self.ended(&swarm, ended),
                Err(RecvTimeoutError::Timeout) => {}
                Ok(Intake::Stop) | Err(RecvTimeoutError::Disconnected) => return,
            }
            self.doors.sweep();
        }
    }

    fn begun(&mut self, swarm: &str, built: Box<dyn FnOnce() + Send>) {
        let Some(handle) = self.host.find(swarm) else {
            return;
        };
        let opened = self
            .press
            .open(&self.session, swarm, handle.outlet.clone())
            .and_then(|()| self.doors.open(swarm));
        match opened {
            Ok(()) => info!(swarm, "created"),
            Err(error) => warn!(swarm, %error, "failed to open the swarm's keys"),
        }
        built();
    }

    fn ended(&mut self, swarm: &str, ended: Box<dyn FnOnce() + Send>) {
        if self.doors.close(swarm) {
            info!(swarm, "deleted");
        }
        let host = self.host.clone();
        let name = swarm.to_owned();
        self.press.close(
            swarm,
            Box::new(move || {
                host.release(&name);
                ended();
            }),
        );
    }

    fn query(&self, topic: &Topic, query: Query) {
        match topic {
            Topic::State(swarm) => self.state(swarm, query),
            Topic::Get(swarm) => self.get(swarm, &query),
            Topic::Command(swarm) => self.command(swarm, &query),
            Topic::NodeGet => self.node_get(&query),
            Topic::NodeCommand => self.node_command(&query),
        }
    }

    fn state(&self, swarm: &Arc<str>, query: Query) {
        let key = keys::state(&self.prefix, swarm);
        let as_json = match format(&query) {
            Ok(as_json) => as_json,
            Err(error) => return self.desk.promise(query, key).refuse(&error, None),
        };
        let promise = self.desk.promise(query, key);
        let (press, name) = (self.press.clone(), swarm.clone());
        self.look(swarm, &promise, move |_, seen| {
            let frame = press.find(&name).map_or(0, |it| it.frames());
            let state = wire::state(&name, &seen, frame);
            if as_json {
                Payload::json(&state)
            } else {
                Payload::cbor(&state)
            }
        });
    }

    /// Answers every noun that the query names; wildcards are welcome.
    fn get(&self, swarm: &Arc<str>, query: &Query) {
        let is_concrete = !query.key_expr().is_wild();
        let mut is_known = false;
        for noun in keys::SWARM_GETS {
            let key = keys::get(&self.prefix, swarm, noun);
            if !names(query, &key) || (noun == "wait" && !is_concrete) {
                continue;
            }
            is_known = true;
            let promise = self.desk.promise(query.clone(), key);
            if noun == "wait" {
                self.wait(swarm, &promise, query);
                continue;
            }
            if let Err(error) = no_parameters(query) {
                promise.refuse(&error, None);
                continue;
            }
            let (name, handle) = (swarm.clone(), self.host.find(swarm));
            self.look(swarm, &promise, move |place, seen| match (noun, handle) {
                ("spec", Some(handle)) => {
                    let spec = wire::spec(&handle.recipe, seen.seed);
                    Payload::json(&wire::reply(&name, &place, spec))
                }
                _ => Payload::json(&wire::reply(&name, &place, wire::status(&seen))),
            });
        }
        if !is_known && is_concrete {
            self.unknown_noun(query, &keys::SWARM_GETS);
        }
    }

    fn wait(&self, swarm: &Arc<str>, promise: &Promise, query: &Query) {
        let (awaited, patience) = match wait::read(query.parameters().iter()) {
            Ok(read) => read,
            Err(error) => return promise.refuse(&error, None),
        };
        let name = swarm.clone();
        let abandoned = promise.clone();
        self.send(swarm, promise, patience, |answer| {
            Ticket::Wait(Waiter {
                awaited,
                is_abandoned: Box::new(move || abandoned.is_kept()),
                answer: Box::new(move |answered| {
                    answer(answered, move |place, outcome| {
                        wire::outcome(&name, &place, outcome, None)
                    });
                }),
            })
        });
    }

    /// Executes only what its own key names: a wildcard changes nothing.
    fn command(&self, swarm: &Arc<str>, query: &Query) {
        let promise = self
            .desk
            .promise(query.clone(), query.key_expr().as_str().to_owned());
        let key = query.key_expr().as_str();
        let verb = key.strip_prefix(&keys::cmd(&self.prefix, swarm, ""));
        let read = if query.key_expr().is_wild() {
            Err(CommandError::Wildcard)
        } else {
            let verb = verb.unwrap_or_default();
            request(query).and_then(|request| command::read(verb, &request))
        };
        let Command {
            order,
            expected,
            sender,
            timeout,
            returns_state,
        } = match read {
            Ok(command) => command,
            Err(error) => {
                let step = self.host.find(swarm).and_then(|handle| handle.step());
                return promise.refuse(&error, step);
            }
        };
        let (press, name) = (self.press.clone(), swarm.clone());
        self.send(swarm, &promise, timeout, |answer| Ticket::Command {
            order,
            expected,
            sender,
            answer: Box::new(move |answered| {
                answer(answered, move |place, outcome| {
                    let frame = returns_state.then(|| {
                        press
                            .find(&name)
                            .map_or(0, |publication| publication.frames())
                    });
                    wire::outcome(&name, &place, outcome, frame)
                });
            }),
        });
    }

    fn node_get(&self, query: &Query) {
        let mut is_known = false;
        for noun in keys::NODE_GETS {
            let key = keys::node_get(&self.prefix, &self.node, noun);
            if !names(query, &key) {
                continue;
            }
            is_known = true;
            let promise = self.desk.promise(query.clone(), key);
            if let Err(error) = no_parameters(query) {
                promise.refuse(&error, None);
                continue;
            }
            let payload = match noun {
                "hello" => self.node_reply(jostle_proto::Hello {
                    version: env!("CARGO_PKG_VERSION").to_owned(),
                    wire_version: jostle_proto::WIRE_VERSION,
                    limits: wire::limits(self.host.limits(), MAX_MESSAGE_BYTES),
                }),
                "status" => self.node_reply(self.node_status()),
                _ => self.node_reply(Swarms {
                    swarms: self
                        .host
                        .list()
                        .iter()
                        .map(|(name, summary)| wire::summary(name, summary))
                        .collect(),
                }),
            };
            promise.keep(move || Ok(payload));
        }
        if !is_known && !query.key_expr().is_wild() {
            self.unknown_noun(query, &keys::NODE_GETS);
        }
    }

    fn node_status(&self) -> NodeStatus {
        let swarms: Vec<_> = self
            .host
            .list()
            .iter()
            .map(|(name, summary)| wire::summary(name, summary))
            .collect();
        let count = |phase| swarms.iter().filter(|swarm| swarm.phase == phase).count() as u64;
        NodeStatus {
            uptime_secs: self.started.elapsed().as_secs_f64(),
            swarms: swarms.len() as u64,
            running: count(Phase::Running),
            faulted: count(Phase::Faulted),
            individuals: swarms.iter().map(|swarm| swarm.n).sum(),
            memory_bytes: self.host.memory_bytes(),
            clients: self.session.info().transports().wait().count() as u64,
        }
    }

    fn node_reply<T: serde::Serialize>(&self, result: T) -> Payload {
        Payload::json(&NodeReply {
            node: self.node.clone(),
            result,
        })
    }

    fn node_command(&self, query: &Query) {
        let promise = self
            .desk
            .promise(query.clone(), query.key_expr().as_str().to_owned());
        if query.key_expr().is_wild() {
            return promise.refuse(&CommandError::Wildcard, None);
        }
        let verb =
            query
                .key_expr()
                .as_str()
                .strip_prefix(&keys::node_cmd(&self.prefix, &self.node, ""));
        let done = match verb {
            Some("create") => request(query).and_then(|request| self.create(&promise, &request)),
            verb => Err(CommandError::UnknownVerb {
                verb: verb.unwrap_or_default().to_owned(),
                known: &keys::NODE_VERBS,
            }),
        };
        if let Err(error) = done {
            promise.refuse(&error, None);
        }
    }

    fn create(&self, promise: &Promise, request: &Request) -> Result<(), CommandError> {
        if request.expect_step.is_some() || request.expect_epoch.is_some() {
            return Err(CommandError::Field {
                field: "expect_step",
                problem: "and expect_epoch are about a swarm that is there: leave them out",
            });
        }
        let args: CreateArgs = request.args()?;
        let recipe = create::recipe(&args, self.host.limits())?;
        let timeout = command::timeout(request)?;
        let name = args.name;
        let reply = {
            let (name, recipe) = (name.clone(), recipe.clone());
            move |is_new: bool| {
                let (name, recipe) = (name.clone(), recipe.clone());
                move |place: Place, outcome| match outcome {
                    Outcome::Seen(seen) => wire::created(&name, &place, &recipe, &seen, is_new),
                    other => wire::outcome(&name, &place, other, None),
                }
            }
        };
        let answer = |is_new: bool| -> Answer {
            let (answer, reply) = (answer_to(promise), reply(is_new));
            Box::new(move |answered| answer(answered, reply))
        };
        promise.keep_within(timeout, || None);
        let created = self
            .host
            .create(&name, recipe, args.exist_ok, || answer(true))?;
        if let Created::Existing(handle) = created {
            handle.send(Ticket::Look(answer(false)));
        }
        Ok(())
    }

    /// Looks at a swarm and answers with what `payload` makes of it.
    fn look(
        &self,
        swarm: &str,
        promise: &Promise,
        payload: impl FnOnce(Place, Arc<Frame>) -> Payload + Send + 'static,
    ) {
        let name = swarm.to_owned();
        self.send(swarm, promise, DEFAULT_TIMEOUT, |answer| {
            Ticket::Look(Box::new(move |answered| {
                answer(answered, move |place, outcome| match outcome {
                    Outcome::Seen(seen) => payload(place, seen),
                    other => wire::outcome(&name, &place, other, None),
                });
            }))
        });
    }

    /// Hands a ticket to a swarm. The promise is kept by its answer, in time or with an excuse.
    fn send<A>(
        &self,
        swarm: &str,
        promise: &Promise,
        patience: Duration,
        ticket: impl FnOnce(AnswerTo<A>) -> Ticket,
    ) where
        A: FnOnce(Place, Outcome) -> Payload + Send + 'static,
    {
        let Some(handle) = self.host.find(swarm) else {
            let error = CommandError::UnknownSwarm(swarm.to_owned());
            return promise.refuse(&error, None);
        };
        let late = handle.clone();
        promise.keep_within(patience, move || late.step());
        handle.send(ticket(answer_to(promise)));
    }

    fn unknown_noun(&self, query: &Query, known: &'static [&'static str]) {
        let key = query.key_expr().as_str();
        let noun = key.split_once("/get/").map_or(key, |(_, noun)| noun);
        let error = CommandError::UnknownNoun {
            noun: noun.to_owned(),
            known,
        };
        let promise = self.desk.promise(query.clone(), key.to_owned());
        promise.refuse(&error, None);
    }
}

/// Takes what a swarm answers and how to word it.
type AnswerTo<A> = Box<dyn FnOnce(Answered, A) + Send>;

/// Keeps `promise` with whatever is answered; if it is dropped unanswered, with a refusal.
fn answer_to<A>(promise: &Promise) -> AnswerTo<A>
where
    A: FnOnce(Place, Outcome) -> Payload + Send + 'static,
{
    let keeper = Keeper(promise.clone());
    Box::new(move |answered, payload| match answered {
        Ok((place, outcome)) => keeper.0.keep(move || Ok(payload(place, outcome))),
        Err(refusal) => keeper.0.refuse(&refusal.error.into(), refusal.step),
    })
}
