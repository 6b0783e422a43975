//! What a swarm answers: what an order came to, or why it came to nothing.

use std::sync::Arc;

use jostle_physics::simulation::{ChangeKind, ChangeOutcome, Rate};

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::{Frame, Place};
use crate::swarm::membership::News;

/// What an order came to.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// Nothing more to say.
    Done,
    /// It runs to this step at this rate.
    Runs(Option<u64>, Rate),
    /// It took this many steps, fewer than asked for if another command came between.
    Stepped {
        /// How many.
        steps: u64,
        /// The last step that a crash would not take back.
        safe_step: u64,
        /// Where it arrived.
        seen: Arc<Frame>,
    },
    /// The controller steers these, and this is news to it.
    Joined {
        /// Whom.
        ids: Vec<u32>,
        /// What came about since it was last there.
        news: News,
    },
    /// It took this many steps since the controller advanced, fewer than it wanted if another
    /// command came between.
    Advanced {
        /// How many.
        steps: u64,
        /// The last step that a crash would not take back.
        safe_step: u64,
        /// Where it arrived.
        seen: Arc<Frame>,
        /// What came about since the controller was last told.
        news: News,
    },
    /// It is this, as a whole.
    Whole(Box<Checkpoint>),
    /// It is back at its start.
    Reset(Arc<Frame>),
    /// A change was applied.
    Changed(ChangeOutcome),
    /// The changes of a batch were applied.
    Batch(Vec<(ChangeKind, ChangeOutcome)>),
    /// It will be carried out at this step.
    Scheduled(u64),
    /// A look at it.
    Seen(Arc<Frame>),
}

/// What an order came to and where the swarm then was; or why it came to nothing.
pub type SwarmReply = Result<(Place, Outcome), Rejection>;

/// An order that was not carried out.
#[derive(Debug)]
pub struct Rejection {
    /// The step the swarm was at, if it was reached.
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

    /// Replies.
    pub fn send(mut self, answered: SwarmReply) {
        if let Some(reply) = self.0.take() {
            reply(answered);
        }
    }
}

/// A reply that is known but not sent yet: clients cannot reach the new swarm yet, or can still reach
/// the deleted one.
pub struct DeferredReply {
    answer: ReplyTo,
    answered: Box<SwarmReply>,
}

impl DeferredReply {
    /// Keeps `answered` for `answer`.
    pub fn new(answer: ReplyTo, answered: SwarmReply) -> Self {
        DeferredReply {
            answer,
            answered: Box::new(answered),
        }
    }

    /// Sends the reply.
    pub fn send(self) {
        self.answer.send(*self.answered);
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
