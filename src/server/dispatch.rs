//! A query in, an order or an answer out. One thread, which never waits for a swarm.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use fail::fail_point;
use jostle_proto::verbs::CreateArgs;
use jostle_proto::{NodeReply, NodeStatus, Phase, Request, Schemas, Swarms, keys};
use tracing::{error, info, warn};
use zenoh::query::Query;
use zenoh::{Session, Wait};

use crate::command::error::refusal;
use crate::command::{self, Command, CommandError, DEFAULT_TIMEOUT, create, page, wait};
use crate::host::{Created, Herald, Host};
use crate::publish::Press;
use crate::server::answer::{Desk, Held, Keeper, Promise};
use crate::server::doors::{Doors, LINGER};
use crate::server::ledger::{Entered, Ledger};
use crate::server::query::{Topic, format, names, no_parameters, request};
use crate::server::session::MAX_MESSAGE_BYTES;
use crate::swarm::frame::{Frame, Place};
use crate::swarm::handle::Ticket;
use crate::swarm::order::{Answer, Answered, OrderError, Outcome, Refusal};
use crate::swarm::waiters::Waiter;
use crate::wire::{self, Payload};

/// Queries that may wait to be dispatched; what comes on top is refused at once.
pub const MOST_QUERIES: usize = 1024;

/// What the dispatching thread takes.
pub enum Intake {
    /// A query on one of the daemon's keys.
    Query(Topic, Held, Query),
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
    /// What the named requests came to.
    pub ledger: Ledger,
    /// The schemas of every message.
    pub schemas: Schemas,
    /// What swarms can be reached by.
    pub doors: Doors,
}

impl Dispatcher {
    /// Dispatches until told to stop.
    pub fn run(mut self, intake: &Receiver<Intake>) {
        loop {
            match intake.recv_timeout(LINGER) {
                Ok(Intake::Query(topic, _held, query)) => self.survive(&topic, query),
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

    /// Dispatches a query; one that uncovers a defect ends with an error and not with the daemon.
    fn survive(&self, topic: &Topic, query: Query) {
        let again = query.clone();
        if catch_unwind(AssertUnwindSafe(|| self.query(topic, query))).is_err() {
            let key = again.key_expr().as_str().to_owned();
            error!(key, "a defect: the query panicked");
            let promise = self.desk.promise(again, key);
            promise.refuse(&CommandError::Internal, None);
        }
    }

    fn query(&self, topic: &Topic, query: Query) {
        fail_point!("query");
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
            let read = match noun {
                "events" | "journal" => page::read(query.parameters().iter()),
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
            let limits = self.host.limits();
            self.look(swarm, &promise, move |place, seen| match (noun, handle) {
                ("spec", Some(handle)) => {
                    let spec = wire::spec(&handle.recipe, seen.seed);
                    Payload::json(&wire::reply(&name, &place, spec))
                }
                ("parameters", _) => {
                    let parameters = wire::parameters(&seen, limits);
                    Payload::json(&wire::reply(&name, &place, parameters))
                }
                ("events", Some(handle)) => {
                    let events = wire::events(&name, handle.history.events(after, limit), refusal);
                    Payload::json(&wire::reply(&name, &place, events))
                }
                ("journal", Some(handle)) => {
                    let journal = wire::journal(handle.history.entries(after, limit));
                    Payload::json(&wire::reply(&name, &place, journal))
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
            request(query).and_then(|request| {
                let command = command::read(verb, &request)?;
                let is_new = self.enter(key, &request, &promise)?;
                Ok((command, is_new))
            })
        };
        let (command, is_new) = match read {
            Ok(command) => command,
            Err(error) => {
                let step = self.host.find(swarm).and_then(|handle| handle.step());
                return promise.refuse(&error, step);
            }
        };
        let Command {
            order,
            when,
            sender,
            timeout,
            returns_state,
        } = command;
        if !is_new {
            let late = self.host.find(swarm);
            return promise.keep_within(timeout, move || late?.step());
        }
        let (press, name) = (self.press.clone(), swarm.clone());
        self.send(swarm, &promise, timeout, |answer| Ticket::Command {
            order,
            when,
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

    /// Enters a request that has a name into the ledger; false if it need not be carried out.
    fn enter(&self, key: &str, request: &Request, promise: &Promise) -> Result<bool, CommandError> {
        let Some(id) = &request.request_id else {
            return Ok(true);
        };
        match self.ledger.enter(key, request, id, promise) {
            Entered::New(page) => {
                promise.note_on(page);
                Ok(true)
            }
            Entered::Known => Ok(false),
            Entered::Other => Err(CommandError::OtherRequest(id.clone())),
        }
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
                    unix_secs: unix_secs(),
                    limits: wire::limits(self.host.limits(), MAX_MESSAGE_BYTES),
                }),
                "status" => self.node_reply(self.node_status()),
                "schema" => self.node_reply(&self.schemas),
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
        for (field, given) in [
            ("at_step", request.at_step),
            ("expect_step", request.expect_step),
            ("expect_epoch", request.expect_epoch),
        ] {
            if given.is_some() {
                let problem = "is about a swarm that is there: leave it out";
                return Err(CommandError::Field { field, problem });
            }
        }
        command::sender("create", request)?;
        let args: CreateArgs = request.args()?;
        let recipe = create::recipe(&args, self.host.limits())?;
        let timeout = command::timeout(request)?;
        let key = keys::node_cmd(&self.prefix, &self.node, "create");
        let is_new = self.enter(&key, request, promise)?;
        promise.keep_within(timeout, || None);
        if !is_new {
            return Ok(());
        }
        let name = args.name;
        let answer = |created: bool| -> Answer {
            let (keeper, name, recipe) = (Keeper(promise.clone()), name.clone(), recipe.clone());
            Box::new(move |answered| match answered {
                Ok((place, Outcome::Seen(seen))) => keeper
                    .0
                    .fulfil(move || Ok(wire::created(&name, &place, &recipe, &seen, created))),
                Ok((place, other)) => keeper
                    .0
                    .fulfil(move || Ok(wire::outcome(&name, &place, other, None))),
                Err(Refusal { step, error }) => {
                    keeper.0.refuse(&create::explain(error), step);
                }
            })
        };
        let created = self
            .host
            .create(&name, recipe.clone(), args.exist_ok, || answer(true))?;
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
        Ok((place, outcome)) => keeper.0.fulfil(move || Ok(payload(place, outcome))),
        // It was carried out, though not to its end.
        Err(Refusal {
            step,
            error: error @ OrderError::Faulted(_),
        }) => keeper
            .0
            .fulfil(move || Err(Payload::json(&CommandError::from(error).to_wire(step)))),
        Err(Refusal { step, error }) => keeper.0.refuse(&error.into(), step),
    })
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
