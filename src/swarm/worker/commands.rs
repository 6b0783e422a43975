//! Commands: journaling, executing and replying to them.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

use fail::fail_point;
use jostle_physics::simulation::{
    Change, ChangeKind, ChangeOutcome, Settings, check_weights, steps_in,
};
use tracing::{info, warn};

use crate::failpoint;
use crate::swarm::command::{Command, Until};
use crate::swarm::controllers::Input;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::{self, EventKind, Stamp};
use crate::swarm::handle::{CommandMessage, DeferredReply, Outcome, ReplyTo};
use crate::swarm::journal::Record;
use crate::swarm::phase::{self, PauseReason, Phase, PhaseInput};
use crate::swarm::scheduler::Pace;
use crate::swarm::sender::Sender;
use crate::swarm::watch::Draws;
use crate::swarm::worker::{End, Pending, Worker};

impl Worker {
    /// Journals commands in one write, then executes each one or schedules it for its step.
    pub(super) fn commands(&mut self, commands: Vec<CommandMessage>) -> Option<End> {
        let mut accepted = Vec::with_capacity(commands.len());
        for message in commands {
            match self.check(&message, &accepted) {
                Ok(()) => accepted.push(message),
                Err(error) => self.reject(message.reply_to, error),
            }
        }
        let step = self.simulation.state.step;
        let scheduled_step =
            |message: &CommandMessage| message.when.at_step.filter(|at_step| *at_step > step);
        let is_far_ahead = self.journal.is_far_ahead();
        let is_write_ahead = |message: &CommandMessage| {
            let is_at_once = match &message.command {
                // It journals the end itself.
                Command::Delete => true,
                command => command.is_group_committed() && !is_far_ahead,
            };
            !is_at_once || scheduled_step(message).is_some()
        };
        let unix_secs = self.unix_secs();
        let records: Vec<Record> = accepted
            .iter()
            .filter(|message| is_write_ahead(message))
            .map(|message| Record::Input {
                at_step: scheduled_step(message),
                sender: message.sender.clone(),
                seq: None,
                unix_secs,
            })
            .collect();
        let mut input = 0;
        if !records.is_empty() {
            // Other swarms compute while this one waits for the disk.
            self.cpu_share.leave();
            match self.journal.commit(self.at(), records) {
                Ok(first) => {
                    failpoint::kill("swarm-durable");
                    input = first;
                }
                Err(fault) => {
                    for message in accepted {
                        let error = SwarmError::NotDurable(fault.clone());
                        self.reject(message.reply_to, error);
                    }
                    return None;
                }
            }
        }
        for message in accepted {
            let at_step = scheduled_step(&message);
            let is_written = is_write_ahead(&message);
            let line = if is_written { input } else { 0 };
            let end = match at_step {
                // Its journal line is the only record of when it was received, so a replay uses this time.
                Some(_) => self.applied_at(unix_secs, |it| it.command(line, at_step, message)),
                None => self.command(line, None, message),
            };
            if end.is_some() {
                return end;
            }
            input += u64::from(is_written);
        }
        None
    }

    /// Executes a command, or schedules it for `at_step`. `input` is the number of its journal line, 0
    /// if it has none.
    pub(super) fn command(
        &mut self,
        input: u64,
        at_step: Option<u64>,
        message: CommandMessage,
    ) -> Option<End> {
        self.applied_at(self.unix_secs(), |it| it.apply(input, at_step, message))
    }

    fn apply(&mut self, input: u64, at_step: Option<u64>, message: CommandMessage) -> Option<End> {
        let CommandMessage {
            command,
            sender,
            reply_to,
            ..
        } = message;
        // A note costs no checkpoint, which might evict an older one.
        self.since_checkpoint.inputs += u64::from(command != Command::Annotate);
        let Some(at_step) = at_step else {
            return self.execute(input, command, sender, reply_to);
        };
        match self.schedule_command(input, at_step, command, sender) {
            Ok(()) => reply_to.send(Ok((self.stamp(), Outcome::Scheduled(at_step)))),
            Err(error) => {
                self.record_outcome(input, Err(&error));
                self.reject(reply_to, error);
            }
        }
        None
    }

    /// Journals the outcome of the command on line `input`. A rejection that a replay might not
    /// reproduce is durable before the reply is sent.
    pub(super) fn record_outcome(&mut self, input: u64, outcome: Result<u64, &SwarmError>) {
        let record = Record::Outcome {
            input,
            seq: outcome.ok(),
            unix_secs: self.unix_secs(),
        };
        let at = self.at();
        match outcome {
            Err(error) if error.may_succeed_later() => {
                if let Err(fault) = self.journal.commit(at, vec![record]) {
                    warn!(swarm = self.output.name, %fault, "failed to journal a rejection");
                }
            }
            _ => drop(self.journal.append(at, record, None)),
        }
    }

    /// Executes a command and replies. The replies to `step` and `advance` are sent when their steps
    /// are taken.
    pub(super) fn execute(
        &mut self,
        input: u64,
        command: Command,
        sender: Arc<Sender>,
        mut reply_to: ReplyTo,
    ) -> Option<End> {
        if let Command::Fired(watch) = &command {
            // It is executed once, even if it is rejected.
            self.watches.remove(watch);
        }
        if let Some((None, _)) = self.journal.outcome(input) {
            self.reject(reply_to, SwarmError::RejectedBefore);
            return None;
        }
        let before = self.phase.clone();
        let (seq, annotations) = (self.simulation.seq, self.annotations);
        let is_group_committed = command.is_group_committed();
        match command.is_annotation() {
            true => self.annotations += 1,
            // The number of a command is the key of its random draws.
            false => self.simulation.seq += 1,
        }
        let joining = match &command {
            Command::Join(options) => Some(options.controller.clone()),
            _ => None,
        };
        let outcome = match command {
            Command::Delete | Command::Reset(_) if self.is_protected => Err(self.protected()),
            Command::Delete => match self.delete(&sender) {
                Ok(reply) => return Some(End::Deleted(DeferredReply::new(reply_to, Ok(reply)))),
                Err(error) => Err(error),
            },
            Command::Step(steps) => self.begin_steps((input, &sender), steps, &mut reply_to),
            Command::Run { until, rate } => self.begin_run(until, rate),
            Command::Pause => self.pause(PauseReason::Requested),
            Command::Reset(seed) => self.reset(seed),
            Command::Change(change) => {
                match self.change(std::slice::from_ref(&change), Draws::Command) {
                    Ok(mut changed) => {
                        Ok(Outcome::Changed(changed.remove(0).1, self.published_hz()))
                    }
                    Err(SwarmError::InBatch { error, .. }) => Err(*error),
                    Err(error) => Err(error),
                }
            }
            Command::Batch { changes, draws } => self.change(&changes, draws).map(Outcome::Batch),
            Command::Annotate => Ok(Outcome::Done),
            Command::Protect(on) => {
                self.is_protected = on;
                Ok(Outcome::Done)
            }
            Command::Watch(watch) => self.watch(*watch, sender.clone()),
            Command::Unwatch(which) => self.unwatch(&which),
            Command::Fired(watch) => self.fire(&watch),
            Command::Join(_)
            | Command::Leave(_)
            | Command::Advance { .. }
            | Command::Deadline(_)
            | Command::Lost(_)
            | Command::Idle(_)
            | Command::Control { .. } => {
                let command = Input::Command(&command, &sender, &mut reply_to);
                self.control(command, Some((input, &sender)))
            }
        };
        match outcome {
            // Journaled already; `step` and `advance` get their reply when their steps are taken.
            Ok(_) if is_group_committed => {}
            Ok(outcome) => {
                let is_reset = matches!(outcome, Outcome::Reset(_));
                self.record_outcome(input, Ok(self.seq()));
                self.push_event(EventKind::Command(sender));
                if is_reset {
                    self.drop_scheduled(SwarmError::Overtaken);
                    self.journal.interrupt(0);
                    self.save_checkpoint();
                }
                self.update_summary();
                if self.phase == before && !self.phase.is_moving() {
                    self.push_frame();
                }
                failpoint::kill("swarm-applied");
                reply_to.send(Ok((self.stamp(), outcome)));
                // After the reply, so that the client that paused it learns of it first.
                self.reply_to_waiters();
                if let Some(controller) = joining {
                    self.joined(&controller);
                }
            }
            Err(error) => {
                self.simulation.seq = seq;
                self.annotations = annotations;
                if let Some(applied) = self.was_applied(input) {
                    self.report_refused(sender, Some(applied), error.clone());
                }
                if input > 0 {
                    self.record_outcome(input, Err(&error));
                }
                self.reject(reply_to, error);
            }
        }
        None
    }

    /// Applies all changes or none; a panic rolls back too. `draws` is the key of their random draws.
    pub(super) fn change(
        &mut self,
        changes: &[Change],
        draws: Draws,
    ) -> Result<Vec<(ChangeKind, ChangeOutcome)>, SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        self.check_measures(changes)?;
        // The journal may have such changes, of an earlier version; otherwise it has their rejection.
        if !self.journal.is_replaying() {
            check_weights(changes, self.simulation.state.parameters.pi2)
                .map_err(SwarmError::in_batch)?;
        }
        let before = self.simulation.save();
        let simulation = &mut self.simulation;
        let seq = simulation.seq;
        let first_draw = match draws {
            Draws::Command => seq,
            Draws::From(first) => first,
            Draws::Protocol => self.protocol_draws + 1,
        };
        let changed = catch_unwind(AssertUnwindSafe(|| {
            fail_point!("command");
            simulation.apply_all_at(first_draw, changes)
        }));
        let error = match changed {
            Ok(Ok(outcomes)) => {
                let count = outcomes.len() as u64;
                self.simulation.seq = seq + count - 1;
                if draws == Draws::Protocol {
                    self.protocol_draws += count;
                }
                self.notify_controllers(Input::Changed);
                return Ok(outcomes);
            }
            Ok(Err(rejected)) => SwarmError::in_batch(rejected),
            Err(_) => SwarmError::Panicked,
        };
        self.simulation.rollback(before);
        Err(error)
    }

    /// Checks that the group is not too large for the measures that it would publish.
    fn check_measures(&self, changes: &[Change]) -> Result<(), SwarmError> {
        let n = self.simulation.state.configuration.n();
        for (index, change) in changes.iter().enumerate() {
            if let Change::Set(Settings {
                measures: Some(names),
                ..
            }) = change
            {
                frame::check_sizes(names, n).map_err(|error| SwarmError::InBatch {
                    index,
                    error: Box::new(error.into()),
                })?;
            }
        }
        Ok(())
    }

    fn check(
        &mut self,
        message: &CommandMessage,
        accepted: &[CommandMessage],
    ) -> Result<(), SwarmError> {
        let CommandMessage { command, when, .. } = message;
        // A controller that has left usually expects an older step too; that it has left is the
        // more useful error.
        if let Command::Advance { controller, .. } = command {
            self.controllers.find(controller)?.heard(Instant::now());
        }
        let step = self.simulation.state.step;
        when.check(self.simulation.epoch, step)?;
        match when.at_step {
            Some(at_step) if at_step < step => Err(SwarmError::Late { at_step, step }),
            _ => self.check_places(message, accepted),
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
        // Without `until`, a running swarm keeps the one it has.
        let until = match self.phase {
            Phase::Running { until: end } => until.or(end),
            _ => until,
        };
        let next = phase::next(&self.phase, PhaseInput::Run(until))?;
        if self.controllers.is_lockstep() {
            return Err(self.controllers.lockstep(&self.output.name, step));
        }
        SwarmError::check_not_past(until, step)?;
        self.reply_to_pending(&next);
        self.rate = rate.unwrap_or(self.rate);
        let was_running = matches!(self.phase, Phase::Running { .. });
        if !was_running || rate.is_some() {
            let dt = self.simulation.state.parameters.dt;
            self.pace = Pace::new(self.rate, dt, Instant::now());
        }
        self.enter(next);
        self.apply_phase_input(PhaseInput::Reached(step));
        Ok(Outcome::Runs(until, self.rate))
    }

    /// Pauses for this reason. A swarm that is paused already keeps its reason, unless a condition that
    /// holds at the end of its run is the new one.
    pub(super) fn pause(&mut self, reason: PauseReason) -> Result<Outcome, SwarmError> {
        let is_moving = self.phase.is_moving();
        let next = match phase::next(&self.phase, PhaseInput::Pause)? {
            Phase::Paused(_) if is_moving || reason == PauseReason::Condition => {
                Phase::Paused(reason)
            }
            next => next,
        };
        self.reply_to_pending(&next);
        self.notify_controllers(Input::Interrupted(next.clone()));
        self.enter(next);
        self.notify_controllers(Input::Updated);
        Ok(Outcome::Done)
    }

    fn reset(&mut self, seed: Option<u64>) -> Result<Outcome, SwarmError> {
        let next = phase::next(&self.phase, PhaseInput::Reset)?;
        let fresh = self.simulation.build_start(seed)?;
        // Before the reset, since the replies contain the steps taken.
        self.reply_to_pending(&next);
        self.notify_controllers(Input::Interrupted(next.clone()));
        self.simulation.restart(fresh);
        self.earlier_models.clear();
        self.watches.clear();
        self.waits.restart();
        self.protocol_draws = 0;
        self.notify_controllers(Input::Restarted(next.clone()));
        self.enter(next);
        self.record_state();
        Ok(Outcome::Reset(self.frame(true)))
    }

    fn begin_steps(
        &mut self,
        (input, sender): (u64, &Arc<Sender>),
        steps: u64,
        reply_to: &mut ReplyTo,
    ) -> Result<Outcome, SwarmError> {
        let from = self.simulation.state.step;
        let until = from.saturating_add(steps);
        let next = phase::next(&self.phase, PhaseInput::Step(until))?;
        if self.controllers.is_lockstep() {
            return Err(self.controllers.lockstep(&self.output.name, from));
        }
        // A pending `step` that ends at the step for which this one is scheduled is done.
        self.reply_to_pending(&next);
        // No event: lockstep clients send thousands of steps a second, and the reply contains the phase.
        self.phase = next;
        self.reset_pace();
        let record = self.applied_record(input, sender);
        self.journal.append(self.at(), record, Some(until));
        self.push_event(EventKind::Command(sender.clone()));
        self.pending = Some(Pending {
            reply_to: reply_to.take(),
            from,
            sender: sender.clone(),
        });
        Ok(Outcome::Done)
    }

    /// The record of an executed command whose line is `input`, 0 if it has none yet.
    pub(super) fn applied_record(&self, input: u64, sender: &Arc<Sender>) -> Record {
        let (seq, unix_secs) = (Some(self.seq()), self.unix_secs());
        match input {
            0 => Record::Input {
                at_step: None,
                sender: sender.clone(),
                seq,
                unix_secs,
            },
            input => Record::Outcome {
                input,
                seq,
                unix_secs,
            },
        }
    }

    /// Ends the swarm once that is durable. Returns the reply.
    fn delete(&mut self, sender: &Arc<Sender>) -> Result<(Stamp, Outcome), SwarmError> {
        let mut stamp = self.stamp();
        stamp.phase = Phase::Paused(PauseReason::Requested);
        let ended = self.journal.end(stamp, sender.clone());
        ended.map_err(SwarmError::NotDurable)?;
        failpoint::kill("swarm-ended");
        self.phase = Phase::Paused(PauseReason::Requested);
        let phase = self.phase.clone();
        self.reply_to_pending(&phase);
        self.notify_controllers(Input::Interrupted(phase));
        info!(swarm = self.output.name, client = sender.client, "deleted");
        self.push_event(EventKind::Deleted(sender.clone()));
        let stamp = self.stamp();
        self.waiters.reject_all(Some(stamp.step));
        self.reject_waits(&SwarmError::Gone);
        Ok((stamp, Outcome::Done))
    }

    /// The number of a replayed command, if an earlier version of the model applied it.
    fn was_applied(&self, input: u64) -> Option<u64> {
        self.taken_over?;
        self.journal.outcome(input)?.0
    }

    /// Reports a replayed command that an earlier version of the model applied, under the number `applied`, or
    /// scheduled. The numbers of later commands, and the keys of their draws, stay.
    pub(super) fn report_refused(
        &mut self,
        sender: Arc<Sender>,
        applied: Option<u64>,
        error: SwarmError,
    ) {
        warn!(
            swarm = self.output.name, verb = sender.verb, seq = applied,
            step = self.simulation.state.step, %error,
            "this version of the model rejects a command that an earlier one applied"
        );
        if let Some(applied) = applied {
            self.simulation.seq = applied - self.annotations;
        }
        self.push_event(EventKind::Rejected(sender, error));
    }

    pub(super) fn protected(&self) -> SwarmError {
        SwarmError::Protected(self.output.name.clone())
    }

    /// Enters the phase that follows from `input`, if it is another one.
    pub(super) fn apply_phase_input(&mut self, input: PhaseInput) {
        if let Ok(next) = phase::next(&self.phase, input) {
            self.enter(next);
        }
    }

    pub(super) fn enter(&mut self, next: Phase) {
        if next != self.phase {
            self.phase = next;
            self.push_event(EventKind::Phase);
            self.push_frame();
        }
    }

    /// Replies to the pending `step`; `next_phase` is the phase in the reply.
    pub(super) fn reply_to_pending(&mut self, next_phase: &Phase) {
        if let Some(Pending { reply_to, from, .. }) = self.pending.take() {
            let (mut stamp, frame) = self.stamp_and_frame();
            stamp.phase = next_phase.clone();
            let outcome = Outcome::Stepped {
                steps: stamp.step - from,
                durable_step: self.journal.durable_step_of(stamp.step),
                frame,
            };
            failpoint::kill("swarm-stepped");
            reply_to.send(Ok((stamp, outcome)));
        }
    }
}
