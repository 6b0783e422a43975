//! A queue of deadlines, in a task of its own.

use std::future::poll_fn;
use std::time::Instant;

use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio_util::time::DelayQueue;

/// What happens at a deadline.
pub trait Expire: Send + 'static {
    /// Called when the deadline passes. It must not block.
    fn expire(self);
}

/// Deadlines. One that no longer matters stays in the queue until it passes, so an entry must not
/// keep its request alive. Clones share the queue.
pub struct Deadlines<T>(UnboundedSender<(Instant, T)>);

impl<T> Clone for Deadlines<T> {
    fn clone(&self) -> Self {
        Deadlines(self.0.clone())
    }
}

impl<T: Expire> Deadlines<T> {
    /// Starts the task, which runs until the last clone is dropped.
    pub fn start() -> Self {
        let (sender, receiver) = unbounded_channel();
        tokio::spawn(run(receiver));
        Deadlines(sender)
    }

    /// Adds a deadline.
    pub fn add(&self, at: Instant, entry: T) {
        // An error means that the runtime is shutting down.
        let _ = self.0.send((at, entry));
    }
}

async fn run<T: Expire>(mut added: UnboundedReceiver<(Instant, T)>) {
    let mut queue = DelayQueue::new();
    loop {
        tokio::select! {
            entry = added.recv() => match entry {
                Some((at, entry)) => drop(queue.insert_at(entry, at.into())),
                None => return,
            },
            Some(expired) = poll_fn(|context| queue.poll_expired(context)), if !queue.is_empty() => {
                expired.into_inner().expire();
            }
        }
    }
}
