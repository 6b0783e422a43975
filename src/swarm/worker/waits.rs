//! Queries that wait for a condition: evaluated after each step, on the state that it left.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

use crate::swarm::error::SwarmError;
use crate::swarm::handle::{ConditionWait, Outcome, ReplyTo};
use crate::swarm::waits::Added;
use crate::swarm::worker::Worker;

impl Worker {
    /// Begins or continues a wait. The reply follows at once if the condition has held, holds, or the swarm has
    /// faulted.
    pub(super) fn wait_for(&mut self, wait: ConditionWait) {
        let ConditionWait {
            awaited,
            is_abandoned,
            reply_to,
        } = wait;
        self.sweep_waits(Instant::now());
        if let Some((stamp, frame)) = self.waits.held(&awaited) {
            return reply_to.send(Ok((stamp, Outcome::State(frame))));
        }
        if self.is_faulted() {
            return self.end_waits(vec![reply_to]);
        }
        let (waits, state) = (&mut self.waits, &self.simulation.state);
        let added = catch_unwind(AssertUnwindSafe(|| waits.add(&awaited, state)));
        match added.unwrap_or(Err(SwarmError::Panicked)) {
            Ok(Added::Holds) => self.end_waits(vec![reply_to]),
            Ok(Added::Waits) => self.waits.attach(is_abandoned, reply_to),
            Err(error) => self.reject(reply_to, error),
        }
    }

    /// Replies with the present state.
    pub(super) fn end_waits(&self, replies: Vec<ReplyTo>) {
        if replies.is_empty() {
            return;
        }
        let (stamp, frame) = self.state_with_controllers();
        for reply_to in replies {
            reply_to.send(Ok((stamp.clone(), Outcome::State(frame.clone()))));
        }
    }

    /// Rejects all waits.
    pub(super) fn reject_waits(&mut self, error: &SwarmError) {
        for reply_to in self.waits.take_all() {
            self.reject(reply_to, error.clone());
        }
    }

    /// Ends the waits whose clients are gone.
    pub(super) fn sweep_waits(&mut self, now: Instant) {
        self.waits.sweep_if_due(now, self.simulation.state.step);
    }
}
