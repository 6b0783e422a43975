//! Queries that wait for a condition.

use std::collections::VecDeque;
use std::time::Instant;

use crate::swarm::command::WaitCondition;
use crate::swarm::error::SwarmError;
use crate::swarm::outcome::{ReplyTo, SwarmReply};
use crate::swarm::phase::Phase;

/// Queries that may wait at once.
const MAX_WAITERS: usize = 1024;

/// A query that waits for a condition.
pub struct Waiter {
    /// The condition.
    pub condition: WaitCondition,
    /// Whether the client no longer waits for the reply.
    pub is_abandoned: Box<dyn Fn() -> bool + Send>,
    /// Receives the state.
    pub reply_to: ReplyTo,
}

/// The waiting queries of one swarm with the time since when each waits, the oldest first.
#[derive(Default)]
pub struct Waiters(VecDeque<(Instant, Waiter)>);

impl Waiters {
    /// Adds a query.
    pub fn add(&mut self, waiter: Waiter) {
        self.0.retain(|(_, waiter)| !(waiter.is_abandoned)());
        self.0.push_back((Instant::now(), waiter));
    }

    /// If too many wait, removes the oldest and returns the error to send. `get/wait` does not name
    /// its client, so the limit cannot apply to each client, and one client must not keep the others
    /// from waiting.
    pub fn evict_oldest(&mut self) -> Option<(ReplyTo, SwarmError)> {
        if self.0.len() <= MAX_WAITERS {
            return None;
        }
        let (since, longest) = self.0.pop_front()?;
        let error = SwarmError::Displaced {
            after_secs: since.elapsed().as_secs_f64(),
            limit: MAX_WAITERS,
        };
        Some((longest.reply_to, error))
    }

    /// Replies to the queries whose condition is met at `step` in `phase`.
    pub fn reply(&mut self, step: u64, phase: &Phase, state: impl Fn() -> SwarmReply) {
        let is_met = |waiter: &Waiter| is_met(waiter.condition, step, phase);
        if !self.0.iter().any(|(_, waiter)| is_met(waiter)) {
            return;
        }
        let mut waiting = VecDeque::new();
        for (since, waiter) in std::mem::take(&mut self.0) {
            if is_met(&waiter) {
                waiter.reply_to.send(state());
            } else {
                waiting.push_back((since, waiter));
            }
        }
        self.0 = waiting;
    }

    /// Replies to all queries.
    pub fn reply_to_all(&mut self, state: impl Fn() -> SwarmReply) {
        for (_, waiter) in self.0.drain(..) {
            waiter.reply_to.send(state());
        }
    }
}

fn is_met(awaited: WaitCondition, step: u64, phase: &Phase) -> bool {
    match awaited {
        WaitCondition::Step(awaited) => step >= awaited || !phase.is_moving(),
        WaitCondition::Reached(awaited) => step >= awaited || matches!(phase, Phase::Faulted(_)),
        WaitCondition::Paused => matches!(phase, Phase::Paused(_)),
        WaitCondition::Running => phase.is_moving(),
        WaitCondition::Faulted => matches!(phase, Phase::Faulted(_)),
    }
}
