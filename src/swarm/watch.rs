//! Conditions for which a swarm waits.

use std::sync::Arc;

use jostle_conditions::{Condition, Held};
use jostle_measures::{Past, View};
use jostle_physics::model::State;
use jostle_physics::simulation::Change;

use crate::swarm::error::SwarmError;
use crate::swarm::sender::Sender;

/// Maximum number of waiting conditions.
pub const MAX_WATCHES: usize = 16;

/// Maximum bytes of their commands.
const MAX_BYTES: usize = 256 * 1024;

/// What a swarm does once a condition holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Watch {
    /// The condition. None of its measures needs earlier states.
    pub condition: Condition,
    /// What is executed when it holds.
    pub action: Action,
    /// The verb and the arguments of the internal command that executes it.
    pub fired: Arc<Sender>,
}

/// What is executed when a condition holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Pause.
    Pause,
    /// Apply all these changes, or none.
    Batch(Vec<Change>),
}

/// A condition that waits.
#[derive(Clone, Debug)]
pub struct Waiting {
    /// The condition and its action.
    pub watch: Watch,
    /// Since when its comparisons hold.
    pub held: Held,
    /// The client that sent it.
    pub sender: Arc<Sender>,
    /// The text of the condition.
    text: Arc<str>,
}

impl Waiting {
    /// A condition whose comparisons hold since `held`.
    pub fn new(watch: Watch, held: Held, sender: Arc<Sender>) -> Self {
        let text = watch.condition.to_string().into();
        Waiting {
            watch,
            held,
            sender,
            text,
        }
    }
}

/// The waiting conditions, in the order of arrival.
#[derive(Debug, Default)]
pub struct Watches(Vec<Waiting>);

impl Watches {
    /// Adds a condition, instead of one with the same action.
    ///
    /// # Errors
    ///
    /// [`SwarmError::TooManyWatches`].
    pub fn add(&mut self, watch: Watch, sender: Arc<Sender>) -> Result<(), SwarmError> {
        let others = || self.0.iter().filter(|it| it.watch != watch);
        let bytes: usize = others().map(|it| it.sender.bytes()).sum();
        let count = others().count();
        if count >= MAX_WATCHES || (count > 0 && bytes + sender.bytes() > MAX_BYTES) {
            return Err(SwarmError::TooManyWatches(count));
        }
        self.remove(&watch);
        self.0.push(Waiting::new(watch, Held::default(), sender));
        Ok(())
    }

    /// Removes a condition that has been executed.
    pub fn remove(&mut self, watch: &Watch) {
        self.0.retain(|it| it.watch != *watch);
    }

    /// Removes all.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Evaluates all conditions on a state, once for each step. Returns those that hold.
    pub fn observe(&mut self, state: &State) -> Vec<(Watch, Arc<Sender>)> {
        if self.0.is_empty() {
            return Vec::new();
        }
        let past = Past::new(0);
        let view = View::new(state, &past);
        let (step, dt) = (state.step, state.parameters.dt);
        let n = state.configuration.n();
        let holding = self.0.iter_mut().filter_map(|it| {
            // As in `get/measures`, which rejects such a measure.
            let comparisons = it.watch.condition.comparisons().iter();
            if comparisons
                .into_iter()
                .any(|it| it.measure.is_too_costly(n))
            {
                it.held = Held::default();
                return None;
            }
            let holds = it.watch.condition.observe(&view, step, dt, &mut it.held);
            holds.then(|| (it.watch.clone(), it.sender.clone()))
        });
        holding.collect()
    }

    /// The texts of the conditions.
    pub fn texts(&self) -> Vec<Arc<str>> {
        self.0.iter().map(|it| it.text.clone()).collect()
    }

    /// All.
    pub fn list(&self) -> Vec<Waiting> {
        self.0.clone()
    }

    /// Those of a checkpoint.
    pub fn restore(waiting: Vec<Waiting>) -> Self {
        Watches(waiting)
    }
}
