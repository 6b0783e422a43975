//! A query in, an order or an answer out. One thread, which never waits for a swarm.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};

use tracing::{info, warn};

use crate::host::Herald;
use crate::meter::Pulse;
use crate::publish::Press;
use crate::server::answer::Asked;
use crate::server::clerk::Clerk;
use crate::server::doors::{Doors, LINGER};
use crate::server::query::Topic;

/// Queries that may wait to be dispatched; what comes on top is refused at once.
pub const MOST_QUERIES: usize = 1024;

/// What the dispatching thread takes.
pub enum Intake {
    /// A query on one of the daemon's keys.
    Query(Topic, Asked),
    /// A verb came to a swarm for the first time.
    Used(Arc<str>, &'static str),
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
    /// Whether this thread is at work.
    pub pulse: Arc<Pulse>,
}

impl Dispatcher {
    /// Dispatches until told to stop.
    pub fn run(mut self, intake: &Receiver<Intake>) {
        loop {
            self.pulse.rest();
            let taken = intake.recv_timeout(LINGER);
            self.pulse.beat();
            match taken {
                Ok(Intake::Query(topic, asked)) => {
                    match topic {
                        Topic::Deletion => self.clerk.guard(&asked, || self.deleted(&asked)),
                        topic => self.clerk.survive(&topic, &asked),
                    }
                    self.clerk.waiting.fetch_sub(1, Ordering::Release);
                }
                Ok(Intake::Used(swarm, verb)) => self.doors.declare_key(&swarm, verb),
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
        let Some(handle) = self.clerk.host.find(swarm) else {
            return;
        };
        let opened = self
            .clerk
            .press
            .open(&self.clerk.session, swarm, handle.outlet.clone())
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
