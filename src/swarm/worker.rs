//! A swarm's thread: the only one that touches its state, and its only clock.
//!
//! It takes tickets between steps in the order of arrival, paces itself, and puts what is to be
//! published in its outlet. It never waits for a reader.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use fail::fail_point;
use tracing::warn;

use crate::swarm::frame::{Event, EventKind, Frame, Place, Summary};
use crate::swarm::handle::{Handle, Ticket};
use crate::swarm::history::History;
use crate::swarm::order::{
    Answer, Answered, Change, ChangeKind, Order, OrderError, Outcome, Refusal, Sender, Until, When,
};
use crate::swarm::outlet::Outlet;
use crate::swarm::pace::Pace;
use crate::swarm::phase::{self, Cue, PauseReason, Phase};
use crate::swarm::schedule::{Schedule, Scheduled};
use crate::swarm::simulation::{Simulation, steps_in};
use crate::swarm::waiters::Waiters;

/// Tickets taken between two steps, so that a flood of them slows a swarm but never stops it.
const TICKETS_PER_STEP: usize = 64;

/// How often the summary of a moving swarm is renewed.
const SUMMARY_PERIOD: Duration = Duration::from_millis(100);

/// A running swarm, owned by its thread.
pub struct Worker {
    simulation: Simulation,
    phase: Phase,
    rate: Option<f64>,
    pace: Pace,
    tickets: Receiver<Ticket>,
    outlet: Arc<Outlet>,
    history: Arc<History>,
    schedule: Schedule,
    summary: Arc<Mutex<Option<Summary>>>,
    summary_renewed: Instant,
    shortest_between_frames: Duration,
    frame_due: Instant,
    events: u64,
    pending: Option<Pending>,
    waiters: Waiters,
}

/// A `step` command that is being carried out.
struct Pending {
    answer: Answer,
    from: u64,
}

/// What ended a swarm's thread.
pub enum End {
    /// Its deletion; the answer is due when it is gone for everyone.
    Deleted(Box<dyn FnOnce() + Send>),
    /// The daemon stops.
    Stopped,
}

impl Worker {
    /// A paused worker around a swarm that was just built.
    pub fn new(
        simulation: Simulation,
        tickets: Receiver<Ticket>,
        handle: &Handle,
        shortest_between_frames: Duration,
    ) -> Self {
        let now = Instant::now();
        let rate = simulation.recipe.rate;
        let mut worker = Worker {
            pace: Pace::new(rate, simulation.recipe.parameters.dt, now),
            simulation,
            phase: Phase::Paused(PauseReason::Created),
            rate,
            tickets,
            outlet: handle.outlet.clone(),
            history: handle.history.clone(),
            schedule: Schedule::default(),
            summary: handle.summary.clone(),
            summary_renewed: now,
            shortest_between_frames,
            frame_due: now,
            events: 0,
            pending: None,
            waiters: Waiters::default(),
        };
        worker.tell(EventKind::Created);
        worker.renew_summary();
        worker
    }

    /// The swarm as it is now.
    pub fn look(&self) -> (Place, Arc<Frame>) {
        (self.place(), self.frame(true))
    }

    /// Steps and takes tickets until the swarm ends.
    pub fn run(mut self) -> End {
        loop {
            if !self.phase.is_moving() {
                match self.tickets.recv() {
                    Ok(ticket) => {
                        if let Some(end) = self.take(ticket) {
                            return end;
                        }
                    }
                    Err(_) => return End::Stopped,
                }
                continue;
            }
            for _ in 0..TICKETS_PER_STEP {
                let Ok(ticket) = self.tickets.try_recv() else {
                    break;
                };
                if let Some(end) = self.take(ticket) {
                    return end;
                }
            }
            match self.wait() {
                Some(Duration::ZERO) => {
                    if let Some(end) = self.step() {
                        return end;
                    }
                }
                Some(wait) => match self.tickets.recv_timeout(wait) {
                    Ok(ticket) => {
                        if let Some(end) = self.take(ticket) {
                            return end;
                        }
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return End::Stopped,
                },
                None => {}
            }
        }
    }

    /// How long until the next step; `None` if there is none to be taken.
    fn wait(&self) -> Option<Duration> {
        match self.phase {
            Phase::Stepping { .. } => Some(Duration::ZERO),
            Phase::Running { .. } => Some(
                self.pace
                    .until_due(Instant::now())
                    .unwrap_or(Duration::ZERO),
            ),
            Phase::Paused(_) | Phase::Faulted(_) => None,
        }
    }

    fn take(&mut self, ticket: Ticket) -> Option<End> {
        match ticket {
            Ticket::Look(answer) => {
                let (place, frame) = self.look();
                answer(Ok((place, Outcome::Seen(frame))));
                None
            }
            Ticket::Wait(waiter) => {
                if let Some(waiter) = self.waiters.add(waiter) {
                    (waiter.answer)(Err(self.refusal(OrderError::Busy)));
                }
                self.answer_waiters();
                None
            }
            Ticket::Command {
                order,
                when,
                sender,
                answer,
            } => self.command(order, when, sender, answer),
            Ticket::Stop => Some(End::Stopped),
        }
    }

    /// Carries out a command now or puts it off until its step.
    fn command(
        &mut self,
        order: Order,
        when: When,
        sender: Arc<Sender>,
        answer: Answer,
    ) -> Option<End> {
        let step = self.simulation.state.step;
        let checked = self.check(when);
        match (checked, when.at_step) {
            (Ok(()), Some(at_step)) if at_step > step => {
                let put_off = self.put_off(at_step, order, sender);
                answer(match put_off {
                    Ok(()) => Ok((self.place(), Outcome::Scheduled(at_step))),
                    Err(error) => Err(self.refusal(error)),
                });
                None
            }
            (Ok(()), _) => self.carry_out(order, sender, answer),
            (Err(error), _) => {
                answer(Err(self.refusal(error)));
                None
            }
        }
    }

    /// Carries out a command and answers it; all but `step` at once.
    fn carry_out(&mut self, order: Order, sender: Arc<Sender>, answer: Answer) -> Option<End> {
        let before = self.phase.clone();
        let seq = self.simulation.seq;
        // A command's draws are keyed by its own number.
        self.simulation.seq += 1;
        let outcome = match order {
            Order::Delete => return Some(self.delete(answer)),
            Order::Step(steps) => {
                self.begin_steps(steps, sender, answer);
                return None;
            }
            Order::Run { until, rate } => self.begin_run(until, rate),
            Order::Pause => self.pause(),
            Order::Reset(seed) => self.reset(seed),
            Order::Change(change) => match self.change(std::slice::from_ref(&change)) {
                Ok(mut changed) => Ok(changed.remove(0).1),
                Err(OrderError::InBatch { error, .. }) => Err(*error),
                Err(error) => Err(error),
            },
            Order::Batch(changes) => self.change(&changes).map(Outcome::Batch),
        };
        match outcome {
            Ok(outcome) => {
                let is_reset = matches!(outcome, Outcome::Reset(_));
                self.tell(EventKind::Command(sender));
                if is_reset {
                    self.drop_scheduled();
                }
                self.renew_summary();
                if self.phase == before && !self.phase.is_moving() {
                    self.show();
                }
                answer(Ok((self.place(), outcome)));
                // After the answer, so that whoever paused it sees this before others do.
                self.answer_waiters();
            }
            Err(error) => {
                self.simulation.seq = seq;
                answer(Err(self.refusal(error)));
            }
        }
        None
    }

    /// Makes every change or none; a defect that shows on the way undoes them too.
    fn change(&mut self, changes: &[Change]) -> Result<Vec<(ChangeKind, Outcome)>, OrderError> {
        phase::next(&self.phase, Cue::Change)?;
        let before = self.simulation.save();
        let simulation = &mut self.simulation;
        let changed = catch_unwind(AssertUnwindSafe(|| {
            fail_point!("command");
            simulation.apply_all(changes)
        }));
        match changed {
            Ok(Ok(outcomes)) => Ok(outcomes),
            Ok(Err((index, error))) => {
                self.simulation.go_back(before);
                Err(OrderError::InBatch {
                    index,
                    error: Box::new(error),
                })
            }
            Err(_) => {
                self.simulation.go_back(before);
                Err(OrderError::Panicked)
            }
        }
    }

    fn check(&self, when: When) -> Result<(), OrderError> {
        let step = self.simulation.state.step;
        let at = [
            ("epoch", when.expect_epoch, self.simulation.epoch),
            ("step", when.expect_step, step),
        ];
        for (what, expected, actual) in at {
            if let Some(expected) = expected
                && expected != actual
            {
                return Err(OrderError::Conflict {
                    what,
                    expected,
                    actual,
                });
            }
        }
        match when.at_step {
            Some(at_step) if at_step < step => Err(OrderError::Late { at_step, step }),
            _ => Ok(()),
        }
    }

    /// Puts a command off until its step. What can be seen to be wrong with it is refused now.
    fn put_off(
        &mut self,
        at_step: u64,
        order: Order,
        sender: Arc<Sender>,
    ) -> Result<(), OrderError> {
        if !matches!(order, Order::Reset(_) | Order::Delete) {
            phase::next(&self.phase, Cue::Change)?;
        }
        match &order {
            Order::Change(change) => self.simulation.check(change)?,
            Order::Batch(changes) => {
                for (index, change) in changes.iter().enumerate() {
                    let error = |error| OrderError::InBatch {
                        index,
                        error: Box::new(error),
                    };
                    self.simulation.check(change).map_err(error)?;
                }
            }
            _ => {}
        }
        let command = Scheduled {
            order,
            sender: sender.clone(),
        };
        self.schedule.add(at_step, command)?;
        self.tell(EventKind::Scheduled(at_step, sender));
        Ok(())
    }

    /// Carries out what was put off until this step. Nobody waits for the answers any more, so
    /// an event tells of what is refused.
    fn carry_out_due(&mut self) -> Option<End> {
        while let Some(Scheduled { order, sender }) = self.schedule.take(self.simulation.state.step)
        {
            let refused = Arc::new(Mutex::new(None));
            let answer = {
                let refused = refused.clone();
                move |answered: Answered| {
                    *refused.lock().unwrap_or_else(PoisonError::into_inner) = answered.err();
                }
            };
            if let Some(end) = self.carry_out(order, sender.clone(), Box::new(answer)) {
                return Some(end);
            }
            let refusal = refused
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .take();
            if let Some(Refusal { error, .. }) = refusal {
                self.tell(EventKind::Refused(sender, error));
            }
        }
        None
    }

    /// Refuses what was put off: after a reset its step would be another one.
    fn drop_scheduled(&mut self) {
        for (at_step, Scheduled { sender, .. }) in self.schedule.clear() {
            self.tell(EventKind::Refused(
                sender,
                OrderError::Overtaken { at_step },
            ));
        }
    }

    fn begin_run(
        &mut self,
        until: Option<Until>,
        rate: Option<Option<f64>>,
    ) -> Result<Outcome, OrderError> {
        let step = self.simulation.state.step;
        let until = until.map(|until| match until {
            Until::Step(step) => step,
            Until::Time(time) => steps_in(time, self.simulation.state.parameters.dt),
        });
        // What is left out does not change: a running swarm keeps its end.
        let until = match self.phase {
            Phase::Running { until: end } => until.or(end),
            _ => until,
        };
        let next = phase::next(&self.phase, Cue::Run(until))?;
        if let Some(until) = until
            && until < step
        {
            return Err(OrderError::Past { until, step });
        }
        self.answer_pending(&next);
        self.rate = rate.unwrap_or(self.rate);
        let was_running = matches!(self.phase, Phase::Running { .. });
        if !was_running || rate.is_some() {
            let dt = self.simulation.state.parameters.dt;
            self.pace = Pace::new(self.rate, dt, Instant::now());
        }
        self.enter(next);
        self.enter_by(Cue::Reached(step));
        Ok(Outcome::Runs(until, self.rate))
    }

    fn pause(&mut self) -> Result<Outcome, OrderError> {
        let next = phase::next(&self.phase, Cue::Pause)?;
        self.answer_pending(&next);
        self.enter(next);
        Ok(Outcome::Done)
    }

    fn reset(&mut self, seed: Option<u64>) -> Result<Outcome, OrderError> {
        let next = phase::next(&self.phase, Cue::Reset)?;
        let fresh = self.simulation.fresh(seed)?;
        // What is pending came this far; after the reset that could not be told any more.
        self.answer_pending(&next);
        self.simulation.restart(fresh);
        self.enter(next);
        Ok(Outcome::Reset(self.frame(true)))
    }

    fn begin_steps(&mut self, steps: u64, sender: Arc<Sender>, answer: Answer) {
        let from = self.simulation.state.step;
        let until = from.saturating_add(steps);
        match phase::next(&self.phase, Cue::Step(until)) {
            Ok(next) => {
                // One that ends at the step for which this was put off has come to its end.
                self.answer_pending(&next);
                // Lock-step sends thousands of these a second: the phase in between, which
                // every reader of the reply knows, is not worth an event each way.
                self.phase = next;
                self.pace = Pace::new(None, self.simulation.state.parameters.dt, Instant::now());
                self.tell(EventKind::Command(sender));
                self.pending = Some(Pending { answer, from });
            }
            Err(error) => {
                self.simulation.seq -= 1;
                answer(Err(self.refusal(error.into())));
            }
        }
    }

    fn delete(&mut self, answer: Answer) -> End {
        self.phase = Phase::Paused(PauseReason::Requested);
        self.answer_pending(&self.phase.clone());
        self.tell(EventKind::Deleted);
        let place = self.place();
        let step = Some(place.step);
        self.waiters.answer_all(|| {
            Err(Refusal {
                step,
                error: OrderError::Gone,
            })
        });
        End::Deleted(Box::new(move || answer(Ok((place, Outcome::Done)))))
    }

    /// Takes one step, and carries out what was put off until the step reached.
    fn step(&mut self) -> Option<End> {
        let simulation = &mut self.simulation;
        let stepped = catch_unwind(AssertUnwindSafe(|| {
            fail_point!("step");
            simulation.step()
        }));
        let now = Instant::now();
        match stepped {
            Ok(Ok(report)) => {
                self.pace.stepped(now);
                if !report.lapsed.is_empty() {
                    self.tell(EventKind::Lapsed(report.lapsed));
                }
            }
            Ok(Err(error)) => {
                self.fault(error.to_string());
                return None;
            }
            Err(_) => {
                self.fault("a defect: the step panicked".into());
                return None;
            }
        }
        let step = self.simulation.state.step;
        if self.phase.until().is_some_and(|until| step >= until) {
            if matches!(self.phase, Phase::Stepping { .. }) {
                self.phase = Phase::Paused(PauseReason::Finished);
            } else {
                self.enter_by(Cue::Reached(step));
            }
            self.show();
            self.renew_summary();
            if let Some(end) = self.carry_out_due() {
                return Some(end);
            }
            // Unless what was due has begun to step anew, or has answered it.
            if !matches!(self.phase, Phase::Stepping { .. }) {
                self.answer_pending(&self.phase.clone());
            }
        } else {
            if step.is_multiple_of(self.simulation.publish_every) && now >= self.frame_due {
                // Counted from when it was due, so that a frame a little late costs no other.
                let grace = now.checked_sub(self.shortest_between_frames).unwrap_or(now);
                self.frame_due = self.frame_due.max(grace) + self.shortest_between_frames;
                self.show();
            }
            if now.saturating_duration_since(self.summary_renewed) >= SUMMARY_PERIOD {
                self.renew_summary();
            }
            if let Some(end) = self.carry_out_due() {
                return Some(end);
            }
        }
        self.answer_waiters();
        None
    }

    /// Keeps the last good state and says why.
    fn fault(&mut self, reason: String) {
        warn!(swarm = self.outlet.name, reason, "faulted");
        self.phase = Phase::Faulted(reason.clone());
        self.tell(EventKind::Fault(reason.clone()));
        self.show();
        self.renew_summary();
        if let Some(pending) = self.pending.take() {
            (pending.answer)(Err(self.refusal(OrderError::Faulted(reason))));
        }
        self.answer_waiters();
    }

    /// Enters the phase that `cue` leads to, if it leads to another.
    fn enter_by(&mut self, cue: Cue) {
        if let Ok(next) = phase::next(&self.phase, cue) {
            self.enter(next);
        }
    }

    fn enter(&mut self, next: Phase) {
        if next != self.phase {
            self.phase = next;
            self.tell(EventKind::Phase);
            self.show();
        }
    }

    /// Tells a pending `step` how far it came, and what the swarm does from then on.
    fn answer_pending(&mut self, from_then_on: &Phase) {
        if let Some(Pending { answer, from }) = self.pending.take() {
            let (mut place, frame) = self.look();
            place.phase = from_then_on.clone();
            let taken = place.step - from;
            answer(Ok((place, Outcome::Stepped(taken, frame))));
        }
    }

    fn answer_waiters(&mut self) {
        let mut waiters = std::mem::take(&mut self.waiters);
        let step = self.simulation.state.step;
        waiters.answer(step, &self.phase, || {
            let (place, frame) = self.look();
            Ok((place, Outcome::Seen(frame)))
        });
        self.waiters = waiters;
    }

    fn refusal(&self, error: OrderError) -> Refusal {
        Refusal {
            step: Some(self.simulation.state.step),
            error,
        }
    }

    fn place(&self) -> Place {
        Place {
            epoch: self.simulation.epoch,
            step: self.simulation.state.step,
            time: self.simulation.state.time(),
            phase: self.phase.clone(),
            seq: self.simulation.seq,
        }
    }

    fn frame(&self, hashed: bool) -> Arc<Frame> {
        let simulation = &self.simulation;
        Arc::new(Frame {
            place: self.place(),
            parameters: simulation.state.parameters,
            publish_every: simulation.publish_every,
            seed: simulation.state.seed,
            scheduled: self.schedule.len(),
            configuration: simulation.state.configuration.clone(),
            order: simulation.order(),
            means: simulation.means,
            exactness: simulation.exactness,
            rate: self.rate,
            real_time_factor: self.real_time_factor(),
            hash: hashed.then(|| simulation.state.hash()),
            gaps: OnceLock::new(),
        })
    }

    fn real_time_factor(&self) -> Option<f64> {
        self.phase
            .is_moving()
            .then(|| self.pace.real_time_factor())
            .flatten()
    }

    /// Shows the state to whoever reads.
    fn show(&self) {
        if self.outlet.is_watched() {
            self.outlet.show(self.frame(false));
        }
    }

    fn tell(&mut self, kind: EventKind) {
        self.events += 1;
        let event = Event {
            number: self.events,
            place: self.place(),
            kind,
        };
        self.history.tell(&event);
        self.outlet.tell(event);
    }

    fn renew_summary(&mut self) {
        self.summary_renewed = Instant::now();
        let configuration = &self.simulation.state.configuration;
        let summary = Summary {
            place: self.place(),
            n: configuration.n(),
            informed: configuration.weight.iter().filter(|w| **w > 0.0).count(),
            order: self.simulation.order().order,
            rate: self.rate,
            real_time_factor: self.real_time_factor(),
        };
        *self.summary.lock().unwrap_or_else(PoisonError::into_inner) = Some(summary);
    }
}
