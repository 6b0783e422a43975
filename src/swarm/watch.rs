//! Conditions for which a swarm waits.

use std::sync::Arc;

use jostle_conditions::{Condition, Held};
use jostle_measures::{Past, View, check_past};
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
    /// The condition.
    pub condition: Condition,
    /// What is executed when it holds.
    pub action: Action,
    /// The first step at which it is evaluated; without it the one after the next step.
    pub from: Option<u64>,
    /// The step at which it no longer waits, if there is one.
    pub before: Option<u64>,
    /// Whether it is of a protocol, which may have equal ones.
    pub is_protocol: bool,
    /// The verb and the arguments of the internal command that executes it.
    pub fired: Arc<Sender>,
}

/// What keys the random draws of a command's first change, together with the seed; each further change
/// adds 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Draws {
    /// The number of the command.
    #[default]
    Command,
    /// This number.
    From(u64),
    /// The number of changes by commands of a protocol.
    Protocol,
}

/// What is executed when a condition holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Pause.
    Pause,
    /// Pause, and remove what a protocol has not executed.
    Stop,
    /// Apply all these changes, or none, with this key of their random draws.
    Batch(Vec<Change>, Draws),
    /// Do nothing; the event `fired` has this name.
    Event(Arc<str>),
}

impl Watch {
    /// Whether one of them replaces the other: they are equal and not of a protocol, or have the same
    /// event.
    pub fn is_same(&self, other: &Watch) -> bool {
        match (&self.action, &other.action) {
            (Action::Event(one), Action::Event(other)) => one == other,
            _ => !self.is_protocol && self == other,
        }
    }
}

/// A condition that waits.
#[derive(Clone, Debug)]
pub struct Waiting {
    /// The condition and its action.
    pub watch: Watch,
    /// Since when its comparisons hold.
    pub held: Held,
    /// The step of its command: its measures do not use earlier states, which only other conditions
    /// need.
    pub first: u64,
    /// The client that sent it.
    pub sender: Arc<Sender>,
    /// The text of the condition.
    text: Arc<str>,
}

impl Waiting {
    /// A condition of a command at step `first`, whose comparisons hold since `held`.
    pub fn new(watch: Watch, first: u64, held: Held, sender: Arc<Sender>) -> Self {
        let text = watch.condition.to_string().into();
        Waiting {
            watch,
            held,
            first,
            sender,
            text,
        }
    }

    fn is_event(&self, name: &str) -> bool {
        matches!(&self.watch.action, Action::Event(it) if **it == *name)
    }

    /// Evaluates the condition on a state, once for each step.
    fn observe(&mut self, view: &View<'_>) -> bool {
        let state = view.state();
        if self.watch.from.is_some_and(|from| state.step < from) {
            return false;
        }
        let (condition, n) = (&self.watch.condition, state.configuration.n());
        let dt = state.parameters.dt;
        // As in `get/measures`, which rejects such a measure.
        let mut comparisons = condition.comparisons().iter();
        let is_too_costly = comparisons.any(|it| it.measure.is_too_costly(n));
        if is_too_costly || check_past(condition.lag(dt), n).is_err() {
            self.held = Held::default();
            return false;
        }
        view.ignore_before(self.first);
        condition.observe(view, state.step, dt, &mut self.held)
    }
}

/// The waiting conditions, in the order of arrival.
#[derive(Debug, Default)]
pub struct Watches {
    waiting: Vec<Waiting>,
    /// The states before each step, as far back as the measures need them.
    past: Past,
}

impl Watches {
    /// Adds a condition, instead of the one that it replaces. Returns whether it holds in `state`
    /// already, if that is the first state in which it is evaluated; it is not added then, and replaces
    /// only one with the same event.
    ///
    /// # Errors
    ///
    /// [`SwarmError::TooManyWatches`].
    pub fn add(
        &mut self,
        watch: Watch,
        sender: Arc<Sender>,
        state: &State,
    ) -> Result<bool, SwarmError> {
        let others = || self.waiting.iter().filter(|it| !it.watch.is_same(&watch));
        let bytes: usize = others().map(|it| it.sender.bytes()).sum();
        let count = others().count();
        if count >= MAX_WATCHES || (count > 0 && bytes + sender.bytes() > MAX_BYTES) {
            return Err(SwarmError::TooManyWatches(count));
        }
        let is_evaluated = watch.from.is_some_and(|from| from <= state.step);
        let mut waiting = Waiting::new(watch, state.step, Held::default(), sender);
        let holds = is_evaluated && waiting.observe(&View::new(state, &self.past));
        if !holds || matches!(waiting.watch.action, Action::Event(_)) {
            self.waiting.retain(|it| !it.watch.is_same(&waiting.watch));
        }
        if !holds {
            self.waiting.push(waiting);
        }
        Ok(holds)
    }

    /// Removes a condition that has been executed; of equal ones the first.
    pub fn remove(&mut self, watch: &Watch) {
        if let Some(first) = self.waiting.iter().position(|it| it.watch == *watch) {
            self.waiting.remove(first);
        }
    }

    /// Removes the one with this event.
    pub fn remove_event(&mut self, name: &str) {
        self.waiting.retain(|it| !it.is_event(name));
    }

    /// Whether one with this event waits.
    pub fn has_event(&self, name: &str) -> bool {
        self.waiting.iter().any(|it| it.is_event(name))
    }

    /// Removes all but those with an event.
    pub fn end_protocol(&mut self) {
        let is_event = |it: &Waiting| matches!(it.watch.action, Action::Event(_));
        self.waiting.retain(is_event);
    }

    /// Removes all.
    pub fn clear(&mut self) {
        self.waiting.clear();
        self.past = Past::default();
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Stores the state before a step, after the commands there, if a measure needs it afterwards.
    pub fn record(&mut self, state: &State) {
        if self.waiting.is_empty() && self.past.lag_steps() == 0 {
            return;
        }
        let (dt, n) = (state.parameters.dt, state.configuration.n());
        let lags = self.waiting.iter().map(|it| it.watch.condition.lag(dt));
        let lag = lags.filter(|lag| check_past(*lag, n).is_ok()).max();
        self.past.observe_with(state, lag.unwrap_or(0));
    }

    /// Evaluates all conditions on a state, once for each step. Returns those that hold; if one of them
    /// ends the protocol, of the others only those with an event.
    pub fn observe(&mut self, state: &State) -> Vec<(Watch, Arc<Sender>)> {
        let is_over = |it: &Waiting| it.watch.before.is_some_and(|before| before <= state.step);
        self.waiting.retain(|it| !is_over(it));
        let view = View::new(state, &self.past);
        let holding = self.waiting.iter_mut().filter_map(|it| {
            let holds = it.observe(&view);
            holds.then(|| (it.watch.clone(), it.sender.clone()))
        });
        let mut holding: Vec<(Watch, Arc<Sender>)> = holding.collect();
        if holding.iter().any(|(it, _)| it.action == Action::Stop) {
            holding.retain(|(it, _)| matches!(it.action, Action::Stop | Action::Event(_)));
        }
        holding
    }

    /// The texts of the conditions.
    pub fn texts(&self) -> Vec<Arc<str>> {
        self.waiting.iter().map(|it| it.text.clone()).collect()
    }

    /// All.
    pub fn list(&self) -> Vec<Waiting> {
        self.waiting.clone()
    }

    /// The states of earlier steps.
    pub fn past(&self) -> &Past {
        &self.past
    }

    /// Those of a checkpoint.
    pub fn restore(waiting: Vec<Waiting>, past: Past) -> Self {
        Watches { waiting, past }
    }
}
