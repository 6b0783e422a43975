//! A query in, an order or an answer out. One thread, which never waits for a swarm.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::Instant;

use tracing::{info, warn};

use crate::api::commands::CommandError;
use crate::api::context::Clerk;
use crate::api::responder::Asked;
use crate::metrics::Pulse;
use crate::swarm::registry::Herald;
use crate::transport::zenoh::claims::{Action, Gate, Name, Reserved};
use crate::transport::zenoh::publisher::Press;
use crate::transport::zenoh::query::Topic;
use crate::transport::zenoh::queryables::{Doors, LINGER};

/// Queries that may wait to be dispatched; what comes on top is refused at once.
pub const MOST_QUERIES: usize = 1024;

/// What the dispatching thread takes.
pub enum Intake {
    /// A query on one of the daemon's keys.
    Query(Topic, Asked),
    /// A verb came to a swarm for the first time.
    Used(Arc<str>, &'static str),
    /// The claims of other daemons, or the connected routers, changed.
    Claimed,
    /// Every swarm is recovered: open the daemon's own keys as soon as its claim permits it.
    Recovered(SyncSender<zenoh::Result<()>>),
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

    fn is_watched(&self, name: &str, is_moving: bool) -> bool {
        self.press.is_watched(name, is_moving)
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
    /// What it takes to answer.
    pub clerk: Arc<Clerk>,
    /// What swarms can be reached by.
    pub doors: Doors,
    /// Queries that are held, and until when.
    pub held: Vec<(Instant, Topic, Asked)>,
    /// Receives the result of opening the daemon's own keys, after every swarm is recovered.
    pub recovered: Option<SyncSender<zenoh::Result<()>>>,
    /// Whether this thread is at work.
    pub pulse: Arc<Pulse>,
}

impl Dispatcher {
    /// Dispatches until told to stop.
    pub fn run(mut self, intake: &Receiver<Intake>) {
        loop {
            self.pulse.rest();
            let held = self.held.iter().map(|(until, ..)| *until);
            let due = held.chain(self.clerk.claims.due()).min();
            let wait = due.map_or(LINGER, |due| due.saturating_duration_since(Instant::now()));
            let taken = intake.recv_timeout(wait.min(LINGER));
            self.pulse.beat();
            self.release();
            match taken {
                Ok(Intake::Query(topic, asked)) => self.take(topic, asked),
                Ok(Intake::Claimed) => {}
                Ok(Intake::Recovered(opened)) => {
                    self.recovered = Some(opened);
                    self.clerk.claims.begin(&Name::Node, false);
                }
                Ok(Intake::Used(swarm, verb)) => self.doors.declare_key(&swarm, verb),
                Ok(Intake::Begun(swarm, built)) => self.begun(&swarm, built),
                Ok(Intake::Ended(swarm, ended)) => self.ended(&swarm, ended),
                Err(RecvTimeoutError::Timeout) => {}
                Ok(Intake::Stop) | Err(RecvTimeoutError::Disconnected) => {
                    self.clerk.verifications.stop();
                    return self.pulse.rest();
                }
            }
            self.reconcile();
            self.doors.sweep();
        }
    }

    /// Dispatches a query or holds it. A held query still counts in `waiting`, so that no later
    /// command is executed inline before it.
    fn take(&mut self, topic: Topic, asked: Asked) {
        match self.query(&topic, &asked) {
            Some(until) => self.held.push((until, topic, asked)),
            None => {
                self.clerk.waiting.fetch_sub(1, Ordering::Release);
            }
        }
    }

    /// Dispatches, rejects or drops a query, depending on its gate; returns the instant until which
    /// it must be held instead, if any.
    fn query(&mut self, topic: &Topic, asked: &Asked) -> Option<Instant> {
        let clerk = self.clerk.clone();
        let (name, is_command) = match topic {
            Topic::Deletion => {
                clerk.guard(asked, || self.deleted(asked));
                return None;
            }
            Topic::State(swarm) | Topic::Get(swarm) => (Name::Swarm(swarm.to_string()), false),
            Topic::Command(swarm) => (Name::Swarm(swarm.to_string()), true),
            Topic::NodeGet | Topic::Experiment => (Name::Node, false),
            Topic::NodeCommand => (Name::Node, true),
        };
        // A command that is not permitted or has a wildcard executes nothing, so it is not held:
        // its handler rejects it.
        let executes = is_command && !asked.query.key_expr().is_wild();
        let executes = executes && clerk.permit(&asked.query).is_ok();
        let mut created = None;
        let error = match clerk.claims.gate(&name, executes) {
            Gate::Open | Gate::First if !executes => None,
            gate @ (Gate::Open | Gate::First) => {
                created = clerk.creates(topic, asked);
                match created.as_ref().map(|it| clerk.claims.reserve(it)) {
                    Some(Reserved::At(settled)) => return Some(settled),
                    Some(Reserved::ClaimedBy(node)) => Some(CommandError::Claimed(node)),
                    Some(Reserved::Now) | None => {
                        if gate == Gate::First {
                            clerk.claims.change(&name);
                        }
                        None
                    }
                }
            }
            Gate::Hold(until) => return Some(until),
            Gate::Drop => return None,
            Gate::Busy => Some(CommandError::Busy),
            Gate::Refuse(contest) => Some((*contest).into()),
        };
        match error {
            None => clerk.survive(topic, asked),
            Some(error) => {
                let key = asked.query.key_expr().as_str().to_owned();
                clerk.desk.promise(asked, key).refuse(&error, None);
            }
        }
        // `fork`, `restore` and `replay` finish later; `create` has succeeded or failed by now.
        let is_create = asked.query.key_expr().as_str().ends_with("/create");
        if let Some(created) = created
            && is_create
            && clerk.host.find(&created).is_none()
        {
            clerk.claims.release(&created);
        }
        None
    }

    /// Dispatches the queries that were held until now, in their order.
    fn release(&mut self) {
        let now = Instant::now();
        if self.held.iter().all(|(until, ..)| now < *until) {
            return;
        }
        for (until, topic, asked) in std::mem::take(&mut self.held) {
            match now < until {
                true => self.held.push((until, topic, asked)),
                false => self.take(topic, asked),
            }
        }
    }

    /// Opens and closes keys according to the claims of other daemons.
    fn reconcile(&mut self) {
        for action in self.clerk.claims.reconcile() {
            match action {
                Action::Open(Name::Node) => {
                    let opened = self.doors.open_node();
                    if let Err(error) = &opened {
                        warn!(%error, "failed to open the daemon's keys");
                    }
                    if let Some(recovered) = self.recovered.take() {
                        let _ = recovered.send(opened);
                    }
                }
                Action::Close(Name::Node) => self.doors.close_node(),
                Action::Open(Name::Swarm(swarm)) => self.open(&swarm),
                Action::Close(Name::Swarm(swarm)) => {
                    self.doors.shut(&swarm);
                    self.clerk.press.silence(&swarm, true);
                }
                Action::Refuse(Name::Swarm(swarm)) => self.clerk.press.silence(&swarm, true),
                Action::Resume(Name::Swarm(swarm)) => self.clerk.press.silence(&swarm, false),
                Action::Refuse(Name::Node) | Action::Resume(Name::Node) => {}
            }
        }
        // If this daemon has to wait, its start is complete without serving anything.
        if self.recovered.is_some()
            && self.clerk.claims.waits()
            && let Some(recovered) = self.recovered.take()
        {
            let _ = recovered.send(Ok(()));
        }
    }

    fn begun(&mut self, swarm: &str, built: Box<dyn FnOnce() + Send>) {
        let is_recovering = self.clerk.is_recovering.load(Ordering::Acquire);
        let name = Name::Swarm(swarm.to_owned());
        self.clerk.claims.begin(&name, !is_recovering);
        self.reconcile();
        built();
    }

    /// Opens a swarm's keys.
    fn open(&mut self, swarm: &str) {
        let press = &self.clerk.press;
        let Some(handle) = self.clerk.host.find(swarm) else {
            return;
        };
        let opened = match press.find(swarm) {
            Some(_) => {
                press.silence(swarm, false);
                Ok(())
            }
            None => {
                let lease = self.clerk.pool.lease();
                lease.and_then(|lease| press.open(lease, swarm, handle.outlet.clone()))
            }
        };
        match opened.and_then(|()| self.doors.open(swarm)) {
            Ok(()) => info!(swarm, "hosted"),
            Err(error) => warn!(swarm, %error, "failed to open the swarm's keys"),
        }
    }

    fn ended(&mut self, swarm: &str, ended: Box<dyn FnOnce() + Send>) {
        if self.doors.close(swarm) {
            info!(swarm, "deleted");
        }
        self.clerk.claims.end(&Name::Swarm(swarm.to_owned()));
        let host = self.clerk.host.clone();
        let name = swarm.to_owned();
        self.clerk.press.close(
            swarm,
            Box::new(move || {
                host.release(&name);
                ended();
            }),
        );
    }
}
