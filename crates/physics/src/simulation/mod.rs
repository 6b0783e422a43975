//! A swarm's state, the steps that advance it and the changes that are applied to it between steps,
//! without thread or clock.

pub mod change;
pub mod error;
mod steer;

use crate::model::body::gaps;
use crate::model::configuration::Configuration;
use crate::model::parameters::{ContactRule, Parameters, check_coordinate, check_preference};
use crate::model::selection::{Candidates, Selection, select};
use crate::model::{State, injection, reshape, start};
use crate::observables::{self, Definitions, Order, RunningMeans};
use crate::stepper::{StepError, StepReport, Stepper};

pub use change::{
    Change, ChangeKind, ChangeOutcome, Placement, Rate, Reservation, ReserveMemory, SetPoints,
    SettingValues, Settings, Spec, Start, check_weights,
};
pub use error::{ChangeError, ReserveError};

/// Accuracy and work of the last step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exactness {
    /// The residual of its optimality conditions, in body sizes.
    pub residual: f64,
    /// The number of steps since the start or reset that missed the target residual.
    pub degraded: u64,
    /// The number of contacts of its program.
    pub contacts: usize,
    /// The number of linear systems that the solver factored.
    pub iterations: usize,
}

/// A simulation at one step. Two simulations with equal checkpoints have the same future under the
/// same commands on x86-64, aarch64 and wasm32 with any number of threads, in programs of one version.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// The spec of its start.
    pub spec: Spec,
    /// The state.
    pub state: State,
    /// Steps between two published states.
    pub publish_every: u64,
    /// Names of the measures that are published.
    pub measures: Vec<String>,
    /// The longest time in seconds for which the caller waits for a controller that sends nothing.
    pub max_idle_secs: Option<f64>,
    /// The number of the run: 1 at first, and one more after each reset.
    pub epoch: u64,
    /// The number of the last command; see [`Simulation::seq`].
    pub seq: u64,
    /// Means over the steps since the start or reset.
    pub means: RunningMeans,
    /// Accuracy and work of the last step.
    pub exactness: Exactness,
}

/// A swarm's state, its stepper and means over its steps.
pub struct Simulation {
    /// The spec of its start; a reset returns to it.
    pub spec: Spec,
    /// The state, on which alone future steps depend.
    pub state: State,
    /// Steps between two published states.
    pub publish_every: u64,
    /// Names of the measures that are published.
    pub measures: Vec<String>,
    /// The longest time in seconds for which the caller waits for a controller that sends nothing.
    pub max_idle_secs: Option<f64>,
    /// The number of the run: 1 at first, and one more after each reset.
    pub epoch: u64,
    /// The number of the last command, which was the key of its random draws; see [`Self::apply`].
    pub seq: u64,
    /// Means over the steps since the start or reset.
    pub means: RunningMeans,
    /// Accuracy and work of the last step.
    pub exactness: Exactness,
    /// Order and drift of the state before the last step.
    pub order_before: Order,
    /// The definitions of order and drift; not part of a checkpoint.
    pub definitions: Definitions,
    reserve: ReserveMemory,
    stepper: Stepper,
}

/// A saved copy of everything that changes can alter.
pub struct Rollback {
    state: State,
    publish_every: u64,
    measures: Vec<String>,
    max_idle_secs: Option<f64>,
    seq: u64,
}

/// A start that is built and not yet applied.
pub struct Restart {
    spec: Spec,
    state: State,
}

impl Simulation {
    /// Creates a simulation from `spec`. The size of the group has no limit.
    ///
    /// # Errors
    ///
    /// [`ChangeError::Parameters`] and [`ChangeError::Start`].
    pub fn new(spec: &Spec) -> Result<Self, ChangeError> {
        Self::with_reserve(spec.clone(), Box::new(|_| Ok(())))
    }

    /// As [`Self::new`], with a callback that is called before the size of the group changes.
    ///
    /// # Errors
    ///
    /// [`ChangeError::Parameters`] and [`ChangeError::Start`].
    pub fn with_reserve(spec: Spec, reserve: ReserveMemory) -> Result<Self, ChangeError> {
        let state = begin(&spec)?;
        Ok(Simulation {
            publish_every: spec.publish_every,
            measures: spec.measures.clone(),
            max_idle_secs: None,
            spec,
            state,
            epoch: 1,
            seq: 0,
            means: RunningMeans::default(),
            exactness: Exactness::default(),
            order_before: Order::default(),
            definitions: Definitions::default(),
            reserve,
            stepper: Stepper::new(),
        })
    }

    /// Continues from a checkpoint, with a callback that is called before the size of the group
    /// changes. Checks nothing; `jostle_convert::snapshot::check` does, for snapshots from clients.
    pub fn from_checkpoint(checkpoint: &Checkpoint, reserve: ReserveMemory) -> Self {
        Simulation {
            spec: checkpoint.spec.clone(),
            state: checkpoint.state.clone(),
            publish_every: checkpoint.publish_every,
            measures: checkpoint.measures.clone(),
            max_idle_secs: checkpoint.max_idle_secs,
            epoch: checkpoint.epoch,
            seq: checkpoint.seq,
            means: checkpoint.means,
            exactness: checkpoint.exactness,
            order_before: Order::default(),
            definitions: Definitions::default(),
            reserve,
            stepper: Stepper::new(),
        }
    }

    /// Returns a checkpoint of the present step.
    pub fn checkpoint(&self) -> Checkpoint {
        Checkpoint {
            spec: self.spec.clone(),
            state: self.state.clone(),
            publish_every: self.publish_every,
            measures: self.measures.clone(),
            max_idle_secs: self.max_idle_secs,
            epoch: self.epoch,
            seq: self.seq,
            means: self.means,
            exactness: self.exactness,
        }
    }

    /// Returns the BLAKE3 hash of the state. Two simulations with equal hashes take the same steps
    /// on x86-64, aarch64 and wasm32 with any number of threads, in programs of one version. Random selections
    /// and injections also depend on `seq`, which is not hashed.
    pub fn state_hash(&self) -> [u8; 32] {
        self.state.hash()
    }

    /// Replaces the callback that is called before the size of the group changes.
    pub fn set_reserve(&mut self, reserve: ReserveMemory) {
        self.reserve = reserve;
    }

    /// Returns the stepper, with the work of the last step.
    pub fn stepper(&self) -> &Stepper {
        &self.stepper
    }

    /// Takes one step.
    ///
    /// # Errors
    ///
    /// [`StepError`]; the state is then unchanged.
    pub fn step(&mut self) -> Result<StepReport, StepError> {
        let common = observables::common_direction(&self.state.configuration, self.definitions);
        let report = self.stepper.step(&mut self.state)?;
        let headings = self.stepper.headings().iter().copied();
        self.order_before = observables::order_of(headings, common);
        self.means.add(&self.order_before);
        self.exactness = Exactness {
            residual: report.residual,
            degraded: self.exactness.degraded + u64::from(report.degraded),
            contacts: report.contacts,
            iterations: report.iterations,
        };
        Ok(report)
    }

    /// Builds the start again, with a new seed or the old one. The simulation is unchanged.
    ///
    /// # Errors
    ///
    /// [`ChangeError::Start`] if no start can be drawn with the new seed, [`ChangeError::Reserve`]
    /// if the group has shrunk and the callback rejects its size at the start.
    pub fn build_start(&self, seed: Option<u64>) -> Result<Restart, ChangeError> {
        let mut spec = self.spec.clone();
        spec.seed = seed.unwrap_or(spec.seed);
        (self.reserve)(Reservation::Return(spec.n))?;
        match begin(&spec) {
            Ok(state) => Ok(Restart { spec, state }),
            Err(error) => {
                (self.reserve)(Reservation::Return(self.n()))?;
                Err(error)
            }
        }
    }

    /// Applies a start, in a new epoch.
    pub fn restart(&mut self, start: Restart) {
        self.publish_every = start.spec.publish_every;
        self.measures.clone_from(&start.spec.measures);
        self.spec = start.spec;
        self.state = start.state;
        self.epoch += 1;
        self.means = RunningMeans::default();
        self.exactness = Exactness::default();
        self.stepper = Stepper::new();
    }

    /// Saves everything that changes can alter.
    pub fn save(&self) -> Rollback {
        Rollback {
            state: self.state.clone(),
            publish_every: self.publish_every,
            measures: self.measures.clone(),
            max_idle_secs: self.max_idle_secs,
            seq: self.seq,
        }
    }

    /// Undoes every change since `saved` was made.
    pub fn rollback(&mut self, saved: Rollback) {
        self.state = saved.state;
        self.publish_every = saved.publish_every;
        self.measures = saved.measures;
        self.max_idle_secs = saved.max_idle_secs;
        self.seq = saved.seq;
        // The callback admits a size that it admitted before.
        let _ = (self.reserve)(Reservation::Return(self.n()));
    }

    /// Applies the changes in turn, as the commands with the numbers `first`, `first + 1` and so on.
    ///
    /// # Errors
    ///
    /// The index of the change that was rejected, and the reason. The changes before it have been
    /// applied: undo them with [`Self::rollback`].
    pub fn apply_all_at(
        &mut self,
        first: u64,
        changes: &[Change],
    ) -> Result<Vec<(ChangeKind, ChangeOutcome)>, (usize, ChangeError)> {
        let mut outcomes = Vec::with_capacity(changes.len());
        for ((index, change), seq) in changes.iter().enumerate().zip(first..) {
            let outcome = self.apply_at(seq, change).map_err(|error| (index, error))?;
            outcomes.push((change.kind(), outcome));
        }
        Ok(outcomes)
    }

    /// Checks the numbers of a change against the present state, without applying it.
    ///
    /// # Errors
    ///
    /// [`ChangeError::Parameters`].
    pub fn check(&self, change: &Change) -> Result<(), ChangeError> {
        match change {
            Change::Set(settings) => self.with(settings).map(drop),
            Change::Inform {
                direction, weight, ..
            } => self.preference(*direction, *weight).map(drop),
            Change::Inject {
                informed: Some((direction, weight)),
                ..
            } => self.preference(*direction, *weight).map(drop),
            Change::Inject { informed: None, .. } | Change::Uninform(_) | Change::Remove(_) => {
                Ok(())
            }
        }
    }

    /// Applies one change, as the command after the last one: [`Self::seq`] grows by 1, and random draws
    /// of two equal changes differ. A daemon that executes the same changes, each as one command,
    /// makes the same draws.
    ///
    /// # Errors
    ///
    /// [`ChangeError`]; the simulation is then unchanged.
    pub fn apply(&mut self, change: &Change) -> Result<ChangeOutcome, ChangeError> {
        self.apply_at(self.seq + 1, change)
    }

    /// Applies one change, as the command with the number `seq`: two changes with the same number make
    /// the same random draws.
    ///
    /// # Errors
    ///
    /// [`ChangeError`]; the simulation is then unchanged.
    pub fn apply_at(&mut self, seq: u64, change: &Change) -> Result<ChangeOutcome, ChangeError> {
        let before = std::mem::replace(&mut self.seq, seq);
        let outcome = self.apply_present(change);
        if outcome.is_err() {
            self.seq = before;
        }
        outcome
    }

    fn apply_present(&mut self, change: &Change) -> Result<ChangeOutcome, ChangeError> {
        match change {
            Change::Set(settings) => self.set(settings),
            Change::Inform {
                selection,
                direction,
                weight,
                for_time,
            } => self.inform(selection, *direction, *weight, *for_time),
            Change::Uninform(selection) => {
                let chosen = self.choose(Candidates::Informed, selection)?;
                for &individual in &chosen {
                    self.state.configuration.uninform(individual);
                }
                Ok(self.changed(&chosen))
            }
            Change::Inject { place, informed } => self.inject(place, *informed),
            Change::Remove(selection) => self.remove(selection),
        }
    }

    /// Measures the present order and drift.
    pub fn order(&self) -> Order {
        observables::order(&self.state.configuration, self.definitions)
    }

    fn setting_values(&self) -> SettingValues {
        SettingValues {
            parameters: self.state.parameters,
            publish_every: self.publish_every,
            measures: self.measures.clone(),
            max_idle_secs: self.max_idle_secs,
        }
    }

    /// Returns the parameters with these settings, checked.
    fn with(&self, settings: &Settings) -> Result<Parameters, ChangeError> {
        let parameters = settings.of(self.state.parameters);
        parameters.check(self.state.configuration.largest_weight())?;
        Ok(parameters)
    }

    fn set(&mut self, settings: &Settings) -> Result<ChangeOutcome, ChangeError> {
        let before = self.setting_values();
        let parameters = self.with(settings)?;
        let may_cross = |parameters: &Parameters| parameters.contacts == ContactRule::Closest;
        if may_cross(&before.parameters) && !may_cross(&parameters) {
            let pairs = gaps(&before.parameters, &self.state.configuration).crossed;
            if pairs > 0 {
                return Err(ChangeError::AxesCross { pairs });
            }
        }
        let mut scaled_by = 1.0;
        if parameters.pi1 != before.parameters.pi1 {
            scaled_by = reshape::change_pi1(&mut self.state, parameters.pi1, settings.make_room)?;
        }
        self.state.parameters = parameters;
        self.publish_every = settings.publish_every.unwrap_or(before.publish_every);
        if let Some(measures) = &settings.measures {
            self.measures.clone_from(measures);
        }
        self.max_idle_secs = settings.max_idle_secs.unwrap_or(before.max_idle_secs);
        Ok(ChangeOutcome::Set {
            before,
            now: self.setting_values(),
            scaled_by,
        })
    }

    fn inform(
        &mut self,
        selection: &Selection,
        direction: f64,
        weight: Option<f64>,
        for_time: Option<f64>,
    ) -> Result<ChangeOutcome, ChangeError> {
        let (weight, direction) = self.preference(direction, weight)?;
        let lapses_at =
            for_time.map(|time| self.state.step.saturating_add(lapse_steps(time, self.dt())));
        let chosen = self.choose(Candidates::All, selection)?;
        for &individual in &chosen {
            let configuration = &mut self.state.configuration;
            configuration.inform(individual, weight, direction, lapses_at);
        }
        Ok(self.changed(&chosen))
    }

    fn inject(
        &mut self,
        place: &Placement,
        informed: Option<(f64, Option<f64>)>,
    ) -> Result<ChangeOutcome, ChangeError> {
        let (weight, direction) = match informed {
            Some((direction, weight)) => self.preference(direction, weight)?,
            None => (0.0, 0.0),
        };
        let count = match place {
            Placement::At(poses) => poses.len(),
            Placement::Border(count) | Placement::Within(count, _) => *count,
        };
        let before = self.n();
        (self.reserve)(Reservation::Grow(before.saturating_add(count)))?;
        let draw = injection::Draw {
            seed: self.state.seed,
            seq: self.seq,
        };
        let (parameters, configuration) = (&self.state.parameters, &mut self.state.configuration);
        let placed = match place {
            Placement::At(poses) => {
                injection::at(parameters, configuration, poses, weight, direction, None)
            }
            Placement::Border(count) => {
                injection::at_border(parameters, configuration, *count, weight, direction, draw)
            }
            Placement::Within(count, region) => injection::within(
                parameters,
                configuration,
                *count,
                *region,
                weight,
                direction,
                draw,
            ),
        };
        let ids = match placed {
            Ok(ids) => ids,
            Err(error) => {
                // Return the memory that was reserved for them.
                (self.reserve)(Reservation::Return(before))?;
                return Err(error.into());
            }
        };
        Ok(ChangeOutcome::Ids { ids, n: self.n() })
    }

    fn remove(&mut self, selection: &Selection) -> Result<ChangeOutcome, ChangeError> {
        let chosen = self.choose(Candidates::All, selection)?;
        if chosen.len() == self.n() {
            return Err(ChangeError::NoneLeft(chosen.len()));
        }
        (self.reserve)(Reservation::Return(self.n() - chosen.len()))?;
        let ids = self.ids(&chosen);
        self.state.configuration.remove(&chosen);
        Ok(ChangeOutcome::Ids { ids, n: self.n() })
    }

    fn choose(
        &self,
        candidates: Candidates,
        selection: &Selection,
    ) -> Result<Vec<usize>, ChangeError> {
        Ok(select(
            &self.state.configuration,
            candidates,
            selection,
            self.state.seed,
            self.seq,
        )?)
    }

    /// Returns the weight and direction of an individual to be informed, checked.
    fn preference(&self, direction: f64, weight: Option<f64>) -> Result<(f64, f64), ChangeError> {
        let parameters = &self.state.parameters;
        let weight = weight.unwrap_or(parameters.pi2);
        check_coordinate("direction", direction)?;
        check_preference(weight)?;
        let largest = self.state.configuration.largest_weight().max(weight);
        parameters.check(largest)?;
        Ok((weight, direction))
    }

    fn ids(&self, chosen: &[usize]) -> Vec<u32> {
        let configuration = &self.state.configuration;
        chosen.iter().map(|&i| configuration.id[i]).collect()
    }

    fn changed(&self, chosen: &[usize]) -> ChangeOutcome {
        ChangeOutcome::Ids {
            ids: self.ids(chosen),
            n: self.n(),
        }
    }

    fn n(&self) -> usize {
        self.state.configuration.n()
    }

    fn dt(&self) -> f64 {
        self.state.parameters.dt
    }
}

/// Builds the first state of a spec.
///
/// # Errors
///
/// [`ChangeError::Parameters`] and [`ChangeError::Start`].
pub fn begin(spec: &Spec) -> Result<State, ChangeError> {
    spec.parameters.check(0.0)?;
    let configuration: Configuration = match &spec.start {
        Start::Disc(radius) => start::disc(&spec.parameters, spec.n, *radius, spec.seed)?,
        Start::Given { x, y, alpha } => start::given(&spec.parameters, x, y, alpha)?,
    };
    Ok(State {
        parameters: spec.parameters,
        seed: spec.seed,
        configuration,
        ..State::default()
    })
}

/// More steps than a simulation takes. Doubles represent every whole number up to this one.
const MAX_STEPS: u64 = 1 << 53;

/// Up to so many steps [`steps_in`] takes a time that is this much longer for a whole number of steps.
/// Times are sums and products of decimal fractions.
const ROUNDING: f64 = 1e-9;
const ROUNDED_STEPS: f64 = 1.0 / ROUNDING;

/// Returns the least whole number of steps that last at least `time`, at most 2^53.
///
/// A quotient that is whole except for rounding counts as whole: 0.06 in steps of 0.02 is 3 steps.
pub fn steps_in(time: f64, dt: f64) -> u64 {
    let quotient = time / dt;
    if quotient < ROUNDED_STEPS {
        return lapse_steps(time, dt);
    }
    // The rounding of both numbers and of their quotient: 1e-9 of them would be whole steps.
    let rounding = (2.0 * f64::EPSILON * quotient).min(0.5);
    whole_steps(quotient - rounding)
}

/// As [`steps_in`] with the rounding of 1e-9 for all times: after 1e9 steps, individuals that are informed
/// for a time are uninformed so much earlier. Journals have the hashes of such states.
fn lapse_steps(time: f64, dt: f64) -> u64 {
    whole_steps((time / dt) * (1.0 - ROUNDING))
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a float becomes the nearest integer that fits"
)]
fn whole_steps(steps: f64) -> u64 {
    (steps.ceil() as u64).min(MAX_STEPS)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
