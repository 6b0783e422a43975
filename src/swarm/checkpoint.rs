//! The whole state of a swarm at one step, for recovery, forks and snapshots.

use std::sync::Arc;

use jostle_measures::Past;
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
    /// The number of the last event.
    pub events: u64,
    /// The number of journal lines that it includes.
    pub lines: u64,
    /// Whether the daemon stopped cleanly after it, so that no events follow it.
    pub is_last: bool,
}

impl Checkpoint {
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
    pub fn for_another(mut self, phase: Phase) -> Self {
        let is_event = |action: &watch::Action| matches!(action, watch::Action::Event(_));
        self.watches.retain(|it| !is_event(&it.watch.action));
        self.scheduled.retain(|(_, it)| match &it.command {
            Command::Watch(watch) => !is_event(&watch.action),
            _ => true,
        });
        if self.watches.is_empty() {
            self.past = Past::default();
        }
        for (k, (_, scheduled)) in self.scheduled.iter_mut().enumerate() {
            // Their lines are in another journal: numbers that this one does not reach.
            scheduled.input = u64::MAX - k as u64;
        }
        Checkpoint {
            phase,
            rate: self.rate,
            scheduled: self.scheduled,
            watches: self.watches,
            past: self.past,
            annotations: self.annotations,
            protocol_draws: self.protocol_draws,
            ..Checkpoint::start(simulation::Checkpoint {
                epoch: 1,
                ..self.simulation
            })
        }
    }
}
