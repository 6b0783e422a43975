//! A queue of messages; of some kinds it keeps only the latest.

use std::mem::discriminant;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Instant;

use super::view::Message;

/// The messages to the drawing thread.
#[derive(Default)]
pub struct Mailbox {
    waiting: Mutex<Vec<Message>>,
    posted: Condvar,
}

impl Mailbox {
    /// Enqueues a message; never blocks.
    pub fn post(&self, message: Message) {
        // The queue is consistent after a panic: no code below panics while it changes it.
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        if message.is_latest_only() {
            let kind = discriminant(&message);
            waiting.retain(|earlier| discriminant(earlier) != kind);
        }
        waiting.push(message);
        self.posted.notify_one();
    }

    /// Waits for messages until `deadline` and takes all.
    pub fn take(&self, deadline: Option<Instant>) -> Vec<Message> {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        while waiting.is_empty() {
            waiting = match deadline {
                Some(deadline) => {
                    let rest = deadline.saturating_duration_since(Instant::now());
                    if rest.is_zero() {
                        break;
                    }
                    let woken = self.posted.wait_timeout(waiting, rest);
                    woken.unwrap_or_else(PoisonError::into_inner).0
                }
                None => {
                    let woken = self.posted.wait(waiting);
                    woken.unwrap_or_else(PoisonError::into_inner)
                }
            };
        }
        std::mem::take(&mut *waiting)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_list_and_all_replies_are_kept() {
        let mailbox = Mailbox::default();
        for _ in 0..3 {
            mailbox.post(Message::Swarms(Vec::new()));
            mailbox.post(Message::Outcome(Ok(String::new())));
        }
        let kinds: Vec<bool> = mailbox
            .take(None)
            .iter()
            .map(|message| matches!(message, Message::Swarms(_)))
            .collect();
        assert_eq!(kinds, [false, false, true, false]);
        assert!(mailbox.take(Some(Instant::now())).is_empty());
    }
}
