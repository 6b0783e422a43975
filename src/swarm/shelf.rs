//! Where a paused swarm lies while its thread sleeps. Whoever brings a command that has it step may
//! carry that out there and then: waking the thread takes longer than a step.
//!
//! The swarm has one owner at a time, its thread or whoever holds the shelf.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard};

use crate::swarm::handle::Command;
use crate::swarm::worker::Worker;

/// A swarm's shelf.
#[derive(Default)]
pub struct Shelf {
    worker: Mutex<Option<Box<Worker>>>,
    /// Tickets that wait for the thread. They came first.
    queued: AtomicUsize,
}

impl Shelf {
    /// Counts a ticket that is handed to the thread.
    pub fn queue(&self) {
        self.queued.fetch_add(1, Ordering::AcqRel);
    }

    /// Counts a ticket less.
    pub fn unqueue(&self) {
        self.queued.fetch_sub(1, Ordering::AcqRel);
    }

    /// Puts the swarm here while its thread sleeps.
    pub fn put(&self, worker: Box<Worker>) {
        *self.lock() = Some(worker);
    }

    /// Takes it back.
    pub fn take(&self) -> Box<Worker> {
        self.lock().take().expect("only its thread takes a swarm")
    }

    /// Carries a command out, if the swarm lies here and that is done in a moment; otherwise gives
    /// it back. Returns whether the thread is to be woken all the same.
    ///
    /// # Errors
    ///
    /// The command, which is to be handed to the thread.
    pub fn carry_out(&self, command: Command) -> Result<bool, Box<Command>> {
        // Whoever holds it does so for a moment.
        let Ok(mut shelf) = self.worker.lock() else {
            return Err(Box::new(command));
        };
        match shelf.as_mut() {
            Some(worker)
                if command.order.is_carried_out_first()
                    && self.queued.load(Ordering::Acquire) == 0
                    && worker.has_a_moment() =>
            {
                Ok(worker.carry_out_here(command))
            }
            _ => Err(Box::new(command)),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Option<Box<Worker>>> {
        // What a defect left half done ends its thread too, like any defect there.
        self.worker.lock().expect("no defect showed on the shelf")
    }
}
