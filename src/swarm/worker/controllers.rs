//! The commands of controllers. In lockstep the swarm steps when all of them have advanced; while it
//! runs freely they put set-points.
//!
//! A deadline that fires, a token that is lost and set-points that are applied are internal commands,
//! which are journaled like any other: a replay executes them at the same steps.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

use jostle_physics::model::selection::{Candidates, Selection, select};
use jostle_physics::simulation::{ChangeError, SetPoints};

use crate::swarm::command::Command;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::EventKind;
use crate::swarm::history::Entry;
use crate::swarm::membership::{Departure, JoinOptions, MAX_MISSES, Mode, News, OnTimeout, Put};
use crate::swarm::outcome::{Outcome, ReplyTo};
use crate::swarm::pace::Pace;
use crate::swarm::phase::{self, PauseReason, Phase, PhaseInput};
use crate::swarm::sender::Sender;
use crate::swarm::worker::{End, Worker};

/// The origin of a group-committed command of a controller.
pub(super) struct ControllerInput {
    /// Its journal line, 0 if it has none.
    pub input: u64,
    pub sender: Arc<Sender>,
}

impl Worker {
    /// Adds a controller.
    pub(super) fn join(&mut self, options: &JoinOptions) -> Result<Outcome, SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        self.controllers.check_join(options)?;
        let claims = match &options.selection {
            Some(selection) => Some(self.claim(&options.controller, selection)?),
            None => None,
        };
        let step = self.simulation.state.step;
        if options.mode == Mode::Lockstep && !self.controllers.is_lockstep() {
            let paused = Phase::Paused(PauseReason::Lockstep);
            self.reply_to_pending(&paused);
            self.enter(paused);
        }
        if let Some(reply_to) = self.controllers.join(options, claims, step) {
            reply_to.send(Err(self.rejection(SwarmError::Superseded)));
        }
        self.update_lockstep();
        let member = self.controllers.find(&options.controller)?;
        let ids = member.state.claims.iter().copied().collect();
        let news = std::mem::take(&mut member.state.news);
        Ok(Outcome::Joined { ids, news })
    }

    /// The individuals of a selection. Those that another controller has claimed are an error if they
    /// are named, and are excluded from random selections.
    fn claim(&self, controller: &str, selection: &Selection) -> Result<BTreeSet<u32>, SwarmError> {
        let state = &self.simulation.state;
        let claimed = self.controllers.claimed_by_others(controller);
        if let Selection::Ids(ids) = selection
            && let Some(id) = ids.iter().find(|id| claimed.contains(id))
        {
            return Err(SwarmError::Claimed {
                id: *id,
                controller: self.controllers.owner(*id).unwrap_or_default().to_owned(),
            });
        }
        let mut free = state.configuration.clone();
        let taken: Vec<usize> = (0..free.n())
            .filter(|&k| claimed.contains(&free.id[k]))
            .collect();
        free.remove(&taken);
        let chosen = select(
            &free,
            Candidates::All,
            selection,
            state.seed,
            self.simulation.seq,
        );
        let chosen = chosen.map_err(ChangeError::from)?;
        Ok(chosen.into_iter().map(|k| free.id[k]).collect())
    }

    /// Removes a controller at its request.
    pub(super) fn leave(&mut self, controller: &str) -> Result<Outcome, SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        self.controllers.find(controller)?;
        self.remove_controller(controller, Departure::Left);
        self.update_lockstep();
        Ok(Outcome::Done)
    }

    /// Removes a controller. The individuals it steered become uninformed, unless it joined with
    /// [`OnTimeout::Hold`].
    fn remove_controller(&mut self, controller: &str, why: Departure) {
        let step = self.simulation.state.step;
        let Some(mut member) = self.controllers.remove(controller, why, step) else {
            return;
        };
        if member.state.on_timeout != OnTimeout::Hold {
            self.simulation.release(&member.state.steered);
        }
        // Without a controller in lockstep, an advance that has begun is not continued.
        let is_last = member.state.mode == Mode::Lockstep && !self.controllers.is_lockstep();
        if is_last && let Phase::Stepping { .. } = self.phase {
            self.phase = Phase::Paused(PauseReason::Lockstep);
            self.journal.interrupt(step);
        }
        if let Some(reply_to) = member.take_reply_to() {
            let left = Some((why, step));
            let controller = controller.to_owned();
            reply_to.send(Err(
                self.rejection(SwarmError::NotJoined { controller, left })
            ));
        }
    }

    /// Begins an `advance` of a controller. Its reply is sent when the swarm has reached the step.
    pub(super) fn begin_advance(
        &mut self,
        from: ControllerInput,
        (controller, steps, set): (&str, u64, Option<&SetPoints>),
        reply_to: ReplyTo,
    ) {
        if let Err(error) = self.check_advance(controller, set) {
            return self.reject_input(&from, &error, reply_to);
        }
        let step = self.simulation.state.step;
        if let Some(set) = set
            && let Err(error) = self.simulation.steer(set)
        {
            return self.reject_input(&from, &error.into(), reply_to);
        }
        let Ok(member) = self.controllers.find(controller) else {
            unreachable!("check_advance found the controller");
        };
        if let Some(set) = set {
            member.state.steered.extend(&set.ids);
        }
        let target = step.saturating_add(steps);
        let before = member.advance(step, target, from.sender.clone(), reply_to);
        if let Some(before) = before {
            before.send(Err(self.rejection(SwarmError::Superseded)));
        }
        let until = self.controllers.common_target(step);
        self.journal_input(&from, until);
        self.record_in_history(from.sender);
        self.update_lockstep();
    }

    /// Whether a controller may advance and has claimed the individuals of `set`.
    fn check_advance(
        &mut self,
        controller: &str,
        set: Option<&SetPoints>,
    ) -> Result<(), SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        let is_moving = self.phase.is_moving();
        let member = self.controllers.find(controller)?;
        if member.state.mode != Mode::Lockstep {
            return Err(SwarmError::RunsFreely(controller.to_owned()));
        }
        if is_moving {
            return Err(SwarmError::Advancing {
                controller: controller.to_owned(),
                target: member.state.target,
            });
        }
        set.map_or(Ok(()), |set| self.check_claims(controller, set))
    }

    fn check_claims(&mut self, controller: &str, set: &SetPoints) -> Result<(), SwarmError> {
        let state = &self.controllers.find(controller)?.state;
        if set.drives.is_some() && !state.driving {
            return Err(SwarmError::NotDriving(controller.to_owned()));
        }
        let claims = &state.claims;
        match set.ids.iter().find(|id| !claims.contains(id)) {
            None => Ok(()),
            Some(&id) => Err(SwarmError::NotClaimed {
                id,
                owner: self.controllers.owner(id).map(str::to_owned),
            }),
        }
    }

    /// Executes an internal command: a deadline, a lost token, or set-points that were put.
    pub(super) fn apply_controller_command(
        &mut self,
        from: &ControllerInput,
        command: &Command,
    ) -> Result<(), SwarmError> {
        match command {
            Command::Deadline(controller) => {
                self.controllers.find(controller)?;
                self.journal_input(from, None);
                self.deadline(controller);
            }
            Command::Lost(controller) => {
                self.controllers.find(controller)?;
                self.journal_input(from, None);
                self.remove_controller(controller, Departure::Lost);
            }
            Command::Control {
                controller,
                sequence,
                set,
            } => {
                let steered = self
                    .check_claims(controller, set)
                    .and_then(|()| Ok(self.simulation.steer(set)?));
                let member = self.controllers.find(controller)?;
                member.count_put(*sequence, steered.is_ok());
                if steered.is_ok() {
                    member.state.steered.extend(&set.ids);
                }
                steered?;
                self.journal_input(from, None);
                self.record_in_history(from.sender.clone());
                return Ok(());
            }
            _ => unreachable!("{command:?} is no internal command"),
        }
        self.push_event(EventKind::Command(from.sender.clone()));
        self.update_lockstep();
        self.push_frame_if_still();
        Ok(())
    }

    /// The deadline of a controller has passed.
    fn deadline(&mut self, controller: &str) {
        let step = self.simulation.state.step;
        let misses = self.controllers.record_miss(controller, step);
        let nearest = self.controllers.nearest_target(step);
        let Ok(member) = self.controllers.find(controller) else {
            return;
        };
        let state = &mut member.state;
        let (mode, on_timeout) = (state.mode, state.on_timeout);
        if on_timeout == OnTimeout::Free {
            self.simulation.release(&std::mem::take(&mut state.steered));
        }
        if let (Mode::Lockstep, Some(nearest)) = (mode, nearest)
            && on_timeout != OnTimeout::Pause
        {
            state.target = nearest;
        }
        if mode == Mode::Lockstep && misses >= MAX_MISSES {
            self.remove_controller(controller, Departure::Late);
        }
        if on_timeout == OnTimeout::Pause {
            let paused = Phase::Paused(PauseReason::Deadline);
            self.end_advances(&paused);
            if mode == Mode::FreeRunning {
                self.reply_to_pending(&paused);
            }
            self.enter(paused);
        }
    }

    /// Rejects a command of a controller; nothing has changed.
    fn reject_input(&mut self, from: &ControllerInput, error: &SwarmError, reply_to: ReplyTo) {
        self.simulation.seq -= 1;
        if from.input > 0 {
            self.record_outcome(from.input, Err(error));
        }
        reply_to.send(Err(self.rejection(error.clone())));
    }

    /// Queues the journal line of a command of a controller. Once it is durable, so are the steps up to
    /// `until`.
    fn journal_input(&mut self, from: &ControllerInput, until: Option<u64>) {
        let record = self.applied_record(from.input, &from.sender);
        self.journal.append(self.at(), record, until);
    }

    /// Records a command for `get/journal` without an event: thousands of these a second would displace
    /// all other events.
    fn record_in_history(&self, sender: Arc<Sender>) {
        self.history.record_command(Entry {
            stamp: self.stamp(),
            unix_secs: self.unix_secs(),
            sender,
        });
    }

    /// Updates the phase in lockstep, which is stepping if all controllers have advanced and paused
    /// otherwise, and the deadlines.
    pub(super) fn update_lockstep(&mut self) {
        if self.controllers.is_empty() {
            return;
        }
        let step = self.simulation.state.step;
        if self.controllers.is_lockstep() && !matches!(self.phase, Phase::Faulted(_)) {
            // No event: the controllers know the phase from their replies.
            match self.controllers.common_target(step) {
                Some(until) => {
                    self.journal.reach(until);
                    if !self.phase.is_moving() {
                        let dt = self.simulation.state.parameters.dt;
                        self.pace = Pace::new(None, dt, Instant::now());
                    }
                    self.phase = Phase::Stepping { until };
                }
                None if self.phase.is_moving() => {
                    self.phase = Phase::Paused(PauseReason::Lockstep);
                }
                None => {}
            }
        }
        self.controllers.update_deadlines(step, Instant::now());
    }

    /// Replies to the advances that have reached their step, and updates the phase for the others.
    pub(super) fn reply_to_arrived(&mut self) {
        if self.controllers.is_empty() {
            return;
        }
        let step = self.simulation.state.step;
        let arrived = self.controllers.take_arrived(step, false);
        self.update_lockstep();
        let phase = self.phase.clone();
        self.reply_to_advances(arrived, &phase);
    }

    /// Replies to all pending advances; `next_phase` is the phase in the replies.
    pub(super) fn end_advances(&mut self, next_phase: &Phase) {
        let step = self.simulation.state.step;
        let waiting = self.controllers.take_arrived(step, true);
        self.reply_to_advances(waiting, next_phase);
    }

    fn reply_to_advances(&mut self, replies: Vec<(ReplyTo, u64, News)>, next_phase: &Phase) {
        if replies.is_empty() {
            return;
        }
        let (mut stamp, frame) = self.look();
        stamp.phase = next_phase.clone();
        let durable_step = self.journal.durable_step_of(stamp.step);
        for (reply_to, from, news) in replies {
            let outcome = Outcome::Advanced {
                steps: stamp.step - from,
                durable_step,
                frame: frame.clone(),
                news,
            };
            reply_to.send(Ok((stamp.clone(), outcome)));
        }
    }

    /// Executes the deadlines that have passed.
    pub(super) fn fire_deadlines(&mut self) -> Option<End> {
        if matches!(self.phase, Phase::Faulted(_)) {
            self.controllers.clear_deadline();
        }
        for controller in self.controllers.overdue(Instant::now()) {
            let sender = internal_sender("deadline", &controller);
            if let Some(end) = self.apply_internal(Command::Deadline(controller), sender) {
                return Some(end);
            }
        }
        None
    }

    /// Removes a controller whose liveliness token is lost.
    pub(super) fn remove_lost(&mut self, controller: String) -> Option<End> {
        // A controller that has left drops its token too.
        self.controllers.find(&controller).ok()?;
        let sender = internal_sender("lost", &controller);
        self.apply_internal(Command::Lost(controller), sender)
    }

    /// Applies the set-points that were put since the last step.
    pub(super) fn apply_puts(&mut self) {
        let puts = self.controllers.take_puts();
        if puts.is_empty() {
            return;
        }
        for (controller, put) in puts {
            let Put {
                sequence,
                set,
                sender,
            } = put;
            let command = Command::Control {
                controller,
                sequence,
                set,
            };
            // Set-points never end a swarm.
            let _ = self.apply_internal(command, sender);
        }
        let step = self.simulation.state.step;
        self.controllers.update_deadlines(step, Instant::now());
    }

    fn apply_internal(&mut self, command: Command, sender: Arc<Sender>) -> Option<End> {
        // A faulted swarm keeps its last good state until a reset.
        if matches!(self.phase, Phase::Faulted(_)) {
            return None;
        }
        self.since_checkpoint.inputs += 1;
        self.applied_at(self.unix_secs(), |it| {
            it.execute(0, command, sender, ReplyTo::ignored())
        })
    }

    fn push_frame_if_still(&self) {
        if !self.phase.is_moving() {
            self.push_frame();
        }
    }
}

/// The sender of an internal command about a controller. Names of controllers need no JSON escapes.
fn internal_sender(verb: &'static str, controller: &str) -> Arc<Sender> {
    Arc::new(Sender {
        verb,
        args: format!("{{\"controller\":\"{controller}\"}}"),
        ..Sender::default()
    })
}
