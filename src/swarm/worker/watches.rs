//! Conditions: evaluated after each step, on the state that it left.
//!
//! When one holds, the swarm journals the internal command `fired` and executes it. A replay evaluates
//! the conditions too, so that it knows since when they hold, but executes only the journaled commands.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

use fail::fail_point;
use jostle_measures::{View, check_past};
use jostle_physics::model::State;
use jostle_physics::simulation::Change;
use tracing::warn;

use crate::swarm::command::{Command, Which};
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
    /// Evaluates the conditions on the state after a step, replies to the waits that end, and executes the
    /// actions of the conditions that hold. Equal measures are evaluated once.
    pub(super) fn execute_watches(&mut self) -> Option<End> {
        if self.watches.is_empty() && self.waits.is_empty() {
            return None;
        }
        let began = Instant::now();
        let (watches, waits) = (&mut self.watches, &mut self.waits);
        let ((past, mut watching), (past_of_waits, mut waiting)) = (watches.split(), waits.split());
        let view = View::new(&self.simulation.state, past);
        watching.expect(&view);
        waiting.expect(&view);
        let observed = catch_unwind(AssertUnwindSafe(|| {
            fail_point!("condition");
            watching.observe(&view)
        }));
        view.use_past(past_of_waits);
        let held = catch_unwind(AssertUnwindSafe(|| waiting.observe(&view)));
        match held {
            Ok(held) if held.is_empty() => {}
            Ok(held) => {
                let state = self.stamp_and_frame();
                self.waits.settle(&held, &state);
            }
            // It must not fault the swarm, which it does not belong to.
            Err(_) => self.reject_waits(&SwarmError::Panicked),
        }
        self.since_checkpoint.work += began.elapsed();
        self.log_omitted();
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

    /// Logs each condition that is not evaluated any more, once.
    fn log_omitted(&mut self) {
        if self.journal.is_replaying() {
            return;
        }
        for omitted in self.watches.take_omitted() {
            warn!(
                swarm = self.output.name,
                id = omitted.id,
                condition = omitted.condition,
                "a condition is not evaluated, since its measures need too much time or too many earlier states: \
                 remove it or others with `jostle when NAME --cancel ID`"
            );
        }
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
        let id = watch.id();
        let (watches, state) = (&mut self.watches, &self.simulation.state);
        let added = catch_unwind(AssertUnwindSafe(|| watches.add(watch, sender, state)));
        match added.unwrap_or(Err(SwarmError::Panicked))? {
            true if !is_event => Err(SwarmError::HoldsAlready),
            holds => Ok(Outcome::Waits {
                holds,
                id: (!holds).then_some(id),
            }),
        }
    }

    /// Checks the changes of a condition, as those of a scheduled command, and the past of its measures. Their
    /// cost was checked when the command was received.
    pub(super) fn check_watch(&self, watch: &Watch) -> Result<(), SwarmError> {
        let State {
            parameters,
            configuration,
            ..
        } = &self.simulation.state;
        let n = configuration.n();
        check_past(watch.condition.lag(parameters.dt), n)?;
        match &watch.action {
            Action::Pause | Action::Stop | Action::Event(_) => Ok(()),
            Action::Batch(changes, _) => self.check_changes(changes),
        }
    }

    pub(super) fn check_changes(&self, changes: &[Change]) -> Result<(), SwarmError> {
        for (index, change) in changes.iter().enumerate() {
            let checked = self.simulation.check(change);
            checked.map_err(|error| SwarmError::in_batch((index, error)))?;
        }
        Ok(())
    }

    /// Removes conditions.
    pub(super) fn unwatch(&mut self, which: &Which) -> Result<Outcome, SwarmError> {
        phase::next(&self.phase, PhaseInput::Change)?;
        match which {
            Which::Event(event) => self.watches.remove_event(event),
            Which::Id(id) => self.watches.remove_id(id)?,
            Which::All => self.watches.clear(),
        }
        Ok(Outcome::Waits {
            holds: false,
            id: None,
        })
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
