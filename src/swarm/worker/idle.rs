//! What a swarm does while it is paused and its thread sleeps: whoever brings a command that has it
//! step has it go on at once, and whoever makes a change safe has it made.

use std::time::{Duration, Instant};

use jostle_physics::simulation::Change;

use crate::swarm::crash;
use crate::swarm::handle::Command;
use crate::swarm::journal::{Begun, Record, WriteFault};
use crate::swarm::order::Order;
use crate::swarm::outcome::OrderError;
use crate::swarm::phase::Phase;
use crate::swarm::worker::Worker;

/// The longest that is computed here, by the length of the last step: whoever does it reads what
/// everybody sends.
///
/// Unit tests judge on which thread a step is taken, not how long a busy machine takes for it.
const MOMENT: Duration = match cfg!(test) {
    true => Duration::from_secs(3600),
    false => Duration::from_micros(100),
};

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

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::mpsc::{Receiver, channel};

    use super::*;
    use crate::swarm::control::{Mode, OnTimeout, Terms};
    use crate::swarm::handle::Handle;
    use crate::swarm::journal::to_nowhere;
    use crate::swarm::order::{Sender, When};
    use crate::swarm::outcome::Answered;
    use crate::swarm::shelf::Shelf;
    use jostle_physics::model::selection::Selection;
    use jostle_physics::simulation::{Simulation, Spec};

    /// A swarm that lies on its shelf. No thread of its own takes it from there: what would wake
    /// one is counted.
    struct Idle {
        shelf: Arc<Shelf>,
        wakes: Arc<AtomicUsize>,
    }

    impl Idle {
        fn new(prepare: impl FnOnce(&mut Worker)) -> Self {
            let spec = Spec::new(4, 1);
            let handle = Handle::alone(spec.clone());
            let simulation = Simulation::new(&spec).unwrap();
            let mut worker = Worker::new(simulation, &handle, Duration::ZERO, to_nowhere());
            // As after a first step.
            worker.step_took = Duration::ZERO;
            prepare(&mut worker);
            handle.shelf.put(Box::new(worker));
            Idle {
                shelf: handle.shelf,
                wakes: Arc::default(),
            }
        }

        /// Has the shelf execute a command. Returns where its reply goes.
        fn send(&self, order: Order) -> Receiver<Answered> {
            let (answer, answered) = channel();
            let command = Command {
                order,
                when: When::default(),
                sender: Arc::new(Sender::default()),
                answer: Box::new(move |it| answer.send(it).unwrap()),
            };
            let wakes = self.wakes.clone();
            let wake = move || {
                wakes.fetch_add(1, Ordering::Relaxed);
            };
            assert!(self.shelf.carry_out(command, wake).is_ok());
            answered
        }

        fn wakes(&self) -> usize {
            self.wakes.load(Ordering::Relaxed)
        }

        /// Looks at the swarm, or changes it as its thread does.
        fn with<T>(&self, look: impl FnOnce(&mut Worker) -> T) -> T {
            let mut worker = self.shelf.take();
            let seen = look(&mut worker);
            self.shelf.put(worker);
            seen
        }
    }

    fn step(answered: &Receiver<Answered>) -> u64 {
        let (place, _) = answered.try_recv().unwrap().unwrap();
        place.step
    }

    #[test]
    fn a_thousand_short_steps_wake_no_thread() {
        let idle = Idle::new(|_| {});
        for k in 1..=1000 {
            assert_eq!(step(&idle.send(Order::Step(1))), k);
            assert_eq!(idle.wakes(), 0, "after step {k}");
        }
    }

    #[test]
    fn a_thousand_exchanges_of_two_controllers_wake_its_thread_for_the_first_deadline_alone() {
        let controllers = ["ada", "bob"];
        let idle = Idle::new(|worker| {
            for (controller, id) in controllers.into_iter().zip(0..) {
                let terms = Terms {
                    controller: controller.to_owned(),
                    selection: Some(Selection::Ids(vec![id])),
                    mode: Mode::Lockstep,
                    deadline: Duration::from_secs(60),
                    on_timeout: OnTimeout::Hold,
                    driving: false,
                    again: false,
                };
                worker.join(&terms).unwrap();
            }
        });
        let advance = |controller: &str| Order::Advance {
            controller: controller.to_owned(),
            steps: 1,
            set: None,
        };
        for k in 1..=1000 {
            let waiting = idle.send(advance("ada"));
            assert!(
                waiting.try_recv().is_err(),
                "exchange {k}: one has advanced"
            );
            if k == 1 {
                // The thread sleeps without end: it is to wake at the deadline of the other.
                assert_eq!(idle.wakes(), 1);
                idle.with(|worker| worker.wakes_at = worker.controllers.due());
            }
            let last = idle.send(advance("bob"));
            assert_eq!([step(&last), step(&waiting)], [k, k]);
            assert_eq!(idle.wakes(), 1, "after exchange {k}");
        }
    }

    #[test]
    fn a_step_that_takes_long_is_left_to_the_thread() {
        let idle = Idle::new(|worker| worker.step_took = 2 * MOMENT);
        let answered = idle.send(Order::Step(1));
        assert_eq!(idle.wakes(), 1);
        assert!(answered.try_recv().is_err());
        assert!(idle.with(|worker| worker.phase.is_moving()));
    }
}
