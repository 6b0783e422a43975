//! A swarm as a whole at one step: what it is kept, copied and brought back by.

use std::sync::Arc;

use jostle_physics::simulation::{self, Rate};

use crate::swarm::membership::ControllerState;
use crate::swarm::phase::Phase;
use crate::swarm::schedule::Scheduled;
use crate::swarm::sender::Sender;

/// A swarm as a whole: two swarms with equal checkpoints have one future.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// The simulation.
    pub simulation: simulation::Checkpoint,
    /// What it does.
    pub phase: Phase,
    /// How fast it is to run.
    pub rate: Rate,
    /// Commands that wait for their step: each with that step, in the order they come due.
    pub scheduled: Vec<(u64, Scheduled)>,
    /// The `step` that is being carried out: where it began, and who sent it.
    pub pending: Option<(u64, Arc<Sender>)>,
    /// The controllers that have joined.
    pub controllers: Vec<(String, ControllerState)>,
    /// How many events there have been.
    pub events: u64,
    /// How many lines of its journal it contains.
    pub lines: u64,
    /// Whether the swarm was put away after it, so that nothing can have come since.
    pub is_last: bool,
}

impl Checkpoint {
    /// The same swarm as the beginning of another one: paused, with a history of its own.
    #[must_use]
    pub fn for_another(mut self, phase: Phase) -> Self {
        for (k, (_, waiting)) in self.scheduled.iter_mut().enumerate() {
            // They stand on lines of another journal: numbers that this one never gets to.
            waiting.input = u64::MAX - k as u64;
        }
        Checkpoint {
            phase,
            pending: None,
            controllers: Vec::new(),
            simulation: simulation::Checkpoint {
                epoch: 1,
                ..self.simulation
            },
            events: 0,
            lines: 0,
            is_last: false,
            ..self
        }
    }
}
