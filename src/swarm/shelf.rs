//! Where a paused swarm lies while its thread sleeps. Whoever brings a command may carry it out
//! there and then, or have the store do so as soon as it is safe: waking the thread takes longer
//! than a step.
//!
//! The swarm has one owner at a time: its thread, whoever holds the shelf, or the store.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};

use crate::swarm::handle::Command;
use crate::swarm::worker::Worker;

/// A swarm's shelf.
#[derive(Default)]
pub struct Shelf {
    place: Mutex<Place>,
    is_back: Condvar,
    /// Tickets that wait for the thread. They came first.
    queued: AtomicUsize,
}

/// What lies on a shelf.
#[derive(Default)]
enum Place {
    /// Nothing: the swarm is with its thread.
    #[default]
    Empty,
    /// The swarm.
    Taken(Box<Worker>),
    /// Nothing until the store has made a command safe and carried it out.
    Lent,
    /// What a defect left of it.
    Lost,
}

/// Brings a swarm back that was lent.
struct Loan {
    shelf: Arc<Shelf>,
    worker: Option<Box<Worker>>,
}

impl Shelf {
    /// Counts a ticket that is handed to the thread.
    pub fn queue(&self) {
        self.queued.fetch_add(1, Ordering::AcqRel);
    }

    /// Counts a ticket less.
    pub fn unqueue(&self) {
        self.queued.fetch_sub(1, Ordering::AcqRel);
    }

    /// Puts the swarm here while its thread sleeps.
    pub fn put(&self, worker: Box<Worker>) {
        *self.lock() = Place::Taken(worker);
    }

    /// Takes it back, as soon as it is there.
    pub fn take(&self) -> Box<Worker> {
        let place = self.lock();
        let place = self
            .is_back
            .wait_while(place, |place| matches!(place, Place::Lent));
        let mut place = place.expect("no defect showed on the shelf");
        match std::mem::take(&mut *place) {
            Place::Taken(worker) => worker,
            _ => panic!("a defect showed while the swarm was away"),
        }
    }

    /// Carries a command out, if the swarm lies here and that is done in a moment, or once it is
    /// safe; otherwise gives it back. `wake` is called if the thread is to be woken all the same.
    ///
    /// # Errors
    ///
    /// The command, which is to be handed to the thread.
    pub fn carry_out(
        self: &Arc<Self>,
        command: Command,
        wake: impl FnOnce() + Send + 'static,
    ) -> Result<(), Box<Command>> {
        // Whoever holds it does so for a moment.
        let Ok(mut place) = self.place.lock() else {
            return Err(Box::new(command));
        };
        let Place::Taken(worker) = &mut *place else {
            return Err(Box::new(command));
        };
        if self.queued.load(Ordering::Acquire) > 0 || !worker.has_a_moment() {
            return Err(Box::new(command));
        }
        if command.order.is_carried_out_first() {
            if worker.carry_out_here(command) {
                wake();
            }
            return Ok(());
        }
        if !worker.is_done_at_once(&command) {
            return Err(Box::new(command));
        }
        let Place::Taken(worker) = std::mem::replace(&mut *place, Place::Lent) else {
            unreachable!("it lay here just now");
        };
        drop(place);
        let mut loan = Loan {
            shelf: self.clone(),
            worker: None,
        };
        worker.carry_out_when_safe(command, move |worker, is_to_wake| {
            loan.worker = Some(worker);
            drop(loan);
            if is_to_wake {
                wake();
            }
        });
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Place> {
        // What a defect left half done ends its thread too, like any defect there.
        self.place.lock().expect("no defect showed on the shelf")
    }
}

impl Drop for Loan {
    fn drop(&mut self) {
        *self.shelf.lock() = self.worker.take().map_or(Place::Lost, Place::Taken);
        self.shelf.is_back.notify_all();
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::sync::mpsc::{Receiver, channel};
    use std::time::Duration;

    use super::*;
    use crate::swarm::handle::Handle;
    use crate::swarm::journal::{Done, Wanted, WriteFault, Writer};
    use crate::swarm::order::{Order, Sender, When};
    use crate::swarm::outcome::{Answered, OrderError};
    use jostle_physics::simulation::{Change, Settings, Simulation, Spec};

    /// A swarm on its shelf, and what its store is asked to make safe and tell of.
    fn shelf() -> (Arc<Shelf>, Receiver<Done>) {
        let spec = Spec::new(2, 1);
        let handle = Handle::alone(spec.clone());
        let (asked, store) = channel();
        let writer: Writer = Arc::new(move |_, wanted| {
            if let Wanted::InPassing(done) = wanted {
                asked.send(done).unwrap();
            }
        });
        let simulation = Simulation::new(&spec).unwrap();
        let worker = Worker::new(simulation, &handle, Duration::ZERO, writer);
        handle.shelf.put(Box::new(worker));
        (handle.shelf, store)
    }

    /// A command to it, and what it is answered.
    fn command(order: Order) -> (Command, Receiver<Answered>) {
        let (answer, answered) = channel();
        let command = Command {
            order,
            when: When::default(),
            sender: Arc::new(Sender::default()),
            answer: Box::new(move |it| answer.send(it).unwrap()),
        };
        (command, answered)
    }

    fn set(new: Settings) -> Order {
        Order::Change(Change::Set(new))
    }

    fn pi2(value: f64) -> Order {
        set(Settings {
            pi2: Some(value),
            ..Settings::default()
        })
    }

    #[test]
    fn a_change_is_made_by_whoever_tells_that_it_is_safe_and_nothing_else_meanwhile() {
        let (shelf, store) = shelf();
        let (first, answered) = command(pi2(0.7));
        assert!(shelf.carry_out(first, || {}).is_ok());
        assert!(answered.try_recv().is_err(), "it is not safe yet");
        // The swarm is away: whoever comes now waits for its thread, and that for the swarm.
        let (step, _) = command(Order::Step(1));
        assert!(shelf.carry_out(step, || {}).is_err());
        let taken = {
            let shelf = shelf.clone();
            std::thread::spawn(move || shelf.take().checkpoint())
        };
        store.recv().unwrap()(Ok(()));
        let (place, _) = answered.recv().unwrap().unwrap();
        let kept = taken.join().unwrap();
        assert_eq!((place.seq, kept.simulation.seq, kept.lines), (1, 1, 2));
        assert!((kept.simulation.state.parameters.pi2 - 0.7).abs() < f64::EPSILON);
    }

    #[test]
    fn what_could_not_be_made_safe_is_refused_and_changes_nothing() {
        let (shelf, store) = shelf();
        let full: fn(Done) = |done| done(Err(WriteFault::Full));
        for tell in [full, drop] {
            let (order, answered) = command(pi2(0.7));
            assert!(shelf.carry_out(order, || {}).is_ok());
            tell(store.recv().unwrap());
            let refusal = answered.recv().unwrap().unwrap_err();
            assert!(
                matches!(refusal.error, OrderError::Unsafe(_)),
                "{refusal:?}"
            );
        }
        let kept = shelf.take().checkpoint();
        assert_eq!((kept.simulation.seq, kept.lines), (0, 0));
    }

    #[test]
    fn what_takes_long_or_changes_more_is_left_to_the_thread() {
        let (shelf, store) = shelf();
        let other_bodies = set(Settings {
            pi1: Some(2.0),
            ..Settings::default()
        });
        let pause = Order::Pause;
        for order in [other_bodies, pause, Order::Batch(Vec::new())] {
            let (command, _) = command(order);
            assert!(shelf.carry_out(command, || {}).is_err());
        }
        // What came before is done before.
        shelf.queue();
        let (second, _) = command(pi2(0.7));
        assert!(shelf.carry_out(second, || {}).is_err());
        assert!(store.try_recv().is_err());
    }

    #[test]
    fn a_defect_while_it_is_away_ends_the_thread_instead_of_letting_it_wait() {
        let (shelf, store) = shelf();
        let (mut order, _) = command(pi2(0.7));
        order.answer = Box::new(|_| panic!("a defect"));
        assert!(shelf.carry_out(order, || {}).is_ok());
        let done = store.recv().unwrap();
        let told = std::thread::spawn(move || done(Ok(())));
        assert!(told.join().is_err());
        let taken = std::thread::spawn(move || drop(shelf.take()));
        assert!(taken.join().is_err());
    }
}
