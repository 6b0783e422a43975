//! Conditions: evaluated after each step, on the state that it left.
//!
//! When one holds, the swarm journals the internal command `fired` and executes it. A replay evaluates
//! the conditions too, so that it knows since when they hold, but executes only the journaled commands.

use std::sync::Arc;
use std::time::Instant;

use jostle_physics::simulation::{Change, ChangeError};

use crate::swarm::command::Command;
use crate::swarm::error::SwarmError;
use crate::swarm::frame;
use crate::swarm::handle::Outcome;
use crate::swarm::journal::Record;
use crate::swarm::phase::{self, PauseReason, PhaseInput};
use crate::swarm::schedule::Scheduled;
use crate::swarm::sender::Sender;
use crate::swarm::watch::{Action, Watch};
use crate::swarm::worker::{End, Worker};

impl Worker {
    /// Evaluates the conditions on the state after a step, and executes the actions of those that hold.
    pub(super) fn execute_watches(&mut self) -> Option<End> {
        let began = Instant::now();
        let holding = self.watches.observe(&self.simulation.state);
        self.since_checkpoint.work += began.elapsed();
        let at = self.at();
        let fired = match self.journal.is_replaying() {
            true => self.journal.take_fired(at),
            false => self.journal_fired(holding),
        };
        fired.into_iter().find_map(|it| self.execute_waiting(it))
    }

    /// Journals that these conditions hold, all of them or none: after a crash they are evaluated
    /// again only if the step is taken again.
    fn journal_fired(&mut self, holding: Vec<(Watch, Arc<Sender>)>) -> Vec<Scheduled> {
        if holding.is_empty() {
            return Vec::new();
        }
        let fired: Vec<(Watch, Arc<Sender>)> = holding
            .into_iter()
            .map(|(watch, sender)| {
                let fired = Sender {
                    client: sender.client.clone(),
                    ..(*watch.fired).clone()
                };
                (watch, Arc::new(fired))
            })
            .collect();
        let records = fired.iter().map(|(_, sender)| Record::Input {
            at_step: None,
            sender: sender.clone(),
            seq: None,
            unix_secs: frame::unix_secs(),
        });
        let at = self.at();
        self.since_checkpoint.inputs += fired.len() as u64;
        let first = self.journal.append_all(at, records.collect(), at.1);
        let fired = fired.into_iter().zip(first..);
        fired
            .map(|((watch, sender), input)| Scheduled {
                input,
                command: Command::Fired(Box::new(watch)),
                sender,
            })
            .collect()
    }

    /// Adds a condition.
    pub(super) fn watch(
        &mut self,
        watch: Watch,
        sender: Arc<Sender>,
    ) -> Result<Outcome, SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        self.check_watch(&watch)?;
        self.watches.add(watch, sender)?;
        Ok(Outcome::Done)
    }

    /// Checks the changes of a condition, as those of a scheduled command.
    pub(super) fn check_watch(&self, watch: &Watch) -> Result<(), SwarmError> {
        match &watch.action {
            Action::Pause => Ok(()),
            Action::Batch(changes) => self.check_changes(changes),
        }
    }

    pub(super) fn check_changes(&self, changes: &[Change]) -> Result<(), SwarmError> {
        for (index, change) in changes.iter().enumerate() {
            let error = |error: ChangeError| SwarmError::InBatch {
                index,
                error: Box::new(error.into()),
            };
            self.simulation.check(change).map_err(error)?;
        }
        Ok(())
    }

    /// Removes all conditions.
    pub(super) fn unwatch(&mut self) -> Result<Outcome, SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        self.watches.clear();
        Ok(Outcome::Done)
    }

    /// Executes the action of a condition that holds.
    pub(super) fn fire(&mut self, watch: &Watch) -> Result<Outcome, SwarmError> {
        match &watch.action {
            // At the end of its run the swarm is paused already.
            Action::Pause if !self.phase.is_moving() => Ok(Outcome::Done),
            Action::Pause => self.pause(PauseReason::Condition),
            Action::Batch(changes) => self.change(changes, None).map(Outcome::Batch),
        }
    }
}
