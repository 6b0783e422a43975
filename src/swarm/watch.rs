//! Conditions for which a swarm waits.

use std::borrow::Cow;
use std::sync::Arc;

use jostle_conditions::{Condition, Held};
use jostle_measures::{Past, View, check_cost, check_past};
use jostle_physics::model::State;
use jostle_physics::simulation::Change;

use crate::swarm::awaited::{WatchAction, WatchStatus, WatchSummary};
use crate::swarm::error::SwarmError;
use crate::swarm::sender::Sender;

/// Maximum number of waiting conditions.
pub const MAX_WATCHES: usize = 16;

/// Maximum bytes of their commands.
const MAX_BYTES: usize = 256 * 1024;

/// The length of the id of a condition, in hexadecimal digits of the hash of its command.
const ID_LENGTH: usize = 8;

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
    /// The changes that it applies when it holds.
    pub fn changes(&self) -> &[Change] {
        match &self.action {
            Action::Batch(changes, _) => changes,
            Action::Pause | Action::Stop | Action::Event(_) => &[],
        }
    }

    /// By which `when` with `cancel` removes it.
    pub fn id(&self) -> String {
        let hash = blake3::hash(self.fired.args.as_bytes()).to_hex();
        hash[..ID_LENGTH].to_owned()
    }

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
    /// What the status has of it.
    summary: Arc<WatchSummary>,
    /// Whether it was not evaluated at a step.
    is_omitted: bool,
}

impl Waiting {
    /// A condition of a command at step `first`, whose comparisons hold since `held`.
    pub fn new(watch: Watch, first: u64, held: Held, sender: Arc<Sender>) -> Self {
        let (action, event) = match &watch.action {
            Action::Pause | Action::Stop => (WatchAction::Pause, None),
            Action::Batch(..) => (WatchAction::Commands, None),
            Action::Event(event) => (WatchAction::Event, Some(event.clone())),
        };
        let summary = Arc::new(WatchSummary {
            id: watch.id(),
            condition: watch.condition.to_string(),
            action,
            event,
            client: sender.client.clone(),
        });
        Waiting {
            watch,
            held,
            first,
            sender,
            summary,
            is_omitted: false,
        }
    }

    /// Whether it is evaluated for so many individuals, on its own; as in `get/measures`, which rejects a
    /// measure that is too costly.
    fn fits(&self, n: usize, dt: f64) -> bool {
        let condition = &self.watch.condition;
        !condition.measures().any(|it| it.is_too_costly(n))
            && check_past(condition.lag(dt), n).is_ok()
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
        view.ignore_before(self.first);
        let condition = &self.watch.condition;
        condition.observe(view, state.step, state.parameters.dt, &mut self.held)
    }
}

/// The waiting conditions, in the order of arrival.
#[derive(Debug, Default)]
pub struct Watches {
    waiting: Vec<Waiting>,
    /// The states before each step, as far back as the measures need them.
    past: Past,
    /// Which of them are evaluated, and the number of individuals for which that was decided; `None` after a
    /// change.
    evaluated: Option<(usize, Vec<bool>)>,
    /// Those that are not evaluated any more, until they are reported.
    omitted: Vec<Arc<WatchSummary>>,
}

/// Evaluates conditions.
pub struct Observer<'a> {
    waiting: &'a mut Vec<Waiting>,
    evaluated: &'a mut Option<(usize, Vec<bool>)>,
    omitted: &'a mut Vec<Arc<WatchSummary>>,
}

impl Observer<'_> {
    /// Announces the measures.
    pub fn expect(&self, view: &View<'_>) {
        let measures = self.waiting.iter().map(|it| it.watch.condition.measures());
        measures.flatten().for_each(|it| it.announce(view));
    }

    /// Evaluates all conditions on a state, once for each step. Returns those that hold; if one of them
    /// ends the protocol, of the others only those with an event.
    ///
    /// If the swarm has grown, so that a condition is too large or all together cost too much, the newest ones
    /// are not evaluated, and do not hold.
    pub fn observe(&mut self, view: &View<'_>) -> Vec<(Watch, Arc<Sender>)> {
        let state = view.state();
        let is_over = |it: &Waiting| it.watch.before.is_some_and(|before| before <= state.step);
        if self.waiting.iter().any(is_over) {
            self.waiting.retain(|it| !is_over(it));
            *self.evaluated = None;
        }
        let (n, dt) = (state.configuration.n(), state.parameters.dt);
        let decided = self.evaluated.take().filter(|(of, _)| *of == n);
        let (_, evaluated) = self
            .evaluated
            .insert(decided.unwrap_or_else(|| (n, decide(self.waiting, n, dt))));
        let mut holding = Vec::new();
        for (it, is_evaluated) in self.waiting.iter_mut().zip(evaluated) {
            if !*is_evaluated {
                it.held = Held::default();
                if !std::mem::replace(&mut it.is_omitted, true) {
                    self.omitted.push(it.summary.clone());
                }
            } else if it.observe(view) {
                holding.push((it.watch.clone(), it.sender.clone()));
            }
        }
        if holding.iter().any(|(it, _)| it.action == Action::Stop) {
            holding.retain(|(it, _)| matches!(it.action, Action::Stop | Action::Event(_)));
        }
        holding
    }
}

/// Which conditions are evaluated for so many individuals.
fn decide(waiting: &[Waiting], n: usize, dt: f64) -> Vec<bool> {
    let mut accepted: Vec<&Condition> = Vec::new();
    let mut decided = Vec::with_capacity(waiting.len());
    for it in waiting {
        let condition = &it.watch.condition;
        let all = accepted.iter().copied().chain([condition]);
        let is_evaluated = it.fits(n, dt) && check_cost(all.map(Condition::measures), n).is_ok();
        if is_evaluated {
            accepted.push(condition);
        }
        decided.push(is_evaluated);
    }
    decided
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
        let fits = || waiting.fits(state.configuration.n(), state.parameters.dt);
        let holds = is_evaluated && fits() && waiting.observe(&View::new(state, &self.past));
        if !holds || matches!(waiting.watch.action, Action::Event(_)) {
            self.waiting.retain(|it| !it.watch.is_same(&waiting.watch));
        }
        if !holds {
            self.waiting.push(waiting);
        }
        self.evaluated = None;
        Ok(holds)
    }

    /// Removes a condition that has been executed; of equal ones the first.
    pub fn remove(&mut self, watch: &Watch) {
        if let Some(first) = self.waiting.iter().position(|it| it.watch == *watch) {
            self.waiting.remove(first);
            self.evaluated = None;
        }
    }

    /// Removes the one of this id; of equal ones the first.
    ///
    /// # Errors
    ///
    /// [`SwarmError::NoCondition`].
    pub fn remove_id(&mut self, id: &str) -> Result<(), SwarmError> {
        let index = self.waiting.iter().position(|it| it.summary.id == id);
        let index = index.ok_or_else(|| SwarmError::NoCondition(id.to_owned()))?;
        self.waiting.remove(index);
        self.evaluated = None;
        Ok(())
    }

    /// Removes the one with this event.
    pub fn remove_event(&mut self, name: &str) {
        self.waiting.retain(|it| !it.is_event(name));
        self.evaluated = None;
    }

    /// Whether one with this event waits.
    pub fn has_event(&self, name: &str) -> bool {
        self.waiting.iter().any(|it| it.is_event(name))
    }

    /// Removes all but those with an event.
    pub fn end_protocol(&mut self) {
        let is_event = |it: &Waiting| matches!(it.watch.action, Action::Event(_));
        self.waiting.retain(is_event);
        self.evaluated = None;
    }

    /// Removes all.
    pub fn clear(&mut self) {
        *self = Watches::default();
    }

    /// The changes of each that applies some.
    pub fn changes(&self) -> impl Iterator<Item = &[Change]> {
        self.waiting.iter().map(|it| it.watch.changes())
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

    /// The earlier states that the measures use, and what evaluates the conditions.
    pub fn split(&mut self) -> (&Past, Observer<'_>) {
        let observer = Observer {
            waiting: &mut self.waiting,
            evaluated: &mut self.evaluated,
            omitted: &mut self.omitted,
        };
        (&self.past, observer)
    }

    /// Checks that another condition does not cost too much beside those that wait or are scheduled and that
    /// it does not replace.
    ///
    /// # Errors
    ///
    /// [`SwarmError::TooCostlyTogether`].
    pub fn check_cost<'a>(
        &'a self,
        watch: &'a Watch,
        scheduled: impl Iterator<Item = &'a Watch>,
        n: usize,
    ) -> Result<(), SwarmError> {
        let others = self.waiting.iter().map(|it| &it.watch).chain(scheduled);
        let others = others.filter(|it| !it.is_same(watch));
        let conditions = others.chain([watch]).map(|it| it.condition.measures());
        check_cost(conditions, n)?;
        Ok(())
    }

    /// What the status has of the conditions, for so many individuals.
    pub fn statuses(&self, n: usize, dt: f64) -> Vec<WatchStatus> {
        let decided = match &self.evaluated {
            Some((of, evaluated)) if *of == n => Cow::Borrowed(evaluated),
            _ => Cow::Owned(decide(&self.waiting, n, dt)),
        };
        let status = |(it, is_evaluated): (&Waiting, &bool)| WatchStatus {
            summary: it.summary.clone(),
            is_evaluated: *is_evaluated,
        };
        self.waiting.iter().zip(&*decided).map(status).collect()
    }

    /// Takes the conditions that are not evaluated any more since they were last taken.
    pub fn take_omitted(&mut self) -> Vec<Arc<WatchSummary>> {
        std::mem::take(&mut self.omitted)
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
        Watches {
            waiting,
            past,
            ..Watches::default()
        }
    }
}
