//! What a swarm's thread does when it is told something: now, or when its step has come.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use fail::fail_point;
use jostle_physics::simulation::{Change, ChangeError, ChangeKind, ChangeOutcome};
use tracing::warn;

use crate::swarm::clock;
use crate::swarm::command::{Command, Until, When};
use crate::swarm::crash;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::EventKind;
use crate::swarm::handle::CommandMessage;
use crate::swarm::journal::Record;
use crate::swarm::outcome::{DeferredReply, Outcome, Rejection, ReplyTo, SwarmReply};
use crate::swarm::pace::Pace;
use crate::swarm::phase::{self, PauseReason, Phase, PhaseInput};
use crate::swarm::schedule::Scheduled;
use crate::swarm::sender::Sender;
use crate::swarm::worker::steering::ControllerInput;
use crate::swarm::worker::{End, Pending, Worker};
use jostle_physics::simulation::steps_in;

impl Worker {
    /// Makes commands safe together, and then carries each out or puts it off until its step.
    pub(super) fn commands(&mut self, commands: Vec<CommandMessage>) -> Option<End> {
        let mut possible = Vec::with_capacity(commands.len());
        for command in commands {
            match self.check(&command.order, command.when) {
                Ok(()) => possible.push(command),
                Err(error) => command.answer.send(Err(self.refusal(error))),
            }
        }
        let step = self.simulation.state.step;
        let schedule_command =
            |command: &CommandMessage| command.when.at_step.filter(|at_step| *at_step > step);
        let is_far_ahead = self.journal.is_far_ahead();
        let is_write_ahead = |command: &CommandMessage| {
            let order = &command.order;
            let is_held = is_far_ahead && order.is_group_committed();
            order.is_write_ahead() || schedule_command(command).is_some() || is_held
        };
        let unix_secs = self.unix_secs();
        let records: Vec<Record> = possible
            .iter()
            .filter(|command| is_write_ahead(command))
            .map(|command| Record::Input {
                at_step: schedule_command(command),
                sender: command.sender.clone(),
                seq: None,
                unix_secs,
            })
            .collect();
        let mut input = 0;
        if !records.is_empty() {
            // Others may compute while this one waits for the disk.
            self.seat.leave();
            match self.journal.commit(self.at(), records) {
                Ok(first) => {
                    crash::point("swarm-safe");
                    input = first;
                }
                Err(fault) => {
                    for command in possible {
                        let error = SwarmError::Unsafe(fault.clone());
                        command.answer.send(Err(self.refusal(error)));
                    }
                    return None;
                }
            }
        }
        for command in possible {
            let at_step = schedule_command(&command);
            let is_written = is_write_ahead(&command);
            let line = if is_written { input } else { 0 };
            let end = match at_step {
                // Nothing else says when it came.
                Some(_) => self.applied_at(unix_secs, |it| it.command(line, at_step, command)),
                None => self.command(line, None, command),
            };
            if end.is_some() {
                return end;
            }
            input += u64::from(is_written);
        }
        None
    }

    /// Carries out a command that stands on line `input`, or on none, or puts it off until its
    /// step.
    pub(super) fn command(
        &mut self,
        input: u64,
        at_step: Option<u64>,
        command: CommandMessage,
    ) -> Option<End> {
        self.applied_at(self.unix_secs(), |it| it.apply(input, at_step, command))
    }

    fn apply(&mut self, input: u64, at_step: Option<u64>, command: CommandMessage) -> Option<End> {
        self.since.inputs += 1;
        let CommandMessage {
            order,
            sender,
            answer,
            ..
        } = command;
        let Some(at_step) = at_step else {
            return self.execute(input, order, sender, answer);
        };
        match self.schedule_command(input, at_step, order, sender) {
            Ok(()) => answer.send(Ok((self.place(), Outcome::Scheduled(at_step)))),
            Err(error) => {
                self.record_outcome(input, Err(&error));
                answer.send(Err(self.refusal(error)));
            }
        }
        None
    }

    /// Writes down what became of the command on line `input`. What was refused by chance must not
    /// be carried out when the journal is told again, so its refusal is safe before it is told.
    pub(super) fn record_outcome(&mut self, input: u64, outcome: Result<u64, &SwarmError>) {
        let record = Record::Became {
            input,
            seq: outcome.ok(),
            unix_secs: self.unix_secs(),
        };
        let at = self.at();
        match outcome {
            Err(error) if error.may_succeed_later() => {
                if let Err(fault) = self.journal.commit(at, vec![record]) {
                    warn!(swarm = self.outlet.name, %fault, "failed to write a refusal down");
                }
            }
            _ => drop(self.journal.append(at, record, None)),
        }
    }

    /// Carries out a command and answers it; all but `step` at once.
    pub(super) fn execute(
        &mut self,
        input: u64,
        order: Command,
        sender: Arc<Sender>,
        answer: ReplyTo,
    ) -> Option<End> {
        if self.replay.was_refused(input) {
            answer.send(Err(self.refusal(SwarmError::RefusedBefore)));
            return None;
        }
        let before = self.phase.clone();
        let seq = self.simulation.seq;
        // A command's draws are keyed by its own number.
        self.simulation.seq += 1;
        let outcome = match order {
            Command::Delete => return self.delete(input, sender, answer),
            Command::Step(steps) => {
                self.begin_steps(input, steps, sender, answer);
                return None;
            }
            Command::Advance {
                controller,
                steps,
                set,
            } => {
                let coupling = ControllerInput { input, sender };
                self.begin_advance(coupling, (&controller, steps, set.as_ref()), answer);
                return None;
            }
            Command::Deadline(_) | Command::Lost(_) | Command::Control { .. } => {
                if let Err(error) = self.couple(&ControllerInput { input, sender }, &order) {
                    self.simulation.seq = seq;
                    answer.send(Err(self.refusal(error)));
                }
                return None;
            }
            Command::Join(options) => self.join(&options),
            Command::Leave(controller) => self.leave(&controller),
            Command::Run { until, rate } => self.begin_run(until, rate),
            Command::Pause => self.pause(),
            Command::Reset(seed) => self.reset(seed),
            Command::Change(change) => match self.change(std::slice::from_ref(&change)) {
                Ok(mut changed) => Ok(Outcome::Changed(changed.remove(0).1)),
                Err(SwarmError::InBatch { error, .. }) => Err(*error),
                Err(error) => Err(error),
            },
            Command::Batch(changes) => self.change(&changes).map(Outcome::Batch),
        };
        match outcome {
            Ok(outcome) => {
                let is_reset = matches!(outcome, Outcome::Reset(_));
                self.record_outcome(input, Ok(self.simulation.seq));
                self.tell(EventKind::Command(sender));
                if is_reset {
                    self.drop_scheduled();
                    self.journal.reset();
                    self.keep();
                }
                self.renew_summary();
                if self.phase == before && !self.phase.is_moving() {
                    self.show();
                }
                crash::point("swarm-applied");
                answer.send(Ok((self.place(), outcome)));
                // After the answer, so that whoever paused it sees this before others do.
                self.answer_waiters();
            }
            Err(error) => {
                self.simulation.seq = seq;
                let refusal = self.refusal(error);
                self.record_outcome(input, Err(&refusal.error));
                answer.send(Err(refusal));
            }
        }
        None
    }

    /// Makes every change or none; a defect that shows on the way undoes them too.
    fn change(
        &mut self,
        changes: &[Change],
    ) -> Result<Vec<(ChangeKind, ChangeOutcome)>, SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        let before = self.simulation.save();
        let simulation = &mut self.simulation;
        let changed = catch_unwind(AssertUnwindSafe(|| {
            fail_point!("command");
            simulation.apply_all(changes)
        }));
        match changed {
            Ok(Ok(outcomes)) => {
                if !self.controllers.is_empty() {
                    let there = &self.simulation.state.configuration.id;
                    self.controllers
                        .forget(|id| there.binary_search(&id).is_ok());
                }
                Ok(outcomes)
            }
            Ok(Err((index, error))) => {
                self.simulation.rollback(before);
                Err(SwarmError::InBatch {
                    index,
                    error: Box::new(error.into()),
                })
            }
            Err(_) => {
                self.simulation.rollback(before);
                Err(SwarmError::Panicked)
            }
        }
    }

    pub(super) fn check(&mut self, order: &Command, when: When) -> Result<(), SwarmError> {
        // Who has left is behind, mostly, and is to hear why.
        if let Command::Advance { controller, .. } = order {
            self.controllers.find(controller)?;
        }
        let step = self.simulation.state.step;
        let at = [
            ("epoch", when.expect_epoch, self.simulation.epoch),
            ("step", when.expect_step, step),
        ];
        for (what, expected, actual) in at {
            if let Some(expected) = expected
                && expected != actual
            {
                return Err(SwarmError::Conflict {
                    what,
                    expected,
                    actual,
                });
            }
        }
        match when.at_step {
            Some(at_step) if at_step < step => Err(SwarmError::Late { at_step, step }),
            _ => Ok(()),
        }
    }

    /// Puts a command off until its step. What can be seen to be wrong with it is refused now.
    fn schedule_command(
        &mut self,
        input: u64,
        at_step: u64,
        order: Command,
        sender: Arc<Sender>,
    ) -> Result<(), SwarmError> {
        if !matches!(order, Command::Reset(_) | Command::Delete) {
            phase::next(&self.phase, PhaseInput::Change)?;
        }
        match &order {
            Command::Change(change) => self.simulation.check(change)?,
            Command::Batch(changes) => {
                for (index, change) in changes.iter().enumerate() {
                    let error = |error: ChangeError| SwarmError::InBatch {
                        index,
                        error: Box::new(error.into()),
                    };
                    self.simulation.check(change).map_err(error)?;
                }
            }
            _ => {}
        }
        let command = Scheduled {
            input,
            order,
            sender: sender.clone(),
        };
        self.schedule.add(at_step, command)?;
        self.tell(EventKind::Scheduled(at_step, sender));
        Ok(())
    }

    /// Carries out what was put off until this step. Nobody waits for the answers any more, so
    /// an event tells of what is refused.
    pub(super) fn execute_due(&mut self) -> Option<End> {
        while let Some(due) = self.schedule.take(self.simulation.state.step) {
            let Scheduled {
                input,
                order,
                sender,
            } = due;
            let refused = Arc::new(Mutex::new(None));
            let answer = {
                let refused = refused.clone();
                move |answered: SwarmReply| {
                    *refused.lock().unwrap_or_else(PoisonError::into_inner) = answered.err();
                }
            };
            let unix_secs = match self.journal.is_replaying() {
                true => self.replay.unix_secs_of(input),
                false => clock::unix_secs(),
            };
            let end = self.applied_at(unix_secs, |it| {
                let end = it.execute(input, order, sender.clone(), ReplyTo::new(answer));
                let refusal = refused
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .take();
                if let Some(Rejection { error, .. }) = refusal {
                    it.tell(EventKind::Refused(sender, error));
                }
                end
            });
            if end.is_some() {
                return end;
            }
        }
        None
    }

    /// Refuses what was put off: after a reset its step would be another one.
    fn drop_scheduled(&mut self) {
        for (at_step, Scheduled { input, sender, .. }) in self.schedule.clear() {
            self.record_outcome(input, Err(&SwarmError::Overtaken { at_step }));
            self.tell(EventKind::Refused(
                sender,
                SwarmError::Overtaken { at_step },
            ));
        }
    }

    fn begin_run(
        &mut self,
        until: Option<Until>,
        rate: Option<Option<f64>>,
    ) -> Result<Outcome, SwarmError> {
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
        let next = phase::next(&self.phase, PhaseInput::Run(until))?;
        if self.controllers.is_lockstep() {
            return Err(SwarmError::Lockstep);
        }
        if let Some(until) = until
            && until < step
        {
            return Err(SwarmError::Past { until, step });
        }
        self.answer_pending(&next);
        self.rate = rate.unwrap_or(self.rate);
        let was_running = matches!(self.phase, Phase::Running { .. });
        if !was_running || rate.is_some() {
            let dt = self.simulation.state.parameters.dt;
            self.pace = Pace::new(self.rate, dt, Instant::now());
        }
        self.enter(next);
        self.enter_by(PhaseInput::Reached(step));
        Ok(Outcome::Runs(until, self.rate))
    }

    fn pause(&mut self) -> Result<Outcome, SwarmError> {
        let next = phase::next(&self.phase, PhaseInput::Pause)?;
        self.answer_pending(&next);
        self.cut_short(&next);
        self.enter(next);
        self.go_on();
        Ok(Outcome::Done)
    }

    fn reset(&mut self, seed: Option<u64>) -> Result<Outcome, SwarmError> {
        let next = phase::next(&self.phase, PhaseInput::Reset)?;
        let fresh = self.simulation.build_start(seed)?;
        // What is pending came this far; after the reset that could not be told any more.
        self.answer_pending(&next);
        self.cut_short(&next);
        self.simulation.restart(fresh);
        let there = &self.simulation.state.configuration.id;
        self.controllers
            .restart(0, |id| there.binary_search(&id).is_ok());
        self.enter(next);
        self.record_state();
        Ok(Outcome::Reset(self.frame(true)))
    }

    fn begin_steps(&mut self, input: u64, steps: u64, sender: Arc<Sender>, answer: ReplyTo) {
        let from = self.simulation.state.step;
        let until = from.saturating_add(steps);
        let next = phase::next(&self.phase, PhaseInput::Step(until)).map_err(SwarmError::from);
        let next = next.and_then(|next| match self.controllers.is_lockstep() {
            true => Err(SwarmError::Lockstep),
            false => Ok(next),
        });
        match next {
            Ok(next) => {
                // One that ends at the step for which this was put off has come to its end.
                self.answer_pending(&next);
                // Lock-step sends thousands of these a second: the phase in between, which
                // every reader of the reply knows, is not worth an event each way.
                self.phase = next;
                self.pace = Pace::new(None, self.simulation.state.parameters.dt, Instant::now());
                let record = self.applied_record(input, &sender);
                self.journal.append(self.at(), record, Some(until));
                self.tell(EventKind::Command(sender.clone()));
                self.pending = Some(Pending {
                    answer,
                    from,
                    sender,
                });
            }
            Err(error) => {
                self.simulation.seq -= 1;
                if input > 0 {
                    self.record_outcome(input, Err(&error));
                }
                answer.send(Err(self.refusal(error)));
            }
        }
    }

    /// The line of a command that was applied and stands on line `input`, or on none yet.
    pub(super) fn applied_record(&self, input: u64, sender: &Arc<Sender>) -> Record {
        let (seq, unix_secs) = (Some(self.simulation.seq), self.unix_secs());
        match input {
            0 => Record::Input {
                at_step: None,
                sender: sender.clone(),
                seq,
                unix_secs,
            },
            input => Record::Became {
                input,
                seq,
                unix_secs,
            },
        }
    }

    /// Ends the swarm, once its end is safe.
    fn delete(&mut self, input: u64, sender: Arc<Sender>, answer: ReplyTo) -> Option<End> {
        let mut place = self.place();
        place.phase = Phase::Paused(PauseReason::Requested);
        if let Err(fault) = self.journal.end(place, sender) {
            self.simulation.seq -= 1;
            let error = SwarmError::Unsafe(fault);
            if input > 0 {
                self.record_outcome(input, Err(&error));
            }
            answer.send(Err(self.refusal(error)));
            return None;
        }
        crash::point("swarm-ended");
        self.phase = Phase::Paused(PauseReason::Requested);
        let phase = self.phase.clone();
        self.answer_pending(&phase);
        self.cut_short(&phase);
        self.tell(EventKind::Deleted);
        let place = self.place();
        let step = Some(place.step);
        self.waiters.answer_all(|| {
            Err(Rejection {
                step,
                error: SwarmError::Gone,
            })
        });
        let reply = DeferredReply::new(answer, Ok((place, Outcome::Done)));
        Some(End::Deleted(reply))
    }

    /// Enters the phase that `cue` leads to, if it leads to another.
    pub(super) fn enter_by(&mut self, cue: PhaseInput) {
        if let Ok(next) = phase::next(&self.phase, cue) {
            self.enter(next);
        }
    }

    pub(super) fn enter(&mut self, next: Phase) {
        if next != self.phase {
            self.phase = next;
            self.tell(EventKind::Phase);
            self.show();
        }
    }

    /// Tells a pending `step` how far it came, and what the swarm does from then on.
    pub(super) fn answer_pending(&mut self, from_then_on: &Phase) {
        if let Some(Pending { answer, from, .. }) = self.pending.take() {
            let (mut place, seen) = self.look();
            place.phase = from_then_on.clone();
            let outcome = Outcome::Stepped {
                steps: place.step - from,
                safe_step: self.journal.durable_step_of(place.step),
                seen,
            };
            crash::point("swarm-stepped");
            answer.send(Ok((place, outcome)));
        }
    }
}
