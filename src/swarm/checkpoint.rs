//! The whole state of a swarm at one step, for recovery, forks and snapshots.

use std::sync::Arc;

use jostle_measures::Past;
use jostle_physics::model::MODEL_VERSION;
use jostle_physics::simulation::{self, Rate};

use crate::swarm::command::Command;
use crate::swarm::membership::ControllerState;
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::schedule::Scheduled;
use crate::swarm::sender::Sender;
use crate::swarm::watch;

/// The whole state of a swarm: swarms with equal checkpoints evolve equally. On disk it is called a
/// checkpoint, on the wire a snapshot.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// The simulation.
    pub simulation: simulation::Checkpoint,
    /// The phase.
    pub phase: Phase,
    /// The rate.
    pub rate: Rate,
    /// Scheduled commands, each with its step, in the order of execution.
    pub scheduled: Vec<(u64, Scheduled)>,
    /// The conditions that wait, in the order of arrival.
    pub watches: Vec<watch::Waiting>,
    /// The states of earlier steps that their measures need.
    pub past: Past,
    /// The `step` that is being executed: where it began, and its client.
    pub pending: Option<(u64, Arc<Sender>)>,
    /// The controllers that have joined.
    pub controllers: Vec<(String, ControllerState)>,
    /// How many annotations were applied. The `seq` of the simulation, which keys random draws, does
    /// not count them.
    pub annotations: u64,
    /// The number of changes by commands of a protocol.
    pub protocol_draws: u64,
    /// Whether it rejects `delete` and `reset`.
    pub is_protected: bool,
    /// The version of the model that computed the state.
    pub model_version: u32,
    /// The versions that computed steps before, oldest first.
    pub earlier_models: Vec<EarlierModel>,
    /// The number of the last event.
    pub events: u64,
    /// The number of journal lines that it includes.
    pub lines: u64,
    /// Whether the daemon stopped cleanly after it, so that no events follow it.
    pub is_last: bool,
}

/// A version of the model, and the last state that it computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EarlierModel {
    /// The version.
    pub version: u32,
    /// The epoch of the state.
    pub epoch: u64,
    /// The step of the state.
    pub step: u64,
}

impl Checkpoint {
    /// Whether an earlier version of the model computed the state: a replay from it gives other states
    /// than those that were published.
    pub fn is_of_earlier_model(&self) -> bool {
        self.model_version != MODEL_VERSION
    }

    /// The same state, from which this version of the model goes on.
    #[must_use]
    pub fn taken_over(mut self) -> Self {
        if self.is_of_earlier_model() {
            self.earlier_models.push(EarlierModel {
                version: self.model_version,
                epoch: self.simulation.epoch,
                step: self.simulation.state.step,
            });
            self.model_version = MODEL_VERSION;
        }
        self
    }

    /// The start of a new swarm.
    pub fn start(simulation: simulation::Checkpoint) -> Self {
        Checkpoint {
            phase: Phase::Paused(PauseReason::Created),
            rate: simulation.spec.rate,
            simulation,
            scheduled: Vec::new(),
            watches: Vec::new(),
            past: Past::default(),
            pending: None,
            controllers: Vec::new(),
            annotations: 0,
            protocol_draws: 0,
            is_protected: false,
            model_version: MODEL_VERSION,
            earlier_models: Vec::new(),
            events: 0,
            lines: 0,
            is_last: false,
        }
    }

    /// The number of the last command, annotations included.
    pub fn seq(&self) -> u64 {
        self.simulation.seq + self.annotations
    }

    /// The start of another swarm with the same state: paused, with a history of its own, unprotected, and
    /// without the conditions with an event, for which clients of the first one wait.
    #[must_use]
    pub fn for_another(self, phase: Phase) -> Self {
        let mut this = self.taken_over();
        let is_event = |action: &watch::Action| matches!(action, watch::Action::Event(_));
        this.watches.retain(|it| !is_event(&it.watch.action));
        this.scheduled.retain(|(_, it)| match &it.command {
            Command::Watch(watch) => !is_event(&watch.action),
            _ => true,
        });
        if this.watches.is_empty() {
            this.past = Past::default();
        }
        for (k, (_, scheduled)) in this.scheduled.iter_mut().enumerate() {
            // Their lines are in another journal: numbers that this one does not reach.
            scheduled.input = u64::MAX - k as u64;
        }
        Checkpoint {
            phase,
            rate: this.rate,
            scheduled: this.scheduled,
            watches: this.watches,
            past: this.past,
            earlier_models: this.earlier_models,
            annotations: this.annotations,
            protocol_draws: this.protocol_draws,
            ..Checkpoint::start(simulation::Checkpoint {
                epoch: 1,
                ..this.simulation
            })
        }
    }
}
