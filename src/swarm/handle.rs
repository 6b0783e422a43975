//! The handle of a swarm, and the messages it accepts.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use jostle_physics::simulation::Spec;

use crate::swarm::command::{Command, Seek, When};
use crate::swarm::error::SwarmError;
use crate::swarm::frame::Summary;
use crate::swarm::history::History;
use crate::swarm::membership::Put;
use crate::swarm::metrics::{SwarmMetrics, Totals};
use crate::swarm::outcome::{Rejection, ReplyTo};
use crate::swarm::output::Output;
use crate::swarm::scheduler::{CpuScheduler, Share};
use crate::swarm::sender::Sender;
use crate::swarm::waiters::Waiter;

/// A message to the thread of a swarm. Messages are handled in the order of arrival.
pub enum Message {
    /// A command.
    Command(CommandMessage),
    /// Reply with the present state.
    Query(ReplyTo),
    /// Reply with the state when a condition is met.
    Wait(Waiter),
    /// Reply with a checkpoint.
    TakeCheckpoint(ReplyTo),
    /// Seek in a recording.
    Seek(Seek, Arc<Sender>, ReplyTo),
    /// Set-points of a controller, and the epoch for which they were computed if it is known; `None` if
    /// they could not be parsed.
    Put(String, Option<u64>, Option<Put>),
    /// The liveliness token of a controller is lost.
    Lost(String),
    /// A recording of the swarm has failed: its name and the reason.
    RecordingFailed(Arc<str>, Arc<str>),
    /// Check again what the swarm waits for: a core, or room in a lossless recording.
    Wake,
    /// End without an event: the daemon is stopping.
    Stop,
}

/// A command for a swarm.
pub struct CommandMessage {
    /// The command.
    pub command: Command,
    /// When it is executed.
    pub when: When,
    /// The client that sent it.
    pub sender: Arc<Sender>,
    /// Receives the reply.
    pub reply_to: ReplyTo,
}

/// The last step in the summary of a swarm.
pub struct LastStep(Arc<Mutex<Option<Summary>>>);

impl LastStep {
    /// The step; `None` until the swarm is built.
    pub fn get(&self) -> Option<u64> {
        let summary = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Some(summary.as_ref()?.stamp.step)
    }
}

/// A handle of a swarm. Clones refer to the same swarm.
#[derive(Clone)]
pub struct Handle {
    /// What it was created from.
    pub spec: Arc<Spec>,
    /// Its frames and events for the publisher.
    pub output: Arc<Output>,
    /// Its past events and applied commands.
    pub history: Arc<History>,
    /// Its metrics.
    pub metrics: Arc<SwarmMetrics>,
    pub(crate) messages: Arc<SyncSender<Message>>,
    pub(crate) cores: Arc<CpuScheduler>,
    pub(crate) summary: Arc<Mutex<Option<Summary>>>,
}

impl Handle {
    /// A handle of a swarm outside the registry, with a core of its own and no name.
    pub(crate) fn alone(spec: Spec) -> Self {
        let (messages, _) = sync_channel(1);
        Handle {
            spec: Arc::new(spec),
            output: Arc::new(Output::new(String::new())),
            history: Arc::default(),
            metrics: Arc::default(),
            messages: Arc::new(messages),
            cores: Arc::new(CpuScheduler::new(1)),
            summary: Arc::default(),
        }
    }

    /// Queues a message. If the queue is full ([`SwarmError::Busy`]) or the swarm has ended
    /// ([`SwarmError::Gone`]), the error is sent as the reply.
    pub fn send(&self, message: Message) {
        let (message, error) = match self.messages.try_send(message) {
            Ok(()) => return,
            Err(TrySendError::Full(message)) => (message, SwarmError::Busy),
            Err(TrySendError::Disconnected(message)) => (message, SwarmError::Gone),
        };
        message.reject(self.step(), error);
    }

    /// A callback that wakes the thread of the swarm. It does not keep the queue alive.
    pub(crate) fn waker(&self) -> impl Fn() + Send + Sync + use<> {
        let messages = Arc::downgrade(&self.messages);
        move || {
            if let Some(messages) = messages.upgrade() {
                // A thread with a full queue is awake.
                let _ = messages.try_send(Message::Wake);
            }
        }
    }

    /// Its share of the cores.
    pub(crate) fn cpu_share(&self) -> Share {
        self.cores.share(self.waker())
    }

    /// Its metrics since the daemon started.
    pub fn totals(&self) -> Totals {
        let (frames, frames_dropped) = self.output.to_publish.frames();
        Totals {
            frames,
            frames_dropped,
            ..self.metrics.totals()
        }
    }

    /// The step in its summary; `None` until it is built.
    pub fn step(&self) -> Option<u64> {
        Some(self.summary()?.stamp.step)
    }

    /// Like [`Self::step`], without keeping the queue alive.
    pub fn last_step(&self) -> LastStep {
        LastStep(self.summary.clone())
    }

    /// Its summary; `None` until it is built.
    pub fn summary(&self) -> Option<Summary> {
        self.summary
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

impl Message {
    /// Sends an error as the reply to a message that was not queued.
    fn reject(self, step: Option<u64>, error: SwarmError) {
        match self {
            Message::Command(CommandMessage { reply_to, .. })
            | Message::Query(reply_to)
            | Message::TakeCheckpoint(reply_to)
            | Message::Seek(_, _, reply_to)
            | Message::Wait(Waiter { reply_to, .. }) => {
                reply_to.send(Err(Rejection { step, error }));
            }
            Message::Put(..)
            | Message::Lost(_)
            | Message::RecordingFailed(..)
            | Message::Wake
            | Message::Stop => {}
        }
    }
}

/// Receives the next message, until a deadline.
pub(crate) fn receive(
    messages: &Receiver<Message>,
    until: Option<Instant>,
) -> Result<Message, RecvTimeoutError> {
    match until {
        Some(until) => messages.recv_timeout(until.saturating_duration_since(Instant::now())),
        None => messages.recv().map_err(RecvTimeoutError::from),
    }
}
