//! How the rest of the daemon reaches a swarm.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use jostle_physics::simulation::Spec;

use crate::swarm::command::{Command, Seek, When};
use crate::swarm::cpu_scheduler::{CpuScheduler, Share};
use crate::swarm::error::SwarmError;
use crate::swarm::frame::Summary;
use crate::swarm::history::History;
use crate::swarm::membership::Put;
use crate::swarm::outcome::{Rejection, ReplyTo};
use crate::swarm::outlet::Outlet;
use crate::swarm::sender::Sender;
use crate::swarm::tally::{Tally, Totals};
use crate::swarm::waiters::Waiter;

/// What a swarm's thread takes, in the order of arrival.
pub enum Message {
    /// A command.
    Command(CommandMessage),
    /// A look at the state as it is now.
    Look(ReplyTo),
    /// A look when something has come about.
    Wait(Waiter),
    /// All of it as it is now.
    Copy(ReplyTo),
    /// A recording is to go there.
    Seek(Seek, Arc<Sender>, ReplyTo),
    /// Set-points of a controller's, made in an epoch if that is known; none if they could not be
    /// read.
    Put(String, Option<u64>, Option<Put>),
    /// A controller's token is gone.
    Lost(String),
    /// A recording of the swarm has failed: its name, and why.
    RecordingFailed(Arc<str>, Arc<str>),
    /// It is to look for itself: it has a core now, or somebody else has done what it waited for.
    Awake,
    /// End now, without an event: the daemon stops.
    Stop,
}

/// A command to a swarm.
pub struct CommandMessage {
    /// What to do.
    pub order: Command,
    /// When to do it.
    pub when: When,
    /// Who sent it.
    pub sender: Arc<Sender>,
    /// Takes what it came to.
    pub answer: ReplyTo,
}

/// The step that a swarm reached lately.
pub struct LastStep(Arc<Mutex<Option<Summary>>>);

impl LastStep {
    /// The step; `None` until the swarm is built.
    pub fn get(&self) -> Option<u64> {
        let summary = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Some(summary.as_ref()?.place.step)
    }
}

/// A swarm as others see it. Clones reach the same swarm.
#[derive(Clone)]
pub struct Handle {
    /// What it was created from.
    pub recipe: Arc<Spec>,
    /// Where it puts what is to be published.
    pub outlet: Arc<Outlet>,
    /// What happened to it, and the commands it applied.
    pub history: Arc<History>,
    /// What its thread counts of itself.
    pub tally: Arc<Tally>,
    pub(crate) messages: Arc<SyncSender<Message>>,
    pub(crate) cores: Arc<CpuScheduler>,
    pub(crate) summary: Arc<Mutex<Option<Summary>>>,
}

impl Handle {
    /// A handle of a swarm that nobody else knows of, that has a core of its own and no name.
    pub(crate) fn alone(recipe: Spec) -> Self {
        let (messages, _) = sync_channel(1);
        Handle {
            recipe: Arc::new(recipe),
            outlet: Arc::new(Outlet::new(String::new(), || {}, |_| false)),
            history: Arc::default(),
            tally: Arc::default(),
            messages: Arc::new(messages),
            cores: Arc::new(CpuScheduler::new(1)),
            summary: Arc::default(),
        }
    }

    /// Hands over a ticket. Its answer comes from the swarm's thread, or from here when too many
    /// wait already ([`SwarmError::Busy`]) or the swarm has ended ([`SwarmError::Gone`]).
    pub fn send(&self, message: Message) {
        let (message, error) = match self.messages.try_send(message) {
            Ok(()) => return,
            Err(TrySendError::Full(message)) => (message, SwarmError::Busy),
            Err(TrySendError::Disconnected(message)) => (message, SwarmError::Gone),
        };
        message.refuse(self.step(), error);
    }

    /// Wakes its thread, and keeps no queue of tickets alive.
    pub(crate) fn awaken(&self) -> impl Fn() + Send + Sync + use<> {
        let messages = Arc::downgrade(&self.messages);
        move || {
            if let Some(messages) = messages.upgrade() {
                // A thread whose queue is full is awake, or wakes for that.
                let _ = messages.try_send(Message::Awake);
            }
        }
    }

    /// Its place among the swarms that share the cores.
    pub(crate) fn seat(&self) -> Share {
        self.cores.share(self.awaken())
    }

    /// What has been counted of it since it is hosted here.
    pub fn totals(&self) -> Totals {
        let (frames, frames_dropped) = self.outlet.frames();
        Totals {
            frames,
            frames_dropped,
            ..self.tally.totals()
        }
    }

    /// The step the swarm lately was at.
    pub fn step(&self) -> Option<u64> {
        Some(self.summary()?.place.step)
    }

    /// The step that the swarm reached lately, without keeping its mailbox alive.
    pub fn last_step(&self) -> LastStep {
        LastStep(self.summary.clone())
    }

    /// The swarm in a list; `None` until it is built.
    pub fn summary(&self) -> Option<Summary> {
        self.summary
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

impl Message {
    /// Answers a ticket that no swarm took.
    fn refuse(self, step: Option<u64>, error: SwarmError) {
        match self {
            Message::Command(CommandMessage { answer, .. })
            | Message::Look(answer)
            | Message::Copy(answer)
            | Message::Seek(_, _, answer)
            | Message::Wait(Waiter { answer, .. }) => {
                answer.send(Err(Rejection { step, error }));
            }
            Message::Put(..)
            | Message::Lost(_)
            | Message::RecordingFailed(..)
            | Message::Awake
            | Message::Stop => {}
        }
    }
}

/// The next ticket, which may come until then.
pub(crate) fn receive(
    messages: &Receiver<Message>,
    until: Option<Instant>,
) -> Result<Message, RecvTimeoutError> {
    match until {
        Some(until) => messages.recv_timeout(until.saturating_duration_since(Instant::now())),
        None => messages.recv().map_err(RecvTimeoutError::from),
    }
}
