//! Queries that wait for a condition.

use std::time::Instant;

use crate::swarm::command::WaitCondition;
use crate::swarm::error::SwarmError;
use crate::swarm::handle::{Rejection, SwarmReply, Waiter};
use crate::swarm::phase::Phase;

/// Queries that may wait at once.
const MAX_WAITERS: usize = 1024;

/// What became of the condition with an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventStatus {
    /// It waits.
    Waits,
    /// It held, by the history.
    Held,
    /// Neither.
    Unknown,
}

/// The waiting queries of one swarm with the time since when each waits, the oldest first.
#[derive(Default)]
pub struct Waiters(Vec<(Instant, Waiter)>);

impl Waiters {
    pub fn add(&mut self, waiter: Waiter) {
        self.0.retain(|(_, waiter)| !(waiter.is_abandoned)());
        self.0.push((Instant::now(), waiter));
    }

    /// Replies to the queries whose condition is met at `step` in `phase`. If too many wait, the oldest
    /// gets an error: `get/wait` does not name its client, so the limit cannot apply to each client,
    /// and one client must not keep the others from waiting.
    /// `event` says what became of the condition with an event.
    pub fn reply(
        &mut self,
        step: u64,
        phase: &Phase,
        state: impl Fn() -> SwarmReply,
        event: impl Fn(&str) -> EventStatus,
    ) {
        let is_met = |(_, waiter): &mut (Instant, Waiter)| match &waiter.condition {
            WaitCondition::Event(name) => {
                matches!(phase, Phase::Faulted(_)) || event(name) == EventStatus::Held
            }
            other => is_met(other, step, phase),
        };
        for (_, waiter) in self.0.extract_if(.., is_met) {
            waiter.reply_to.send(state());
        }
        let is_gone = |(_, waiter): &mut (Instant, Waiter)| match &waiter.condition {
            WaitCondition::Event(name) => event(name) == EventStatus::Unknown,
            _ => false,
        };
        for (_, waiter) in self.0.extract_if(.., is_gone) {
            if let WaitCondition::Event(name) = waiter.condition {
                let (step, error) = (Some(step), SwarmError::NoEvent(name));
                waiter.reply_to.send(Err(Rejection { step, error }));
            }
        }
        if self.0.len() > MAX_WAITERS {
            let (since, oldest) = self.0.remove(0);
            let error = SwarmError::Displaced {
                after_secs: since.elapsed().as_secs_f64(),
                limit: MAX_WAITERS,
            };
            let step = Some(step);
            oldest.reply_to.send(Err(Rejection { step, error }));
        }
    }

    /// Rejects all queries: the swarm has ended.
    pub fn reject_all(&mut self, step: Option<u64>) {
        for (_, waiter) in self.0.drain(..) {
            let error = SwarmError::Gone;
            waiter.reply_to.send(Err(Rejection { step, error }));
        }
    }
}

fn is_met(awaited: &WaitCondition, step: u64, phase: &Phase) -> bool {
    match awaited {
        WaitCondition::Step(awaited) => step >= *awaited || !phase.is_moving(),
        WaitCondition::Reached(awaited) => step >= *awaited || matches!(phase, Phase::Faulted(_)),
        WaitCondition::Paused => matches!(phase, Phase::Paused(_)),
        WaitCondition::Running => phase.is_moving(),
        WaitCondition::Faulted => matches!(phase, Phase::Faulted(_)),
        // A playback has no conditions.
        WaitCondition::Event(_) => false,
    }
}
