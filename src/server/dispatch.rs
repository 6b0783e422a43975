//! A query in, an order or an answer out. One thread, which never waits for a swarm.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use fail::fail_point;
use jostle_proto::Schemas;
use tracing::{error, info, warn};
use zenoh::Session;

use crate::command::{CommandError, DEFAULT_TIMEOUT};
use crate::health::Watch;
use crate::host::{Herald, Host};
use crate::lab::Lab;
use crate::meter::Pulse;
use crate::publish::Press;
use crate::server::answer::{Asked, Desk, Excuse, Keeper, Promise};
use crate::server::doors::{Doors, LINGER};
use crate::server::experiments::Errands;
use crate::server::ledger::Ledger;
use crate::server::query::Topic;
use crate::store::Store;
use crate::swarm::frame::{Frame, Place};
use crate::swarm::handle::Ticket;
use crate::swarm::order::{Answered, OrderError, Outcome, Refusal};
use crate::wire::{self, Payload};

/// Queries that may wait to be dispatched; what comes on top is refused at once.
pub const MOST_QUERIES: usize = 1024;

/// What the dispatching thread takes.
pub enum Intake {
    /// A query on one of the daemon's keys.
    Query(Topic, Asked),
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
    /// What outlives the daemon.
    pub store: Store,
    /// What the named requests came to.
    pub ledger: Ledger,
    /// The schemas of every message.
    pub schemas: Schemas,
    /// What swarms can be reached by.
    pub doors: Doors,
    /// Whether this thread is at work.
    pub pulse: Arc<Pulse>,
    /// The experiments.
    pub lab: Lab,
    /// Where what is to be done with them is handed in.
    pub errands: Errands,
    /// The daemon in numbers, once it is watched.
    pub watch: Arc<OnceLock<Arc<Watch>>>,
}

impl Dispatcher {
    /// Dispatches until told to stop.
    pub fn run(mut self, intake: &Receiver<Intake>) {
        loop {
            self.pulse.rest();
            let taken = intake.recv_timeout(LINGER);
            self.pulse.beat();
            match taken {
                Ok(Intake::Query(topic, asked)) => self.survive(&topic, &asked),
                Ok(Intake::Begun(swarm, built)) => self.begun(&swarm, built),
                Ok(Intake::Ended(swarm, ended)) => self.ended(&swarm, ended),
                Err(RecvTimeoutError::Timeout) => {}
                Ok(Intake::Stop) | Err(RecvTimeoutError::Disconnected) => {
                    return self.pulse.rest();
                }
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
            Ok(()) => info!(swarm, "hosted"),
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
    fn survive(&self, topic: &Topic, asked: &Asked) {
        if catch_unwind(AssertUnwindSafe(|| self.query(topic, asked))).is_err() {
            let key = asked.query.key_expr().as_str().to_owned();
            error!(key, "a defect: the query panicked");
            let promise = self.desk.promise(asked, key);
            promise.refuse(&CommandError::Internal, None);
        }
    }

    fn query(&self, topic: &Topic, asked: &Asked) {
        fail_point!("query");
        let has_payload = asked
            .query
            .payload()
            .is_some_and(|payload| !payload.is_empty());
        if has_payload
            && matches!(
                topic,
                Topic::State(_) | Topic::Get(_) | Topic::NodeGet | Topic::Experiment
            )
        {
            let error = CommandError::Field {
                field: "payload",
                problem: "means nothing to a get: what it takes goes behind the key's `?`",
            };
            let key = asked.query.key_expr().as_str().to_owned();
            return self.desk.promise(asked, key).refuse(&error, None);
        }
        match topic {
            Topic::State(swarm) => self.state(swarm, asked),
            Topic::Get(swarm) => self.get(swarm, asked),
            Topic::Command(swarm) => self.command(swarm, asked),
            Topic::Deletion => self.deleted(asked),
            Topic::NodeGet => self.node_get(asked),
            Topic::NodeCommand => self.node_command(asked),
            Topic::Experiment => self.experiment_get(asked),
        }
    }

    /// Looks at a swarm and answers with what `payload` makes of it.
    pub(super) fn look(
        &self,
        swarm: &str,
        promise: &Promise,
        payload: impl FnOnce(Place, Arc<Frame>) -> Payload + Send + 'static,
    ) {
        let name = swarm.to_owned();
        self.send(
            swarm,
            promise,
            (DEFAULT_TIMEOUT, CommandError::deadline),
            |answer| {
                Ticket::Look(Box::new(move |answered| {
                    answer(answered, move |place, outcome| match outcome {
                        Outcome::Seen(seen) => payload(place, seen),
                        other => wire::outcome(&name, &place, other, None),
                    });
                }))
            },
        );
    }

    /// Hands a ticket to a swarm. The promise is kept by its answer, in time or with an excuse.
    pub(super) fn send<A>(
        &self,
        swarm: &str,
        promise: &Promise,
        (patience, excuse): (Duration, Excuse),
        ticket: impl FnOnce(AnswerTo<A>) -> Ticket,
    ) where
        A: FnOnce(Place, Outcome) -> Payload + Send + 'static,
    {
        let Some(handle) = self.host.find(swarm) else {
            let error = CommandError::UnknownSwarm(swarm.to_owned());
            return promise.refuse(&error, None);
        };
        let late = handle.step_later();
        promise.keep_within(patience, excuse, late);
        handle.send(ticket(answer_to(promise)));
    }
}

/// Takes what a swarm answers and how to word it.
pub(super) type AnswerTo<A> = Box<dyn FnOnce(Answered, A) + Send>;

/// Keeps `promise` with whatever is answered; if it is dropped unanswered, with a refusal.
fn answer_to<A>(promise: &Promise) -> AnswerTo<A>
where
    A: FnOnce(Place, Outcome) -> Payload + Send + 'static,
{
    let keeper = Keeper::new(promise.clone());
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
