//! Conditions: evaluated after each step, on the state that it left.
//!
//! When one holds, the swarm journals the internal command `fired` and executes it. A replay evaluates
//! the conditions too, so that it knows since when they hold, but executes only the journaled commands.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

use fail::fail_point;
use jostle_measures::check_past;
use jostle_physics::model::State;
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
        if self.watches.is_empty() {
            return None;
        }
        let began = Instant::now();
        let (watches, state) = (&mut self.watches, &self.simulation.state);
        let observed = catch_unwind(AssertUnwindSafe(|| {
            fail_point!("condition");
            watches.observe(state)
        }));
        self.since_checkpoint.work += began.elapsed();
        let Ok(holding) = observed else {
            self.fault("a defect: the evaluation of a condition panicked".into());
            return None;
        };
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
        let is_event = matches!(watch.action, Action::Event(_));
        let (watches, state) = (&mut self.watches, &self.simulation.state);
        let added = catch_unwind(AssertUnwindSafe(|| watches.add(watch, sender, state)));
        match added.unwrap_or(Err(SwarmError::Panicked))? {
            true if !is_event => Err(SwarmError::HoldsAlready),
            holds => Ok(Outcome::Waits { holds }),
        }
    }

    /// Checks the changes of a condition, as those of a scheduled command, and the past of its measures.
    pub(super) fn check_watch(&self, watch: &Watch) -> Result<(), SwarmError> {
        let State {
            parameters,
            configuration,
            ..
        } = &self.simulation.state;
        check_past(watch.condition.lag(parameters.dt), configuration.n())?;
        match &watch.action {
            Action::Pause | Action::Stop | Action::Event(_) => Ok(()),
            Action::Batch(changes, _) => self.check_changes(changes),
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

    /// Removes all conditions, or the one with this event.
    pub(super) fn unwatch(&mut self, event: Option<&str>) -> Result<Outcome, SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        match event {
            Some(event) => self.watches.remove_event(event),
            None => self.watches.clear(),
        }
        Ok(Outcome::Waits { holds: false })
    }

    /// Executes the action of a condition that holds.
    pub(super) fn fire(&mut self, watch: &Watch) -> Result<Outcome, SwarmError> {
        match &watch.action {
            Action::Pause => self.pause(PauseReason::Condition),
            Action::Stop => {
                let paused = self.pause(PauseReason::Condition)?;
                self.watches.end_protocol();
                self.drop_scheduled(SwarmError::Ended);
                Ok(paused)
            }
            Action::Batch(changes, draws) => self.change(changes, *draws).map(Outcome::Batch),
            Action::Event(_) => {
                phase::next(&self.phase, PhaseInput::Change)?;
                Ok(Outcome::Done)
            }
        }
    }
}
