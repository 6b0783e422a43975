//! Answers that wait for a swarm to get somewhere.

use std::collections::VecDeque;
use std::time::Instant;

use crate::swarm::command::Awaited;
use crate::swarm::error::SwarmError;
use crate::swarm::outcome::{ReplyTo, SwarmReply};
use crate::swarm::phase::Phase;

/// Answers that may wait at once.
const MAX_WAITERS: usize = 1024;

/// An answer that waits for something to come about.
pub struct Waiter {
    /// What is waited for.
    pub awaited: Awaited,
    /// Tells whether nobody waits for the answer any more.
    pub is_abandoned: Box<dyn Fn() -> bool + Send>,
    /// Takes the look.
    pub answer: ReplyTo,
}

/// All that wait for one swarm, with the time since when; the one that has waited longest first.
#[derive(Default)]
pub struct Waiters(VecDeque<(Instant, Waiter)>);

impl Waiters {
    /// Adds a waiter.
    pub fn add(&mut self, waiter: Waiter) {
        self.0.retain(|(_, waiter)| !(waiter.is_abandoned)());
        self.0.push_back((Instant::now(), waiter));
    }

    /// If too many wait, removes the one that has waited longest and returns its answer with the
    /// error to send. A `get/wait` does not name its client, so the limit cannot apply to each
    /// client, and one client must not keep the others from waiting.
    pub fn displace(&mut self) -> Option<(ReplyTo, SwarmError)> {
        if self.0.len() <= MAX_WAITERS {
            return None;
        }
        let (since, longest) = self.0.pop_front()?;
        let error = SwarmError::Displaced {
            after_secs: since.elapsed().as_secs_f64(),
            limit: MAX_WAITERS,
        };
        Some((longest.answer, error))
    }

    /// Answers those for whom it has come about at `step` in `phase`.
    pub fn answer(&mut self, step: u64, phase: &Phase, look: impl Fn() -> SwarmReply) {
        let has_come = |waiter: &Waiter| has_come(waiter.awaited, step, phase);
        if !self.0.iter().any(|(_, waiter)| has_come(waiter)) {
            return;
        }
        let mut waiting = VecDeque::new();
        for (since, waiter) in std::mem::take(&mut self.0) {
            if has_come(&waiter) {
                waiter.answer.send(look());
            } else {
                waiting.push_back((since, waiter));
            }
        }
        self.0 = waiting;
    }

    /// Answers everyone, whatever they wait for.
    pub fn answer_all(&mut self, look: impl Fn() -> SwarmReply) {
        for (_, waiter) in self.0.drain(..) {
            waiter.answer.send(look());
        }
    }
}

fn has_come(awaited: Awaited, step: u64, phase: &Phase) -> bool {
    match awaited {
        Awaited::Step(awaited) => step >= awaited || !phase.is_moving(),
        Awaited::Reached(awaited) => step >= awaited || matches!(phase, Phase::Faulted(_)),
        Awaited::Paused => matches!(phase, Phase::Paused(_)),
        Awaited::Running => phase.is_moving(),
        Awaited::Faulted => matches!(phase, Phase::Faulted(_)),
    }
}
