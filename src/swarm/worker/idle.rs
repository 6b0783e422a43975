//! What a swarm does while it is paused and its thread sleeps: whoever brings a command that has it
//! step has it go on at once.

use std::time::{Duration, Instant};

use crate::swarm::handle::Command;
use crate::swarm::phase::Phase;
use crate::swarm::worker::Worker;

/// The longest that is computed here, by the length of the last step: whoever does it reads what
/// everybody sends.
const MOMENT: Duration = Duration::from_micros(100);

impl Worker {
    /// Whether it goes on only when it is told to.
    pub(super) fn lies_idle(&self) -> bool {
        matches!(self.phase, Phase::Paused(_))
    }

    /// Whether it can take a command at once, neither waiting for the disk nor with anything else
    /// to be done first.
    pub fn has_a_moment(&self) -> bool {
        let is_due = |due| due <= Instant::now();
        self.schedule.count() == 0
            && !self.journal.is_far_ahead()
            && !self.controllers.due().is_some_and(is_due)
    }

    /// Carries out a command that need not be safe before, and takes the steps it leads to if they
    /// are short.
    /// Returns whether its thread is to be woken, to go on or to wake earlier than it would.
    pub fn carry_out_here(&mut self, command: Command) -> bool {
        self.tally.pulse.beat();
        let mut end = self.commands(vec![command]);
        let began = Instant::now();
        while let Phase::Stepping { .. } = self.phase
            && end.is_none()
            && self.seat.is_needless()
            && began.elapsed().saturating_add(self.step_took) <= MOMENT
        {
            end = self.step();
        }
        debug_assert!(
            end.is_none(),
            "nothing is scheduled, and no advance ends a swarm"
        );
        self.keep_if_due(Instant::now());
        self.tally.pulse.rest();
        let wakes_later = |due| self.wakes_at.is_none_or(|at| at > due);
        self.phase.is_moving() || self.controllers.due().is_some_and(wakes_later)
    }
}
