//! What the registry of swarms hosts and calls, without naming who implements it.

use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::Duration;

use jostle_physics::simulation::Spec;

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::{SwarmError, WriteFault};
use crate::swarm::frame::{Frame, Stamp};
use crate::swarm::handle::{DeferredReply, Handle, Message};
use crate::swarm::journal::JournalWriter;
use crate::swarm::sender::Creation;

/// Persists a new swarm before any client learns of it: its name, its spec and its checkpoint.
pub trait PersistNew: Send {
    /// Returns once the swarm is durable, together with the reply to the request that created it: the
    /// number of the swarm in the store, if that can be read.
    fn persist(
        self: Box<Self>,
        creation: Option<&Creation>,
        checkpoint: &Checkpoint,
        stamp: &Stamp,
        frame: &Arc<Frame>,
    ) -> Result<Option<u64>, WriteFault>;
}

/// Opens the journals of swarms.
pub trait JournalFactory: Send + Sync {
    /// The writer of one swarm's journal.
    fn open(&self, swarm: &str) -> Arc<dyn JournalWriter>;
}

/// Why the thread of a swarm ended.
pub enum End {
    /// The swarm was deleted. The reply is sent once clients can no longer reach it.
    Deleted(DeferredReply),
    /// The daemon is stopping.
    Stopped,
}

/// A swarm or a playback, as its thread runs it.
pub trait Runner {
    /// Steps and handles messages until it ends.
    fn run(self: Box<Self>, messages: &Receiver<Message>) -> End;
}

/// The first state of a swarm or a playback, and what its thread runs.
pub type Built = ((Stamp, Arc<Frame>), Box<dyn Runner>);

/// A recording that can be played as if it were a swarm.
pub trait Playback: Send {
    /// The spec of the recorded swarm.
    fn spec(&self) -> &Spec;
    /// The memory to reserve for it, in bytes.
    fn memory_bytes(&self) -> u64;
    /// Starts at the first frame, paused. Frames are published `min_interval` apart or more.
    fn start(self: Box<Self>, handle: &Handle, min_interval: Duration)
    -> Result<Built, SwarmError>;
}

/// Lifecycle callbacks of swarms, called on the thread of the swarm.
pub trait SwarmObserver: Send + Sync {
    /// The swarm is built. The observer sends `reply` once clients can reach it.
    fn started(&self, name: &str, reply: DeferredReply);
    /// The swarm has ended. The observer releases the name and sends `reply` once clients can no
    /// longer reach it.
    fn ended(&self, name: &str, reply: DeferredReply);
}
