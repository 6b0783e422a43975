//! The thread `dispatch`: handles requests, and declares the keys that this daemon serves.
//!
//! It does not wait for a swarm's thread, nor for the disk.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::Instant;

use tracing::{info, warn};

use crate::api::incoming::{Incoming, Target};
use crate::convert::commands::CommandError;
use crate::metrics::Activity;
use crate::swarm::handle::DeferredReply;
use crate::transport::zenoh::claims::{Action, Gate, Name, Reserved};
use crate::transport::zenoh::gateway::Gateway;
use crate::transport::zenoh::messages::DispatchMessage;
use crate::transport::zenoh::publisher::Publisher;
use crate::transport::zenoh::queryables::{LINGER, SwarmEndpoints};
use crate::transport::zenoh::session_pool::SessionPool;

/// The state of the dispatcher.
pub struct Dispatcher {
    /// What it shares with the threads that receive queries.
    pub gateway: Arc<Gateway>,
    /// The sessions that declare the keys of swarms.
    pub pool: SessionPool,
    /// Publishes the states of swarms.
    pub publisher: Arc<Publisher>,
    /// The keys of the daemon and of its swarms.
    pub endpoints: SwarmEndpoints,
    /// Requests that are held, and until when.
    pub held: Vec<(Instant, Incoming)>,
    /// Receives the result of announcing the daemon, after every swarm is recovered.
    pub recovered: Option<SyncSender<zenoh::Result<()>>>,
    /// Whether the thread is working.
    pub activity: Arc<Activity>,
}

impl Dispatcher {
    /// Dispatches until [`DispatchMessage::Stop`].
    pub fn run(mut self, messages: &Receiver<DispatchMessage>) {
        loop {
            self.activity.end();
            let held = self.held.iter().map(|(until, _)| *until);
            let due = held.chain(self.gateway.claims.due()).min();
            let wait = due.map_or(LINGER, |due| due.saturating_duration_since(Instant::now()));
            let message = messages.recv_timeout(wait.min(LINGER));
            self.activity.begin();
            self.release();
            match message {
                Ok(DispatchMessage::Request(incoming)) => self.dispatch_or_hold(incoming),
                Ok(DispatchMessage::Claimed) => {}
                Ok(DispatchMessage::Recovering(swarms, opened)) => {
                    self.recovering(swarms);
                    let _ = opened.send(());
                }
                Ok(DispatchMessage::Recovered(announced)) => self.recovered(announced),
                Ok(DispatchMessage::FirstUse(swarm, verb)) => {
                    self.endpoints.declare_key(&swarm, verb);
                }
                Ok(DispatchMessage::Begun(swarm, reply)) => self.begun(&swarm, reply),
                Ok(DispatchMessage::Ended(swarm, reply)) => self.ended(&swarm, reply),
                Ok(DispatchMessage::Closed(swarm, reply)) => {
                    self.gateway.context.registry.release(&swarm);
                    reply.send();
                }
                Err(RecvTimeoutError::Timeout) => {}
                Ok(DispatchMessage::Stop) | Err(RecvTimeoutError::Disconnected) => {
                    self.gateway.context.lanes.stop();
                    return self.activity.end();
                }
            }
            self.reconcile();
            self.endpoints.sweep();
        }
    }

    /// Dispatches a request or holds it. A held request still counts in `queued`, so that no later
    /// command is handled before it.
    fn dispatch_or_hold(&mut self, incoming: Incoming) {
        match self.dispatch(&incoming) {
            Some(until) => self.held.push((until, incoming)),
            None => {
                self.gateway.queued.fetch_sub(1, Ordering::Release);
            }
        }
    }

    /// Dispatches, rejects or drops a request, depending on its gate; returns the instant until
    /// which it must be held instead, if any.
    fn dispatch(&mut self, incoming: &Incoming) -> Option<Instant> {
        let Gateway {
            context, claims, ..
        } = &*self.gateway;
        let (name, is_command) = match &incoming.target {
            Target::Deletion => {
                if !incoming.is_wild && !self.endpoints.serves(&incoming.key) {
                    context.handle(incoming);
                }
                return None;
            }
            Target::State(swarm) | Target::Get(swarm) => (Name::Swarm(swarm.to_string()), false),
            Target::Command(swarm) => (Name::Swarm(swarm.to_string()), true),
            Target::NodeGet | Target::Experiment => (Name::Node, false),
            Target::NodeCommand => (Name::Node, true),
        };
        // A command that is not permitted or has a wildcard executes nothing, so it is not held:
        // its handler rejects it.
        let executes = is_command && !incoming.is_wild && context.permit(incoming).is_ok();
        // Nor does one that waits for the recovery, but another daemon may execute it.
        let is_rejected = !executes || context.awaits_recovery(incoming).is_some();
        let mut created = None;
        let error = match claims.gate(&name, executes) {
            Gate::Open | Gate::First if is_rejected => None,
            gate @ (Gate::Open | Gate::First) => {
                // Without a router no other daemon can claim the name.
                created = match claims.is_connected() {
                    true => context.creates(incoming),
                    false => None,
                };
                match created.as_ref().map(|it| claims.reserve(it)) {
                    Some(Reserved::At(serve_after)) => return Some(serve_after),
                    Some(Reserved::ClaimedBy(node)) => Some(CommandError::Claimed(node)),
                    Some(Reserved::Now) | None => {
                        if gate == Gate::First {
                            claims.change(&name);
                        }
                        None
                    }
                }
            }
            Gate::Hold(until) => return Some(until),
            Gate::Drop => return None,
            Gate::Busy => Some(CommandError::HandingOver),
            Gate::Reject(contest) => Some((*contest).into()),
        };
        match error {
            None => context.handle(incoming),
            Some(error) => context.reject(incoming, &error),
        }
        // `fork`, `restore` and `replay` finish later; `create` has succeeded or failed by now.
        let is_create = incoming.key.ends_with("/create");
        if let Some(created) = created
            && is_create
            && context.registry.find(&created).is_none()
        {
            claims.release(&created);
        }
        None
    }

    /// Dispatches the requests that were held until now, in their order.
    fn release(&mut self) {
        let now = Instant::now();
        if self.held.iter().all(|(until, _)| now < *until) {
            return;
        }
        for (until, incoming) in std::mem::take(&mut self.held) {
            match now < until {
                true => self.held.push((until, incoming)),
                false => self.dispatch_or_hold(incoming),
            }
        }
    }

    /// Opens and closes keys according to the claims of other daemons.
    fn reconcile(&mut self) {
        for action in self.gateway.claims.reconcile() {
            match action {
                Action::Open(Name::Node) => self.open_node(),
                Action::Close(Name::Node) => self.endpoints.close_node(),
                Action::Open(Name::Swarm(swarm)) => self.open(&swarm),
                Action::Close(Name::Swarm(swarm)) => {
                    self.endpoints.close_now(&swarm);
                    self.publisher.mute(&swarm, true);
                }
                Action::Reject(Name::Swarm(swarm)) => _ = self.publisher.mute(&swarm, true),
                Action::Resume(Name::Swarm(swarm)) => _ = self.publisher.mute(&swarm, false),
                Action::Reject(Name::Node) | Action::Resume(Name::Node) => {}
            }
        }
        // If this daemon has to wait, its start is complete without serving anything.
        if self.recovered.is_some()
            && self.gateway.claims.waits()
            && let Some(recovered) = self.recovered.take()
        {
            let _ = recovered.send(Ok(()));
        }
    }

    /// Claims the daemon's own name and those of the swarms that are to be recovered.
    fn recovering(&mut self, swarms: Vec<String>) {
        self.gateway.claims.begin(&Name::Node, false);
        for swarm in swarms {
            self.gateway.claims.begin(&Name::Swarm(swarm), false);
        }
        self.reconcile();
    }

    /// Announces the daemon, and closes the keys of the swarms that could not be recovered.
    fn recovered(&mut self, announced: SyncSender<zenoh::Result<()>>) {
        for swarm in self.gateway.context.recovery.end() {
            self.endpoints.close(&swarm);
            self.gateway.claims.end(&Name::Swarm(swarm));
        }
        self.recovered = Some(announced);
        if self.gateway.claims.is_open(&Name::Node) {
            self.open_node();
        }
    }

    /// Opens the daemon's own keys; announces the daemon if the recovery has ended.
    fn open_node(&mut self) {
        let is_recovering = self.gateway.context.recovery.swarms_left().is_some();
        let opened = match is_recovering {
            true => self.endpoints.open_node(),
            false => self.endpoints.announce_node(),
        };
        if let Err(error) = &opened {
            warn!(%error, "failed to open the daemon's keys");
        }
        if let Some(recovered) = self.recovered.take() {
            let _ = recovered.send(opened);
        }
    }

    fn begun(&mut self, swarm: &str, reply: DeferredReply) {
        let name = Name::Swarm(swarm.to_owned());
        let context = self.gateway.context.clone();
        if context.recovery.is_pending(swarm) {
            // Its name was claimed when the recovery began.
            if self.gateway.claims.is_open(&name) {
                self.open_built(swarm);
            }
            context.recovery.remove(swarm);
        } else {
            self.gateway.claims.begin(&name, true);
        }
        self.reconcile();
        reply.send();
    }

    fn open(&mut self, swarm: &str) {
        if !self.gateway.context.recovery.is_pending(swarm) {
            return self.open_built(swarm);
        }
        if let Err(error) = self.endpoints.prepare(swarm) {
            warn!(swarm, %error, "failed to open the keys of a swarm that is to be recovered");
        }
    }

    fn open_built(&mut self, swarm: &str) {
        let Some(handle) = self.gateway.context.registry.find(swarm) else {
            return;
        };
        let opened = match self.publisher.mute(swarm, false) {
            true => Ok(()),
            false => {
                let lease = self.pool.lease();
                lease.and_then(|lease| self.publisher.open(lease, &handle.output))
            }
        };
        // What its first commands publish has a publisher now.
        self.gateway.context.recovery.remove(swarm);
        match opened.and_then(|()| self.endpoints.open(swarm)) {
            Ok(()) => info!(swarm, "hosted"),
            Err(error) => warn!(swarm, %error, "failed to open the swarm's keys"),
        }
    }

    fn ended(&mut self, swarm: &str, reply: DeferredReply) {
        self.gateway.context.recovery.remove(swarm);
        self.endpoints.close(swarm);
        self.gateway.claims.end(&Name::Swarm(swarm.to_owned()));
        self.publisher.close(swarm, reply);
    }
}
