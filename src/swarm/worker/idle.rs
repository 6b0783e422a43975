//! What a swarm does while it is paused and its thread sleeps: whoever brings a command that has it
//! step has it go on at once, and whoever makes a change safe has it made.

use std::time::{Duration, Instant};

use crate::swarm::crash;
use crate::swarm::handle::Command;
use crate::swarm::journal::{Begun, Record, WriteFault};
use crate::swarm::order::{Change, Order};
use crate::swarm::outcome::OrderError;
use crate::swarm::phase::Phase;
use crate::swarm::worker::Worker;

/// The longest that is computed here, by the length of the last step: whoever does it reads what
/// everybody sends.
const MOMENT: Duration = Duration::from_micros(100);

/// The most individuals of whom something is changed here.
const FEW: usize = 256;

/// A command that is being made safe, and the swarm that it is for.
struct Underway<Back: FnOnce(Box<Worker>, bool)>(Option<(Box<Worker>, Command, Begun, Back)>);

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
            && self.outlet.has_room()
            && began.elapsed().saturating_add(self.step_took) <= MOMENT
        {
            end = self.step();
        }
        debug_assert!(
            end.is_none(),
            "nothing is scheduled, and no advance ends a swarm"
        );
        self.is_to_be_woken()
    }

    /// Whether a command that is to be safe first is then carried out in a moment, and its swarm
    /// goes on lying idle.
    pub fn is_done_at_once(&self, command: &Command) -> bool {
        let is_short = match &command.order {
            // Other bodies, or others that may cross: every pair is looked at.
            Order::Change(Change::Set(new)) => new.pi1.is_none() && new.contacts.is_none(),
            Order::Change(Change::Inform { .. } | Change::Uninform(_)) => true,
            _ => false,
        };
        is_short && command.when.at_step.is_none() && self.n() <= FEW
    }

    /// Has a command made safe, upon which whoever tells so carries it out: nobody waits. `back`
    /// takes the swarm then, and whether its thread is to be woken.
    pub fn carry_out_when_safe(
        mut self: Box<Self>,
        command: Command,
        back: impl FnOnce(Box<Worker>, bool) + Send + 'static,
    ) {
        self.tally.pulse.beat();
        if let Err(error) = self.check(&command.order, command.when) {
            (command.answer)(Err(self.refusal(error)));
            let is_to_wake = self.is_to_be_woken();
            return back(self, is_to_wake);
        }
        let record = Record::Input {
            at_step: None,
            sender: command.sender.clone(),
            seq: None,
            unix_secs: self.unix_secs(),
        };
        let at = self.at();
        let (write, begun) = self.journal.commit_then(at, vec![record]);
        let mut underway = Underway(Some((self, command, begun, back)));
        write(Box::new(move |result| underway.end(result)));
    }

    /// Rests. Returns whether its thread is to be woken, to go on or to wake earlier than it would.
    fn is_to_be_woken(&mut self) -> bool {
        self.keep_if_due(Instant::now());
        self.tally.pulse.rest();
        let wakes_later = |due| self.wakes_at.is_none_or(|at| at > due);
        self.phase.is_moving() || self.controllers.due().is_some_and(wakes_later)
    }
}

impl<Back: FnOnce(Box<Worker>, bool)> Underway<Back> {
    fn end(&mut self, result: Result<(), WriteFault>) {
        let Some((mut worker, command, begun, back)) = self.0.take() else {
            return;
        };
        match worker.journal.committed(begun, result) {
            Ok(input) => {
                crash::point("swarm-safe");
                worker.is_lent = true;
                // Whoever asked is answered before others are shown what has changed.
                let outlet = worker.outlet.clone();
                let end = outlet.ring_after(|| worker.command(input, None, command));
                worker.is_lent = false;
                debug_assert!(end.is_none(), "no change ends a swarm");
            }
            Err(fault) => {
                let refusal = worker.refusal(OrderError::Unsafe(fault));
                (command.answer)(Err(refusal));
            }
        }
        let is_to_wake = worker.is_to_be_woken();
        back(worker, is_to_wake);
    }
}

impl<Back: FnOnce(Box<Worker>, bool)> Drop for Underway<Back> {
    /// Nobody told whether it is safe.
    fn drop(&mut self) {
        self.end(Err(WriteFault::Failed("the daemon is stopping".into())));
    }
}
