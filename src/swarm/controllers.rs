//! The controllers that have joined a swarm, as a state machine without clock and I/O. Its table is in
//! docs/architecture.md.
//!
//! The thread of the swarm passes each [`Input`] with the time, and carries out the [`Effect`]s in
//! their order. Of the swarm only the simulation is changed here. A deadline that has passed is an
//! input that is journaled like a command, so a replay needs no clock.

mod input;
mod member;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Instant;

use jostle_physics::model::selection::{Candidates, Selection, select};
use jostle_physics::simulation::{ChangeError, SetPoints, Simulation};

pub use input::{Effect, Input, Swarm};
pub use member::{Expiry, TimeLimits};

use crate::swarm::command::Command;
use crate::swarm::controllers::member::Member;
use crate::swarm::error::SwarmError;
use crate::swarm::handle::{Outcome, ReplyTo};
use crate::swarm::membership::{
    ControllerState, ControllerStatus, Departure, JoinOptions, MAX_MISSES, Miss, Mode, News,
    OnTimeout,
};
use crate::swarm::phase::{self, PauseReason, Phase, PhaseInput};
use crate::swarm::sender::Sender;

/// Controllers that may join one swarm.
const MAX_CONTROLLERS: usize = 256;

/// Departures that are kept.
const MAX_DEPARTURES: usize = 256;

#[derive(Default)]
pub struct Controllers {
    members: BTreeMap<String, Member>,
    /// Who has left, why, and at which step.
    departures: VecDeque<(String, (Departure, u64))>,
}

impl Controllers {
    /// The controllers of a checkpoint; `reply_for` makes the receivers of the replies to their advances.
    pub fn restore(
        state: Vec<(String, ControllerState)>,
        mut reply_for: impl FnMut(&Arc<Sender>) -> ReplyTo,
    ) -> Self {
        let members = state.into_iter().map(|(name, state)| {
            let reply_to = state.advance.as_ref().map(&mut reply_for);
            (name, Member::new(state, reply_to))
        });
        Controllers {
            members: members.collect(),
            ..Controllers::default()
        }
    }

    pub fn states(&self) -> Vec<(String, ControllerState)> {
        let state = |(name, member): (&String, &Member)| (name.clone(), member.state.clone());
        self.members.iter().map(state).collect()
    }

    pub fn statuses(&self, now: Instant) -> Vec<ControllerStatus> {
        let members = self.members.iter();
        let status = |(name, member): (&String, &Member)| ControllerStatus {
            controller: name.clone(),
            state: member.state.clone(),
            waited: member
                .since
                .filter(|_| member.is_lockstep())
                .map(|since| now.saturating_duration_since(since)),
            puts: member.puts,
        };
        members.map(status).collect()
    }

    pub fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    /// The names of those that have joined.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.members.keys().map(String::as_str)
    }

    /// The numbers of the newest set-points that hold, by controller.
    pub fn sequences(&self) -> BTreeMap<String, u64> {
        let members = self.members.iter();
        let sequence = |(name, member): (&String, &Member)| {
            let sequence = member.sequence_in_force()?;
            Some((name.clone(), sequence))
        };
        members.filter_map(sequence).collect()
    }

    /// Whether the swarm steps only when all have advanced.
    pub fn is_lockstep(&self) -> bool {
        self.targets().next().is_some()
    }

    /// When something runs out next for a controller.
    pub fn due(&self, limits: &TimeLimits) -> Option<Instant> {
        let due = self.members.values().filter_map(|it| it.due(limits));
        due.map(|(due, _)| due).min()
    }

    /// What has run out by `now`, and for whom.
    pub fn overdue(&self, now: Instant, limits: &TimeLimits) -> Vec<(String, Expiry)> {
        let overdue = self.members.iter().filter_map(|(name, member)| {
            let (due, expiry) = member.due(limits)?;
            (due <= now).then(|| (name.clone(), expiry))
        });
        overdue.collect()
    }

    /// Why the swarm takes no steps of its own: it is in lock-step.
    pub fn lockstep(&self, swarm: &str, step: u64) -> SwarmError {
        let lockstep = || self.members.iter().filter(|(_, it)| it.is_lockstep());
        let holding = lockstep().filter(|(_, it)| it.holds(step));
        let mut controllers: Vec<String> = holding.map(|(name, _)| name.clone()).collect();
        if controllers.is_empty() {
            controllers = lockstep().map(|(name, _)| name.clone()).collect();
        }
        SwarmError::Lockstep {
            swarm: swarm.to_owned(),
            controllers,
        }
    }

    /// Takes the set-points for the next step as commands, in the order of the controllers' names.
    pub fn take_puts(&mut self) -> Vec<(Command, Arc<Sender>)> {
        let members = self.members.iter_mut();
        let put = |(name, member): (&String, &mut Member)| {
            let put = member.put.take()?;
            let command = Command::Control {
                controller: name.clone(),
                sequence: put.sequence,
                set: put.set,
            };
            Some((command, put.sender))
        };
        members.filter_map(put).collect()
    }

    /// Executes an input. If a command is rejected, its `reply_to` is not taken, and only counters have
    /// changed.
    pub fn on(&mut self, input: Input, swarm: &mut Swarm) -> Result<Outcome, SwarmError> {
        match input {
            Input::Command(command, sender, reply_to) => {
                return self.command(command, sender, reply_to, swarm);
            }
            Input::Put(controller, epoch, put) => {
                let is_current = epoch.is_none_or(|epoch| epoch == swarm.simulation.epoch);
                if let Some(member) = self.members.get_mut(controller) {
                    member.put(put, is_current);
                }
                return Ok(Outcome::Done);
            }
            Input::Reached => {
                self.update_phase(swarm);
                self.end_advances(false, swarm);
                return Ok(Outcome::Done);
            }
            Input::Interrupted(next) => {
                swarm.phase = next;
                self.end_advances(true, swarm);
                return Ok(Outcome::Done);
            }
            Input::Away(controller, since) => {
                if let Some(member) = self.members.get_mut(controller) {
                    member.away_since = Some(since);
                }
                return Ok(Outcome::Done);
            }
            Input::Returned(controller) => {
                if let Some(member) = self.members.get_mut(controller)
                    && member.away_since.take().is_some()
                {
                    member.since = member.since.map(|_| swarm.now);
                    member.heard(swarm.now);
                }
                return Ok(Outcome::Done);
            }
            Input::Faulted(error) => {
                for member in self.members.values_mut() {
                    member.state.advance = None;
                    swarm.reject(member.reply_to.take(), error.clone());
                }
            }
            Input::Restarted(next) => {
                swarm.phase = next;
                for member in self.members.values_mut() {
                    member.state.target = swarm.step();
                    member.state.from = swarm.step();
                    member.state.steered.clear();
                    member.put = None;
                    member.retain_individuals(&swarm.simulation.state.configuration.id);
                }
            }
            Input::Changed => {
                for member in self.members.values_mut() {
                    member.retain_individuals(&swarm.simulation.state.configuration.id);
                }
            }
            Input::Updated => {}
        }
        self.update_phase(swarm);
        Ok(Outcome::Done)
    }

    fn command(
        &mut self,
        command: &Command,
        sender: &Arc<Sender>,
        reply_to: &mut ReplyTo,
        swarm: &mut Swarm,
    ) -> Result<Outcome, SwarmError> {
        phase::next(&swarm.phase, PhaseInput::Change)?;
        let mut outcome = Outcome::Done;
        match command {
            Command::Join(options) => outcome = self.join(options, swarm)?,
            Command::Leave(controller) => {
                self.find(controller)?;
                self.remove(controller, Departure::Left, swarm);
            }
            Command::Advance {
                controller,
                steps,
                set,
            } => {
                let member = self.find(controller)?;
                if !member.is_lockstep() {
                    return Err(SwarmError::RunsFreely(controller.clone()));
                }
                if swarm.phase.is_moving() {
                    return Err(SwarmError::Advancing {
                        controller: controller.clone(),
                        target: member.state.target,
                    });
                }
                if let Some(set) = set {
                    self.steer(controller, set, swarm)?;
                }
                let step = swarm.step();
                let member = self.find(controller)?;
                member.state.from = step;
                member.state.target = step.saturating_add(*steps);
                member.state.misses = 0;
                member.state.advance = Some(sender.clone());
                member.since = None;
                let superseded = member.reply_to.replace(reply_to.take());
                swarm.reject(superseded, SwarmError::Superseded);
                let until = self.common_target(step);
                swarm.effects.push(Effect::Journal(until));
                swarm.effects.push(Effect::Record);
            }
            Command::Control {
                controller,
                sequence,
                set,
            } => {
                let steered = self.steer(controller, set, swarm);
                let member = self.find(controller)?;
                member.state.sequence = *sequence;
                member.state.misses = 0;
                member.since = None;
                match steered {
                    Ok(()) => {
                        member.puts.applied += 1;
                        member.applied = Some(*sequence);
                    }
                    Err(_) => member.puts.rejected += 1,
                }
                steered?;
                swarm.effects.push(Effect::Journal(None));
                swarm.effects.push(Effect::Record);
                // `Updated` follows once all set-points for the step are applied.
                return Ok(outcome);
            }
            Command::Deadline(controller)
            | Command::Lost(controller)
            | Command::Idle(controller) => {
                self.find(controller)?;
                swarm.effects.push(Effect::Journal(None));
                match command {
                    Command::Deadline(_) => self.miss(controller, swarm)?,
                    Command::Idle(_) => self.remove(controller, Departure::Idle, swarm),
                    _ => self.remove(controller, Departure::Lost, swarm),
                }
                swarm.effects.push(Effect::Publish);
                self.update_phase(swarm);
                swarm.effects.push(Effect::PublishState);
                return Ok(outcome);
            }
            _ => unreachable!("{command:?} is no command of a controller"),
        }
        self.update_phase(swarm);
        Ok(outcome)
    }

    /// Adds a controller, or lets it rejoin. Without a selection it keeps its individuals.
    fn join(&mut self, options: &JoinOptions, swarm: &mut Swarm) -> Result<Outcome, SwarmError> {
        let name = &options.controller;
        match self.members.contains_key(name) {
            true if !options.again => return Err(SwarmError::HasJoined(name.clone())),
            false if self.members.len() == MAX_CONTROLLERS => {
                return Err(SwarmError::TooManyControllers(MAX_CONTROLLERS));
            }
            _ => {}
        }
        let selection = options.selection.as_ref();
        let claims = selection.map(|selection| self.claim(name, selection, swarm.simulation));
        let claims = claims.transpose()?;
        if options.settings.mode == Mode::Lockstep && !self.is_lockstep() {
            swarm.phase = Phase::Paused(PauseReason::Lockstep);
            swarm.effects.push(Effect::Pause(PauseReason::Lockstep));
        }
        let before = self.members.remove(name).map(|member| {
            swarm.reject(member.reply_to, SwarmError::Superseded);
            let is_same = member.state.settings.mode == options.settings.mode;
            (member.state, member.applied.filter(|_| is_same))
        });
        let before =
            before.map(|(it, applied)| (it.claims, it.steered, it.news, it.sequence, applied));
        let (claimed, mut steered, news, sequence, applied) = before.unwrap_or_default();
        let claims = claims.unwrap_or(claimed);
        steered.retain(|id| claims.contains(id));
        let ids = claims.iter().copied().collect();
        let state = ControllerState {
            settings: options.settings,
            claims,
            steered,
            target: swarm.step(),
            from: swarm.step(),
            advance: None,
            misses: 0,
            news: News::default(),
            sequence,
        };
        let mut member = Member::new(state, None);
        member.applied = applied;
        self.members.insert(name.clone(), member);
        Ok(Outcome::Joined { ids, news })
    }

    /// The individuals of a selection. Those that another controller has claimed are an error if they
    /// are named, and are excluded from random selections.
    fn claim(
        &self,
        controller: &str,
        selection: &Selection,
        simulation: &Simulation,
    ) -> Result<BTreeSet<u32>, SwarmError> {
        let others = self.members.iter().filter(|(name, _)| *name != controller);
        let claimed: BTreeMap<u32, &String> = others
            .flat_map(|(name, member)| member.state.claims.iter().map(move |id| (*id, name)))
            .collect();
        if let Selection::Ids(ids) = selection
            && let Some((id, owner)) = ids.iter().find_map(|id| claimed.get_key_value(id))
        {
            return Err(SwarmError::Claimed {
                id: *id,
                controller: (*owner).clone(),
            });
        }
        let state = &simulation.state;
        let mut free = state.configuration.clone();
        let taken: Vec<usize> = (0..free.n())
            .filter(|&k| claimed.contains_key(&free.id[k]))
            .collect();
        free.remove(&taken);
        let all = Candidates::All;
        let chosen = select(&free, all, selection, state.seed, simulation.seq);
        let chosen = chosen.map_err(ChangeError::from)?;
        Ok(chosen.into_iter().map(|k| free.id[k]).collect())
    }

    /// Removes a controller. The individuals it steered become uninformed, unless it joined with
    /// [`OnTimeout::Hold`].
    fn remove(&mut self, controller: &str, why: Departure, swarm: &mut Swarm) {
        let Some(member) = self.members.remove(controller) else {
            return;
        };
        for other in self.members.values_mut() {
            other.state.news.left.push((controller.to_owned(), why));
        }
        if self.departures.len() == MAX_DEPARTURES {
            self.departures.pop_front();
        }
        let left = (why, swarm.step());
        self.departures.push_back((controller.to_owned(), left));
        if member.state.settings.on_timeout != OnTimeout::Hold {
            swarm.simulation.release(&member.state.steered);
        }
        // Without a controller in lockstep, an advance that has begun is not continued.
        let is_last = member.is_lockstep() && !self.is_lockstep();
        if is_last && matches!(swarm.phase, Phase::Stepping { .. }) {
            swarm.enter(Phase::Paused(PauseReason::Lockstep));
        }
        let error = SwarmError::NotJoined {
            controller: controller.to_owned(),
            left: Some(left),
        };
        swarm.reject(member.reply_to, error);
    }

    /// Applies set-points to individuals that the controller has claimed.
    fn steer(
        &mut self,
        controller: &str,
        set: &SetPoints,
        swarm: &mut Swarm,
    ) -> Result<(), SwarmError> {
        let state = &self.find(controller)?.state;
        if set.drives.is_some() && !state.settings.driving {
            return Err(SwarmError::NotDriving(controller.to_owned()));
        }
        if let Some(&id) = set.ids.iter().find(|id| !state.claims.contains(id)) {
            let mut members = self.members.iter();
            let owner = members.find(|(_, member)| member.state.claims.contains(&id));
            let owner = owner.map(|(name, _)| name.clone());
            return Err(SwarmError::NotClaimed { id, owner });
        }
        // The journal may have such set-points, of an earlier version.
        if !swarm.is_replaying {
            set.check_weights(swarm.simulation.state.parameters.pi2)?;
        }
        swarm.simulation.steer(set)?;
        self.find(controller)?.state.steered.extend(&set.ids);
        Ok(())
    }

    /// Counts a deadline that a controller has missed, and executes its [`OnTimeout`].
    fn miss(&mut self, controller: &str, swarm: &mut Swarm) -> Result<(), SwarmError> {
        let step = swarm.step();
        let nearest = self.targets().filter(|&target| target > step).min();
        let member = self.find(controller)?;
        member.since = None;
        let state = &mut member.state;
        state.misses += 1;
        let (settings, misses) = (state.settings, state.misses);
        let is_lockstep = settings.mode == Mode::Lockstep;
        let pauses = settings.on_timeout == OnTimeout::Pause;
        if settings.on_timeout == OnTimeout::Free {
            swarm.simulation.release(&state.steered);
            state.steered.clear();
        }
        if let Some(nearest) = nearest.filter(|_| is_lockstep && !pauses) {
            state.target = nearest;
        }
        for member in self.members.values_mut() {
            member.state.news.missed.push(Miss {
                controller: controller.to_owned(),
                step,
                misses,
            });
        }
        if is_lockstep && misses >= MAX_MISSES {
            self.remove(controller, Departure::Late, swarm);
        }
        if pauses {
            swarm.phase = Phase::Paused(PauseReason::Deadline);
            self.end_advances(true, swarm);
            swarm.effects.push(Effect::Pause(PauseReason::Deadline));
        }
        Ok(())
    }

    /// Replies to the advances that end at this step, or to all.
    fn end_advances(&mut self, all: bool, swarm: &mut Swarm) {
        let step = swarm.step();
        for member in self.members.values_mut() {
            let state = &mut member.state;
            if (state.target <= step || all) && state.advance.take().is_some() {
                state.target = state.target.min(step);
                if let Some(reply_to) = member.reply_to.take() {
                    let (news, phase) = (std::mem::take(&mut state.news), swarm.phase.clone());
                    let effect = Effect::Advanced(reply_to, state.from, news, phase);
                    swarm.effects.push(effect);
                }
            }
        }
    }

    /// Updates the phase in lockstep, which is stepping if all controllers have advanced and paused
    /// otherwise, and the deadlines.
    fn update_phase(&mut self, swarm: &mut Swarm) {
        let step = swarm.step();
        // A faulted swarm keeps its last good state and waits for no controller.
        let is_faulted = matches!(swarm.phase, Phase::Faulted(_));
        match self.common_target(step).filter(|_| !is_faulted) {
            Some(until) => swarm.enter(Phase::Stepping { until }),
            None if self.is_lockstep() && swarm.phase.is_moving() => {
                swarm.enter(Phase::Paused(PauseReason::Lockstep));
            }
            None => {}
        }
        let is_waiting = self.targets().any(|target| target > step);
        for member in self.members.values_mut() {
            let is_awaited = !is_faulted && member.is_awaited(step, is_waiting);
            let since = member.since.unwrap_or(swarm.now);
            member.since = is_awaited.then_some(since);
            let silent_since = member.silent_since.unwrap_or(swarm.now);
            let holds = !is_faulted && member.holds(step);
            member.silent_since = holds.then_some(silent_since);
        }
    }

    /// The step that all controllers in lockstep have advanced to, if it is beyond `step`.
    fn common_target(&self, step: u64) -> Option<u64> {
        self.targets().min().filter(|&target| target > step)
    }

    /// The step that each controller in lockstep has advanced to.
    fn targets(&self) -> impl Iterator<Item = u64> {
        let lockstep = self.members.values().filter(|it| it.is_lockstep());
        lockstep.map(|member| member.state.target)
    }

    /// A controller that has joined. The error has the reason of its departure if it had.
    pub fn find(&mut self, controller: &str) -> Result<&mut Member, SwarmError> {
        let member = self.members.get_mut(controller);
        member.ok_or_else(|| {
            let left = self.departures.iter().rev().find(|it| it.0 == controller);
            SwarmError::NotJoined {
                controller: controller.to_owned(),
                left: left.map(|it| it.1),
            }
        })
    }
}

#[cfg(test)]
mod tests;
