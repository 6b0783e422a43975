//! A controller that has joined a swarm.

use std::time::{Duration, Instant};

use crate::suspension::GRACE;
use crate::swarm::handle::ReplyTo;
use crate::swarm::membership::{ControllerState, Mode, Put, Puts};

/// What runs out for controllers depends on this, too.
#[derive(Clone, Copy, Debug, Default)]
pub struct TimeLimits {
    /// How long the swarm waits for a controller in lock-step that sends nothing.
    pub max_idle: Option<Duration>,
    /// When the daemon resumed after it was suspended: no time before that counts.
    pub resumed: Option<Instant>,
}

/// What has run out for a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Expiry {
    /// Its deadline, or the lease of its set-points.
    Deadline,
    /// The time to declare its liveliness token again.
    Lost,
    /// The time for which it may hold the swarm and send nothing.
    Idle,
}

pub struct Member {
    pub state: ControllerState,
    pub reply_to: Option<ReplyTo>,
    /// Since when the swarm waits for it, or the time of its last put.
    pub since: Option<Instant>,
    /// Since when it holds the swarm in lock-step without having sent anything.
    pub silent_since: Option<Instant>,
    /// Since when it may declare its liveliness token again: after [`GRACE`] without one it is lost.
    pub away_since: Option<Instant>,
    /// Set-points for the next step.
    pub put: Option<Put>,
    /// The number of the newest set-points that were applied; unknown after a restart, and since its mode
    /// changed, until the next ones.
    pub applied: Option<u64>,
    pub puts: Puts,
}

impl Member {
    pub fn new(state: ControllerState, reply_to: Option<ReplyTo>) -> Self {
        Member {
            state,
            reply_to,
            since: None,
            silent_since: None,
            away_since: None,
            put: None,
            applied: None,
            puts: Puts::default(),
        }
    }

    /// Whether the swarm steps only when it has advanced.
    pub fn is_lockstep(&self) -> bool {
        self.state.settings.mode == Mode::Lockstep
    }

    /// The number of its newest set-points, if they hold and it is known. An `advance` has none.
    pub fn sequence_in_force(&self) -> Option<u64> {
        let holds = !self.is_lockstep() && !self.state.steered.is_empty();
        self.applied.filter(|_| holds)
    }

    /// Whether its deadline or lease runs at `step`. `is_waiting`: a controller has advanced beyond `step`.
    pub fn is_awaited(&self, step: u64, is_waiting: bool) -> bool {
        match self.state.settings.mode {
            Mode::Lockstep => is_waiting && self.state.target <= step,
            // The lease begins at the last put, as long as its set-points hold.
            Mode::FreeRunning => !self.state.steered.is_empty() && self.state.misses == 0,
        }
    }

    /// Whether the swarm in lock-step cannot step beyond `step` without it.
    pub fn holds(&self, step: u64) -> bool {
        self.is_lockstep() && self.state.target <= step
    }

    /// Notes that it has sent something, or has connected again: `max_idle` starts again.
    pub fn heard(&mut self, now: Instant) {
        self.silent_since = self.silent_since.map(|_| now);
    }

    /// What runs out next for it, and when.
    pub fn due(&self, limits: &TimeLimits) -> Option<(Instant, Expiry)> {
        let resumed = limits.resumed;
        let from = |since: Instant| resumed.map_or(since, |resumed| since.max(resumed));
        // Without a connection it cannot send anything.
        if let Some(since) = self.away_since {
            return Some((from(since) + GRACE, Expiry::Lost));
        }
        let deadline = self.since.map(|since| {
            let due = from(since) + self.state.settings.deadline;
            (due, Expiry::Deadline)
        });
        let silent = self.silent_since.zip(limits.max_idle);
        let silent = silent.map(|(since, max)| (from(since) + max, Expiry::Idle));
        [deadline, silent]
            .into_iter()
            .flatten()
            .min_by_key(|it| it.0)
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
