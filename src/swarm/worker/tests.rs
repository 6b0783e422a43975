#![expect(clippy::unwrap_used, reason = "tests")]

use std::sync::atomic::{AtomicU64, Ordering};

use jostle_physics::simulation::Spec;

use super::*;
use crate::swarm::command::When;
use crate::swarm::handle::CommandMessage;
use crate::swarm::journal::{Entry, PendingDurableStep};

/// Counts checkpoints.
#[derive(Default)]
struct Counting(AtomicU64);

impl JournalWriter for Counting {
    fn commit(&self, entries: Vec<Entry>) -> Result<(), WriteFault> {
        self.append(entries, None);
        Ok(())
    }

    fn append(&self, entries: Vec<Entry>, pending: Option<PendingDurableStep>) {
        let checkpoints = entries
            .iter()
            .filter(|it| matches!(it, Entry::Checkpoint(_)));
        self.0
            .fetch_add(checkpoints.count() as u64, Ordering::Relaxed);
        if let Some(pending) = pending {
            pending.mark_durable();
        }
    }
}

#[test]
fn notes_cost_no_checkpoint_and_other_commands_do() {
    for (command, expected) in [(Command::Annotate, 0), (Command::Pause, 2)] {
        let handle = Handle::alone(Spec::new(6, 1));
        let start = Checkpoint::start(Simulation::new(&handle.spec).unwrap().checkpoint());
        let counting = Arc::new(Counting::default());
        let writer = (counting.clone() as _, Box::new(|_| Ok(())) as _);
        let ignored = &|_: &_| ReplyTo::ignored();
        let mut worker = Worker::restore(start, &handle, Duration::ZERO, writer, ignored);
        for _ in 0..=2 * CHECKPOINT_INPUTS {
            let message = CommandMessage {
                command: command.clone(),
                sender: Arc::default(),
                user: None,
                when: When::default(),
                reply_to: ReplyTo::ignored(),
            };
            assert!(worker.handle(Message::Command(message)).is_none());
            worker.checkpoint_if_due(Instant::now());
        }
        assert_eq!(counting.0.load(Ordering::Relaxed), expected, "{command:?}");
    }
}
