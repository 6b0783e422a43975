//! A queue of deadlines, in a task of its own.

use std::collections::HashMap;
use std::future::poll_fn;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio_util::time::DelayQueue;

/// What happens at a deadline.
pub trait Expire: Send + 'static {
    /// Called when the deadline passes. It must not block.
    fn expire(self);
}

/// Deadlines. Clones share the queue.
pub struct Deadlines<T> {
    messages: UnboundedSender<Message<T>>,
    newest: Arc<AtomicU64>,
}

/// Identifies a deadline.
#[derive(Clone, Copy)]
pub struct DeadlineId(u64);

enum Message<T> {
    Add(u64, Instant, T),
    Remove(u64),
}

impl<T> Clone for Deadlines<T> {
    fn clone(&self) -> Self {
        Deadlines {
            messages: self.messages.clone(),
            newest: self.newest.clone(),
        }
    }
}

impl<T: Expire> Deadlines<T> {
    /// Starts the task, which runs until the last clone is dropped.
    pub fn start() -> Self {
        let (messages, receiver) = unbounded_channel();
        tokio::spawn(run(receiver));
        Deadlines {
            messages,
            newest: Arc::default(),
        }
    }

    /// Adds a deadline.
    pub fn add(&self, at: Instant, entry: T) -> DeadlineId {
        let id = self.newest.fetch_add(1, Ordering::Relaxed);
        // An error means that the runtime is shutting down.
        let _ = self.messages.send(Message::Add(id, at, entry));
        DeadlineId(id)
    }

    /// Removes a deadline, unless it has passed.
    pub fn remove(&self, id: DeadlineId) {
        let _ = self.messages.send(Message::Remove(id.0));
    }
}

async fn run<T: Expire>(mut messages: UnboundedReceiver<Message<T>>) {
    let mut queue = DelayQueue::new();
    let mut keys = HashMap::new();
    loop {
        tokio::select! {
            message = messages.recv() => match message {
                Some(Message::Add(id, at, entry)) => {
                    keys.insert(id, queue.insert_at((id, entry), at.into()));
                }
                Some(Message::Remove(id)) => {
                    if let Some(key) = keys.remove(&id) {
                        queue.remove(&key);
                    }
                }
                None => return,
            },
            Some(expired) = poll_fn(|context| queue.poll_expired(context)), if !queue.is_empty() => {
                let (id, entry) = expired.into_inner();
                keys.remove(&id);
                entry.expire();
            }
        }
    }
}
