//! A controller that has joined a swarm.

use std::time::Instant;

use crate::swarm::handle::ReplyTo;
use crate::swarm::membership::{ControllerState, Mode, Put, Puts};

pub struct Member {
    pub state: ControllerState,
    pub reply_to: Option<ReplyTo>,
    /// Since when the swarm waits for it, or the time of its last put.
    pub since: Option<Instant>,
    /// Set-points for the next step.
    pub put: Option<Put>,
    pub puts: Puts,
}

impl Member {
    pub fn new(state: ControllerState, reply_to: Option<ReplyTo>) -> Self {
        Member {
            state,
            reply_to,
            since: None,
            put: None,
            puts: Puts::default(),
        }
    }

    /// Whether the swarm steps only when it has advanced.
    pub fn is_lockstep(&self) -> bool {
        self.state.settings.mode == Mode::Lockstep
    }

    /// Whether its deadline or lease runs at `step`. `is_waiting`: a controller has advanced beyond `step`.
    pub fn is_awaited(&self, step: u64, is_waiting: bool) -> bool {
        match self.state.settings.mode {
            Mode::Lockstep => is_waiting && self.state.target <= step,
            // The lease begins at the last put, as long as its set-points hold.
            Mode::FreeRunning => !self.state.steered.is_empty() && self.state.misses == 0,
        }
    }

    /// Drops the individuals that no longer exist, and adds that to its news.
    pub fn retain_individuals(&mut self, ids: &[u32]) {
        let state = &mut self.state;
        let gone = |id: &u32| ids.binary_search(id).is_err();
        let removed = state.claims.iter().copied().filter(gone);
        state.news.removed.extend(removed);
        state.claims.retain(|id| !gone(id));
        state.steered.retain(|id| !gone(id));
    }

    /// Queues set-points, which replace older ones, and counts the outcome.
    pub fn put(&mut self, put: Option<Put>, is_current_epoch: bool) {
        match put {
            Some(put) if !self.is_lockstep() => {
                let queued = self.put.as_ref().map(|it| it.sequence);
                if put.sequence <= queued.unwrap_or(self.state.sequence) || !is_current_epoch {
                    self.puts.stale += 1;
                } else if self.put.replace(put).is_some() {
                    self.puts.overtaken += 1;
                }
            }
            _ => self.puts.rejected += 1,
        }
    }
}
