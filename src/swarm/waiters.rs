//! Answers that wait for a swarm to get somewhere.

use crate::swarm::order::Awaited;
use crate::swarm::outcome::{Answer, Answered};
use crate::swarm::phase::Phase;

/// Answers that may wait at once.
const MOST: usize = 1024;

/// An answer that waits for something to come about.
pub struct Waiter {
    /// What is waited for.
    pub awaited: Awaited,
    /// Tells whether nobody waits for the answer any more.
    pub is_abandoned: Box<dyn Fn() -> bool + Send>,
    /// Takes the look.
    pub answer: Answer,
}

/// All that wait for one swarm.
#[derive(Default)]
pub struct Waiters(Vec<Waiter>);

impl Waiters {
    /// Takes one more in; gives it back when too many wait already.
    pub fn add(&mut self, waiter: Waiter) -> Option<Waiter> {
        self.0.retain(|waiter| !(waiter.is_abandoned)());
        if self.0.len() == MOST {
            return Some(waiter);
        }
        self.0.push(waiter);
        None
    }

    /// Answers those for whom it has come about at `step` in `phase`.
    pub fn answer(&mut self, step: u64, phase: &Phase, look: impl Fn() -> Answered) {
        let mut waiting = Vec::new();
        if !self.0.iter().any(|it| has_come(it.awaited, step, phase)) {
            return;
        }
        for waiter in std::mem::take(&mut self.0) {
            if has_come(waiter.awaited, step, phase) {
                (waiter.answer)(look());
            } else {
                waiting.push(waiter);
            }
        }
        self.0 = waiting;
    }

    /// Answers everyone, whatever they wait for.
    pub fn answer_all(&mut self, look: impl Fn() -> Answered) {
        for waiter in self.0.drain(..) {
            (waiter.answer)(look());
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
