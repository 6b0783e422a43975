//! The handle of a swarm, the messages it accepts, and its replies: the outcome of a message, or why it
//! was rejected.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use jostle_physics::simulation::{ChangeKind, ChangeOutcome, Rate, Spec};
use parking_lot::Mutex;
use tracing::info;

use crate::auth::User;
use crate::swarm::awaited::Awaited;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::command::{Command, Seek, WaitCondition, When};
use crate::swarm::error::SwarmError;
use crate::swarm::frame::{Frame, Stamp, Summary};
use crate::swarm::history::History;
use crate::swarm::journal::Progress;
use crate::swarm::membership::{News, Put};
use crate::swarm::metrics::{SwarmMetrics, Totals};
use crate::swarm::output::Output;
use crate::swarm::scheduler::CpuScheduler;
use crate::swarm::sender::{Creation, Sender};

/// A message to the thread of a swarm. Messages are handled in the order of arrival.
pub enum Message {
    /// A command.
    Command(CommandMessage),
    /// Reply with the present state.
    Query(ReplyTo),
    /// Reply with the state when a condition is met.
    Wait(Waiter),
    /// Reply with the state when a condition on measures holds.
    WaitFor(Box<ConditionWait>),
    /// Reply with a checkpoint.
    TakeCheckpoint(ReplyTo),
    /// Seek in a recording.
    Seek(Seek, Arc<Sender>, ReplyTo),
    /// Set-points of a controller, and the epoch for which they were computed if it is known; `None` if
    /// they could not be parsed.
    Put(String, Option<u64>, Option<Put>),
    /// The liveliness token of a controller is gone.
    TokenLost(String),
    /// The liveliness token of a controller is declared.
    TokenDeclared(String),
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
    /// The user whose places it takes; `None` without users, and if it is replayed.
    pub user: Option<User>,
    /// Receives the reply.
    pub reply_to: ReplyTo,
}

/// A query that waits for a condition.
pub struct Waiter {
    /// The condition.
    pub condition: WaitCondition,
    /// Whether the client no longer waits for the reply.
    pub is_abandoned: Box<dyn Fn() -> bool + Send>,
    /// Receives the state.
    pub reply_to: ReplyTo,
}

/// A query that waits for a condition on measures.
pub struct ConditionWait {
    /// What it waits for.
    pub awaited: Awaited,
    /// Whether the query has a reply, or its client is gone.
    pub is_abandoned: Box<dyn Fn() -> bool + Send>,
    /// Receives the state.
    pub reply_to: ReplyTo,
}

/// The outcome of a message.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// Done, without a result.
    Done,
    /// A condition waits, or holds already.
    Waits {
        /// Whether it holds already.
        holds: bool,
        /// The id of the condition that waits.
        id: Option<String>,
    },
    /// The swarm runs to this step at this rate.
    Runs(Option<u64>, Rate),
    /// The swarm took steps, fewer than requested if another command interrupted them.
    Stepped {
        /// How many.
        steps: u64,
        /// The last step that a crash does not undo.
        durable_step: u64,
        /// The state reached.
        frame: Arc<Frame>,
    },
    /// A controller has joined.
    Joined {
        /// The individuals it steers.
        ids: Vec<u32>,
        /// What has happened since it left.
        news: News,
    },
    /// The swarm took steps since a controller advanced, fewer than requested if another command
    /// interrupted them.
    Advanced {
        /// How many.
        steps: u64,
        /// The last step that a crash does not undo.
        durable_step: u64,
        /// The state reached.
        frame: Arc<Frame>,
        /// What has happened since the last reply to the controller.
        news: News,
    },
    /// The whole state.
    Checkpoint(Box<Checkpoint>),
    /// The swarm is back at its start.
    Reset(Arc<Frame>),
    /// A change was applied; how many states a second are published at most now.
    Changed(ChangeOutcome, f64),
    /// The changes of a batch were applied.
    Batch(Vec<(ChangeKind, ChangeOutcome)>),
    /// The command will be executed at this step.
    Scheduled(u64),
    /// The present state.
    State(Arc<Frame>),
}

/// The outcome and the stamp of the swarm after it, or the rejection.
pub type SwarmReply = Result<(Stamp, Outcome), Rejection>;

/// A rejected message.
#[derive(Debug)]
pub struct Rejection {
    /// The step of the swarm, if it has received the message.
    pub step: Option<u64>,
    /// Why.
    pub error: SwarmError,
}

/// Where the reply to a message goes. If it is dropped, the reply is [`SwarmError::Gone`]: the swarm
/// ended before it received the message.
pub struct ReplyTo(Option<Box<dyn FnOnce(SwarmReply) + Send>>);

impl ReplyTo {
    /// Calls `reply` with the reply.
    pub fn new(reply: impl FnOnce(SwarmReply) + Send + 'static) -> Self {
        ReplyTo(Some(Box::new(reply)))
    }

    /// Ignores the reply.
    pub fn ignored() -> Self {
        ReplyTo(None)
    }

    /// Takes it; a later reply is ignored.
    #[must_use]
    pub fn take(&mut self) -> Self {
        ReplyTo(self.0.take())
    }

    /// Replies.
    pub fn send(mut self, reply: SwarmReply) {
        if let Some(callback) = self.0.take() {
            callback(reply);
        }
    }
}

/// A reply that is known but not sent yet: clients cannot reach the new swarm yet, or can still reach
/// the deleted one.
pub struct DeferredReply {
    reply_to: ReplyTo,
    reply: Box<SwarmReply>,
}

impl DeferredReply {
    /// Defers `reply`.
    pub fn new(reply_to: ReplyTo, reply: SwarmReply) -> Self {
        DeferredReply {
            reply_to,
            reply: Box::new(reply),
        }
    }

    /// Sends the reply.
    pub fn send(self) {
        self.reply_to.send(*self.reply);
    }
}

impl Drop for ReplyTo {
    fn drop(&mut self) {
        if let Some(reply) = self.0.take() {
            let error = SwarmError::Gone;
            reply(Err(Rejection { step: None, error }));
        }
    }
}

/// The last step in the summary of a swarm.
pub struct LastStep(Arc<Mutex<Option<Summary>>>);

impl LastStep {
    /// The step; `None` until the swarm is built.
    pub fn get(&self) -> Option<u64> {
        Some(self.0.lock().as_ref()?.stamp.step)
    }
}

/// What is known of a swarm beside its state.
#[derive(Debug, Default)]
pub struct Record {
    /// The request that created it; `None` if it is not known.
    pub creation: Option<Arc<Creation>>,
    /// Its number in the store: set once it is stored, never of a playback.
    pub swarm_id: OnceLock<u64>,
}

/// A handle of a swarm. Clones refer to the same swarm.
#[derive(Clone)]
pub struct Handle {
    /// What it was created from.
    pub spec: Arc<Spec>,
    /// What is known of it beside its state.
    pub record: Arc<Record>,
    /// Its frames and events for the publisher.
    pub output: Arc<Output>,
    /// Its past events and applied commands.
    pub history: Arc<History>,
    /// Its metrics.
    pub metrics: Arc<SwarmMetrics>,
    pub(crate) messages: Arc<SyncSender<Message>>,
    pub(crate) cores: Arc<CpuScheduler>,
    pub(crate) summary: Arc<Mutex<Option<Summary>>>,
    pub(crate) progress: Arc<Mutex<Progress>>,
}

impl Handle {
    /// A handle of a swarm outside the registry, with a core of its own and no name.
    pub(crate) fn alone(spec: Spec) -> Self {
        let (messages, _) = sync_channel(1);
        Handle {
            spec: Arc::new(spec),
            record: Arc::default(),
            output: Arc::new(Output::new(String::new())),
            history: Arc::default(),
            metrics: Arc::default(),
            messages: Arc::new(messages),
            cores: Arc::new(CpuScheduler::new(1)),
            summary: Arc::default(),
            progress: Arc::default(),
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

    /// Queues a message without a reply, and returns it if the queue is full.
    #[expect(clippy::result_large_err, reason = "the caller passes it on later")]
    pub fn offer(&self, message: Message) -> Result<(), Message> {
        match self.messages.try_send(message) {
            Err(TrySendError::Full(message)) => Err(message),
            // A swarm that has ended needs no message.
            Ok(()) | Err(TrySendError::Disconnected(_)) => Ok(()),
        }
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

    /// The user to whom it belongs; `None` is nobody.
    pub(crate) fn owner(&self) -> Option<&str> {
        self.record.creation.as_ref()?.owner.as_deref()
    }

    /// Logs who created it.
    pub(crate) fn log_creation(&self) {
        if let Some(creation) = &self.record.creation {
            let Creation { verb, client, .. } = &**creation;
            info!(swarm = self.output.name, verb, client, "created");
        }
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

    /// The last step that a crash does not undo.
    pub fn durable_step(&self) -> u64 {
        self.progress.lock().durable_step()
    }

    /// Like [`Self::step`], without keeping the queue alive.
    pub fn last_step(&self) -> LastStep {
        LastStep(self.summary.clone())
    }

    /// Its summary; `None` until it is built.
    pub fn summary(&self) -> Option<Summary> {
        self.summary.lock().clone()
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
            Message::WaitFor(wait) => wait.reply_to.send(Err(Rejection { step, error })),
            Message::Put(..)
            | Message::TokenLost(_)
            | Message::TokenDeclared(_)
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
