//! Replies of a swarm: the outcome of a message, or why it was rejected.

use std::sync::Arc;

use jostle_physics::simulation::{ChangeKind, ChangeOutcome, Rate};

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::{Frame, Stamp};
use crate::swarm::membership::News;

/// The outcome of a message.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// Done, without a result.
    Done,
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
    /// A change was applied.
    Changed(ChangeOutcome),
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
            reply(Err(Rejection {
                step: None,
                error: SwarmError::Gone,
            }));
        }
    }
}
