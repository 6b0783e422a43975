//! Controllers that couple to the swarm: in lock-step it steps when every one of them has
//! advanced; while it runs they put set-points. A deadline that fires, a token that is lost and
//! set-points that are applied are orders of the swarm's own, written down like any other: told
//! again from the journal, they come at the steps they came at.

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

/// An order of a controller's that is carried out before it is safe, like a `step`.
pub(super) struct ControllerInput {
    /// The line it stands on, or none.
    pub input: u64,
    pub sender: Arc<Sender>,
}

impl Worker {
    /// Takes a controller in.
    pub(super) fn join(&mut self, options: &JoinOptions) -> Result<Outcome, SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        self.controllers.admit(options)?;
        let claims = match &options.selection {
            Some(selection) => Some(self.claim(&options.controller, selection)?),
            None => None,
        };
        let step = self.simulation.state.step;
        if options.mode == Mode::Lockstep && !self.controllers.is_lockstep() {
            let paused = Phase::Paused(PauseReason::Lockstep);
            self.answer_pending(&paused);
            self.enter(paused);
        }
        if let Some(answer) = self.controllers.join(options, claims, step) {
            answer.send(Err(self.refusal(SwarmError::Superseded)));
        }
        self.go_on();
        let member = self.controllers.find(&options.controller)?;
        let ids = member.kept.claims.iter().copied().collect();
        let news = std::mem::take(&mut member.kept.news);
        Ok(Outcome::Joined { ids, news })
    }

    /// Those that a controller is to steer, none of them claimed by another. Draws are from those
    /// that nobody has claimed.
    fn claim(&self, controller: &str, selection: &Selection) -> Result<BTreeSet<u32>, SwarmError> {
        let state = &self.simulation.state;
        let claimed = self.controllers.claimed_beside(controller);
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

    /// Lets a controller go, at its own wish.
    pub(super) fn leave(&mut self, controller: &str) -> Result<Outcome, SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        self.controllers.find(controller)?;
        self.part(controller, Departure::Left);
        self.go_on();
        Ok(Outcome::Done)
    }

    /// Takes a controller out. Whom it steered is uninformed, unless it joined to hold them.
    fn part(&mut self, controller: &str, why: Departure) {
        let step = self.simulation.state.step;
        let Some(mut member) = self.controllers.part(controller, why, step) else {
            return;
        };
        if member.kept.on_timeout != OnTimeout::Hold {
            self.simulation.release(&member.kept.steered);
        }
        // What only those wanted who have left is not gone on with.
        let is_last = member.kept.mode == Mode::Lockstep && !self.controllers.is_lockstep();
        if is_last && let Phase::Stepping { .. } = self.phase {
            self.phase = Phase::Paused(PauseReason::Lockstep);
            self.journal.interrupt(step);
        }
        if let Some(answer) = member.take_answer() {
            let left = Some((why, step));
            let controller = controller.to_owned();
            answer.send(Err(self.refusal(SwarmError::NotJoined { controller, left })));
        }
    }

    /// Has a controller advance, and answers it when the swarm has come so far.
    pub(super) fn begin_advance(
        &mut self,
        from: ControllerInput,
        (controller, steps, set): (&str, u64, Option<&SetPoints>),
        answer: ReplyTo,
    ) {
        if let Err(error) = self.check_advance(controller, set) {
            return self.refuse_coupling(&from, &error, answer);
        }
        let step = self.simulation.state.step;
        if let Some(set) = set
            && let Err(error) = self.simulation.steer(set)
        {
            return self.refuse_coupling(&from, &error.into(), answer);
        }
        let Ok(member) = self.controllers.find(controller) else {
            unreachable!("it was found to have joined");
        };
        if let Some(set) = set {
            member.kept.steered.extend(&set.ids);
        }
        let target = step.saturating_add(steps);
        let before = member.advance(step, target, from.sender.clone(), answer);
        if let Some(before) = before {
            before.send(Err(self.refusal(SwarmError::Superseded)));
        }
        let until = self.controllers.together(step);
        self.note_coupling(&from, until);
        self.enter_in_history(from.sender);
        self.go_on();
    }

    /// Whether a controller may advance, and has what it wants to steer.
    fn check_advance(
        &mut self,
        controller: &str,
        set: Option<&SetPoints>,
    ) -> Result<(), SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        let is_moving = self.phase.is_moving();
        let member = self.controllers.find(controller)?;
        if member.kept.mode != Mode::Lockstep {
            return Err(SwarmError::RunsFreely(controller.to_owned()));
        }
        if is_moving {
            return Err(SwarmError::Advancing {
                controller: controller.to_owned(),
                target: member.kept.target,
            });
        }
        set.map_or(Ok(()), |set| self.check_claims(controller, set))
    }

    fn check_claims(&mut self, controller: &str, set: &SetPoints) -> Result<(), SwarmError> {
        let kept = &self.controllers.find(controller)?.kept;
        if set.drives.is_some() && !kept.driving {
            return Err(SwarmError::NotDriving(controller.to_owned()));
        }
        let claims = &kept.claims;
        match set.ids.iter().find(|id| !claims.contains(id)) {
            None => Ok(()),
            Some(&id) => Err(SwarmError::NotClaimed {
                id,
                owner: self.controllers.owner(id).map(str::to_owned),
            }),
        }
    }

    /// Carries out what came about by itself: a deadline, a lost token, set-points that were put.
    pub(super) fn couple(
        &mut self,
        from: &ControllerInput,
        order: &Command,
    ) -> Result<(), SwarmError> {
        match order {
            Command::Deadline(controller) => {
                self.controllers.find(controller)?;
                self.note_coupling(from, None);
                self.deadline(controller);
            }
            Command::Lost(controller) => {
                self.controllers.find(controller)?;
                self.note_coupling(from, None);
                self.part(controller, Departure::Lost);
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
                    member.kept.steered.extend(&set.ids);
                }
                steered?;
                self.note_coupling(from, None);
                self.enter_in_history(from.sender.clone());
                return Ok(());
            }
            _ => unreachable!("all else has a sender who waits"),
        }
        self.tell(EventKind::Command(from.sender.clone()));
        self.go_on();
        self.show_if_standing();
        Ok(())
    }

    /// The others have waited long enough for a controller.
    fn deadline(&mut self, controller: &str) {
        let step = self.simulation.state.step;
        let misses = self.controllers.miss(controller, step);
        let nearest = self.controllers.nearest(step);
        let Ok(member) = self.controllers.find(controller) else {
            return;
        };
        let kept = &mut member.kept;
        let (mode, on_timeout) = (kept.mode, kept.on_timeout);
        if on_timeout == OnTimeout::Free {
            self.simulation.release(&std::mem::take(&mut kept.steered));
        }
        if let (Mode::Lockstep, Some(nearest)) = (mode, nearest)
            && on_timeout != OnTimeout::Pause
        {
            kept.target = nearest;
        }
        if mode == Mode::Lockstep && misses >= MAX_MISSES {
            self.part(controller, Departure::Late);
        }
        if on_timeout == OnTimeout::Pause {
            let paused = Phase::Paused(PauseReason::Deadline);
            self.cut_short(&paused);
            if mode == Mode::FreeRunning {
                self.answer_pending(&paused);
            }
            self.enter(paused);
        }
    }

    /// Refuses what was to be done for a controller: nothing has changed.
    fn refuse_coupling(&mut self, from: &ControllerInput, error: &SwarmError, answer: ReplyTo) {
        self.simulation.seq -= 1;
        if from.input > 0 {
            self.record_outcome(from.input, Err(error));
        }
        answer.send(Err(self.refusal(error.clone())));
    }

    /// Writes down, when it suits, what was done for a controller. Once that is safe, so are the
    /// steps up to `until`.
    fn note_coupling(&mut self, from: &ControllerInput, until: Option<u64>) {
        let record = self.applied_record(from.input, &from.sender);
        self.journal.append(self.at(), record, until);
    }

    /// Enters what comes thousands of times a second where `get/journal` shows it. No event tells
    /// of it: whoever follows those would see nothing else.
    fn enter_in_history(&self, sender: Arc<Sender>) {
        self.history.recall(Entry {
            place: self.place(),
            unix_secs: self.unix_secs(),
            sender,
        });
    }

    /// Steps if every controller has advanced, stands still if one has not, and looks for whom the
    /// swarm waits.
    pub(super) fn go_on(&mut self) {
        if self.controllers.is_empty() {
            return;
        }
        let step = self.simulation.state.step;
        if self.controllers.is_lockstep() && !matches!(self.phase, Phase::Faulted(_)) {
            // The phases of an exchange are known to all who take part in it: no event tells them.
            match self.controllers.together(step) {
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
        self.controllers.wait_at(step, Instant::now());
    }

    /// Tells all controllers whose advance has come to its end, and goes on with the others'.
    pub(super) fn answer_arrived(&mut self) {
        if self.controllers.is_empty() {
            return;
        }
        let step = self.simulation.state.step;
        let arrived = self.controllers.arrived(step, false);
        self.go_on();
        let phase = self.phase.clone();
        self.answer_advances(arrived, &phase);
    }

    /// Tells all controllers that wait how far the swarm came, and what it does from then on.
    pub(super) fn cut_short(&mut self, from_then_on: &Phase) {
        let step = self.simulation.state.step;
        let waiting = self.controllers.arrived(step, true);
        self.answer_advances(waiting, from_then_on);
    }

    fn answer_advances(&mut self, answers: Vec<(ReplyTo, u64, News)>, from_then_on: &Phase) {
        if answers.is_empty() {
            return;
        }
        let (mut place, seen) = self.look();
        place.phase = from_then_on.clone();
        let safe_step = self.journal.durable_step_of(place.step);
        for (answer, from, news) in answers {
            let outcome = Outcome::Advanced {
                steps: place.step - from,
                safe_step,
                seen: seen.clone(),
                news,
            };
            answer.send(Ok((place.clone(), outcome)));
        }
    }

    /// Fires the deadlines that have passed.
    pub(super) fn fire_overdue(&mut self) -> Option<End> {
        if matches!(self.phase, Phase::Faulted(_)) {
            self.controllers.rest();
        }
        for controller in self.controllers.overdue(Instant::now()) {
            let sender = by_itself("deadline", &controller);
            if let Some(end) = self.order_itself(Command::Deadline(controller), sender) {
                return Some(end);
            }
        }
        None
    }

    /// A controller's token is gone.
    pub(super) fn lost(&mut self, controller: String) -> Option<End> {
        // Most tokens are of controllers that have said goodbye.
        self.controllers.find(&controller).ok()?;
        let sender = by_itself("lost", &controller);
        self.order_itself(Command::Lost(controller), sender)
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
            let order = Command::Control {
                controller,
                sequence,
                set,
            };
            // Set-points end no swarm.
            let _ = self.order_itself(order, sender);
        }
        let step = self.simulation.state.step;
        self.controllers.wait_at(step, Instant::now());
    }

    fn order_itself(&mut self, order: Command, sender: Arc<Sender>) -> Option<End> {
        // A fault keeps the last good state: nothing comes about by itself until a reset.
        if matches!(self.phase, Phase::Faulted(_)) {
            return None;
        }
        self.since.inputs += 1;
        self.applied_at(self.unix_secs(), |it| {
            it.execute(0, order, sender, ReplyTo::ignored())
        })
    }

    fn show_if_standing(&self) {
        if !self.phase.is_moving() {
            self.show();
        }
    }
}

/// The swarm's own order about a controller, whose name is plain text.
fn by_itself(verb: &'static str, controller: &str) -> Arc<Sender> {
    Arc::new(Sender {
        verb,
        args: format!("{{\"controller\":\"{controller}\"}}"),
        ..Sender::default()
    })
}
