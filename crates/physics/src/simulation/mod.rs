//! One swarm's state and what commands make of it, without thread or clock.

use std::collections::BTreeSet;

use crate::model::body::gaps;
use crate::model::configuration::Configuration;
use crate::model::parameters::{
    ContactRule, Parameters, check_coordinate, check_share, check_weight,
};
use crate::model::selection::{Candidates, Selection, SelectionError, select};
use crate::model::{Drive, State};
use crate::model::{injection, resize, start};
use crate::observables::{self, Order, RunningMeans};
use crate::stepper::{StepError, StepReport, Stepper};
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::control::SetPoints;
use crate::swarm::frame::Exactness;
use crate::swarm::order::{Admit, Change, ChangeKind, Placement, Recipe, Resize, Settings, Start};
use crate::swarm::outcome::{OrderError, Outcome};

/// A swarm's state, its stepper and the means kept over its steps.
pub struct Simulation {
    /// What it was made from; `reset` goes back to this.
    pub recipe: Recipe,
    /// The state: all that its future depends on.
    pub state: State,
    /// Steps between two published states.
    pub publish_every: u64,
    /// Grows whenever `step` does not continue what was shown before.
    pub epoch: u64,
    /// Counts the applied commands; draws are keyed by it.
    pub seq: u64,
    /// Means since the start or reset.
    pub means: RunningMeans,
    /// How exact the last step was.
    pub exactness: Exactness,
    admit: Admit,
    stepper: Stepper,
}

/// All that changes change, to go back to.
pub struct Saved {
    state: State,
    publish_every: u64,
    seq: u64,
}

/// A start to go back to.
pub struct Fresh {
    recipe: Recipe,
    state: State,
}

impl Simulation {
    /// Builds the swarm that `recipe` describes; it grows as far as `admit` lets it.
    ///
    /// # Errors
    ///
    /// [`OrderError::Parameters`] and [`OrderError::Start`].
    pub fn new(recipe: Recipe, admit: Admit) -> Result<Self, OrderError> {
        let state = begin(&recipe)?;
        Ok(Simulation {
            publish_every: recipe.publish_every,
            recipe,
            state,
            epoch: 1,
            seq: 0,
            means: RunningMeans::default(),
            exactness: Exactness::default(),
            admit,
            stepper: Stepper::new(),
        })
    }

    /// The swarm as it was at a checkpoint; it grows as far as `admit` lets it.
    pub fn from_checkpoint(checkpoint: &Checkpoint, admit: Admit) -> Self {
        Simulation {
            recipe: checkpoint.recipe.clone(),
            state: checkpoint.state.clone(),
            publish_every: checkpoint.publish_every,
            epoch: checkpoint.epoch,
            seq: checkpoint.seq,
            means: checkpoint.means,
            exactness: checkpoint.exactness,
            admit,
            stepper: Stepper::new(),
        }
    }

    /// Grows from here on as far as this lets it.
    pub fn admit_by(&mut self, admit: Admit) {
        self.admit = admit;
    }

    /// Takes one step.
    ///
    /// # Errors
    ///
    /// [`StepError`]; the state is then the last good one.
    pub fn step(&mut self) -> Result<StepReport, StepError> {
        let order = observables::order(&self.state.configuration);
        let report = self.stepper.step(&mut self.state)?;
        self.means.add(&order);
        self.exactness = Exactness {
            residual: report.residual,
            degraded: self.exactness.degraded + u64::from(report.degraded),
            contacts: report.contacts,
            iterations: report.iterations,
        };
        Ok(report)
    }

    /// The start to go back to, with a new seed or the old one. Nothing has changed yet.
    ///
    /// # Errors
    ///
    /// [`OrderError::Start`] when no start can be drawn with the new seed,
    /// [`OrderError::NoMemory`] when the group has shrunk and others took its place.
    pub fn fresh(&self, seed: Option<u64>) -> Result<Fresh, OrderError> {
        let mut recipe = self.recipe.clone();
        recipe.seed = seed.unwrap_or(recipe.seed);
        (self.admit)(Resize::Return(recipe.n))?;
        match begin(&recipe) {
            Ok(state) => Ok(Fresh { recipe, state }),
            Err(error) => {
                (self.admit)(Resize::Return(self.n()))?;
                Err(error)
            }
        }
    }

    /// Goes back to the start in a new epoch.
    pub fn restart(&mut self, fresh: Fresh) {
        self.publish_every = fresh.recipe.publish_every;
        self.recipe = fresh.recipe;
        self.state = fresh.state;
        self.epoch += 1;
        self.means = RunningMeans::default();
        self.exactness = Exactness::default();
        self.stepper = Stepper::new();
    }

    /// What changes change, as it is now.
    pub fn save(&self) -> Saved {
        Saved {
            state: self.state.clone(),
            publish_every: self.publish_every,
            seq: self.seq,
        }
    }

    /// Undoes every change since it was saved.
    pub fn go_back(&mut self, saved: Saved) {
        self.state = saved.state;
        self.publish_every = saved.publish_every;
        self.seq = saved.seq;
        // Shrinking is always let, and what it had before it was let have.
        let _ = (self.admit)(Resize::Return(self.n()));
    }

    /// Makes every change in turn, each under a number of its own: the first under the present
    /// one. Tells which change was not possible; those before it have been made then.
    ///
    /// # Errors
    ///
    /// [`OrderError`] and the index of the change.
    pub fn apply_all(
        &mut self,
        changes: &[Change],
    ) -> Result<Vec<(ChangeKind, Outcome)>, (usize, OrderError)> {
        let mut outcomes = Vec::with_capacity(changes.len());
        for (index, change) in changes.iter().enumerate() {
            self.seq += u64::from(index > 0);
            let outcome = self.apply(change).map_err(|error| (index, error))?;
            outcomes.push((change.kind(), outcome));
        }
        Ok(outcomes)
    }

    /// Refuses a change that could not be made as things are because of a number in it.
    ///
    /// # Errors
    ///
    /// [`OrderError::Parameters`].
    pub fn check(&self, change: &Change) -> Result<(), OrderError> {
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

    /// Changes parameters or the group.
    fn apply(&mut self, change: &Change) -> Result<Outcome, OrderError> {
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
                Ok(self.ids(&chosen))
            }
            Change::Inject { place, informed } => self.inject(place, *informed),
            Change::Remove(selection) => self.remove(selection),
        }
    }

    /// Order and drift now.
    pub fn order(&self) -> Order {
        observables::order(&self.state.configuration)
    }

    /// The parameters with these settings, checked.
    fn with(&self, settings: &Settings) -> Result<Parameters, OrderError> {
        let parameters = settings.of(self.state.parameters);
        parameters.check(self.state.configuration.largest_weight())?;
        Ok(parameters)
    }

    fn set(&mut self, settings: &Settings) -> Result<Outcome, OrderError> {
        let before = (self.state.parameters, self.publish_every);
        let parameters = self.with(settings)?;
        let may_cross = |parameters: &Parameters| parameters.contacts == ContactRule::Closest;
        if may_cross(&before.0) && !may_cross(&parameters) {
            let pairs = gaps(&before.0, &self.state.configuration).crossed;
            if pairs > 0 {
                return Err(OrderError::StillCrossed { pairs });
            }
        }
        let mut scaled_by = 1.0;
        if parameters.pi1 != before.0.pi1 {
            scaled_by = resize::change_pi1(&mut self.state, parameters.pi1, settings.make_room)?;
        }
        self.state.parameters = parameters;
        self.publish_every = settings.publish_every.unwrap_or(before.1);
        Ok(Outcome::Set {
            before,
            now: (parameters, self.publish_every),
            scaled_by,
        })
    }

    fn inform(
        &mut self,
        selection: &Selection,
        direction: f64,
        weight: Option<f64>,
        for_time: Option<f64>,
    ) -> Result<Outcome, OrderError> {
        let (weight, direction) = self.preference(direction, weight)?;
        let lapses_at =
            for_time.map(|time| self.state.step.saturating_add(steps_in(time, self.dt())));
        let chosen = self.choose(Candidates::All, selection)?;
        for &individual in &chosen {
            let configuration = &mut self.state.configuration;
            configuration.inform(individual, weight, direction, lapses_at);
        }
        Ok(self.ids(&chosen))
    }

    /// Gives individuals the directions and weights that a controller wants: all of them or none.
    ///
    /// # Errors
    ///
    /// [`OrderError::Selection`] for one that is not there, [`OrderError::Parameters`].
    pub fn steer(&mut self, set: &SetPoints) -> Result<(), OrderError> {
        let SetPoints {
            ids,
            direction,
            weight,
            drives,
        } = set;
        let usual = self.state.parameters.pi2;
        let weight_of = |k: usize| weight.as_ref().map_or(usual, |weight| weight[k]);
        let configuration = &self.state.configuration;
        let mut individuals = Vec::with_capacity(ids.len());
        let mut largest = configuration.largest_weight();
        for (k, id) in ids.iter().enumerate() {
            check_coordinate("set.direction", direction[k])?;
            check_weight("set.weight", weight_of(k))?;
            largest = largest.max(weight_of(k));
            if let Some(Drive { turn, speed }) = drives.as_ref().map(|drives| drives[k]) {
                turn.map_or(Ok(()), |turn| check_coordinate("set.turn", turn))?;
                speed.map_or(Ok(()), |speed| check_share("set.speed", speed))?;
            }
            let index = configuration.id.binary_search(id);
            let candidates = configuration.n();
            individuals.push(index.map_err(|_| SelectionError::UnknownId {
                id: *id,
                candidates,
                among: Candidates::All,
            })?);
        }
        self.state.parameters.check(largest)?;
        for (k, &individual) in individuals.iter().enumerate() {
            let configuration = &mut self.state.configuration;
            configuration.inform(individual, weight_of(k), direction[k], None);
            if let Some(drives) = drives {
                match drives[k] {
                    Drive {
                        turn: None,
                        speed: None,
                    } => drop(configuration.drives.remove(&ids[k])),
                    drive => drop(configuration.drives.insert(ids[k], drive)),
                }
            }
        }
        Ok(())
    }

    /// Uninforms those of these that are there, and drives them no more.
    pub fn release(&mut self, ids: &BTreeSet<u32>) {
        let configuration = &mut self.state.configuration;
        for id in ids {
            if let Ok(individual) = configuration.id.binary_search(id) {
                configuration.uninform(individual);
                configuration.drives.remove(id);
            }
        }
    }

    fn inject(
        &mut self,
        place: &Placement,
        informed: Option<(f64, Option<f64>)>,
    ) -> Result<Outcome, OrderError> {
        let (weight, direction) = match informed {
            Some((direction, weight)) => self.preference(direction, weight)?,
            None => (0.0, 0.0),
        };
        let count = match place {
            Placement::At(poses) => poses.len(),
            Placement::Border(count) | Placement::Within(count, _) => *count,
        };
        let before = self.n();
        (self.admit)(Resize::Grow(before.saturating_add(count)))?;
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
                // What was set aside for them is not needed.
                (self.admit)(Resize::Return(before))?;
                return Err(error.into());
            }
        };
        Ok(Outcome::Ids(ids, self.n()))
    }

    fn remove(&mut self, selection: &Selection) -> Result<Outcome, OrderError> {
        let chosen = self.choose(Candidates::All, selection)?;
        if chosen.len() == self.n() {
            return Err(OrderError::NobodyLeft(chosen.len()));
        }
        let Outcome::Ids(ids, _) = self.ids(&chosen) else {
            unreachable!("ids are ids");
        };
        self.state.configuration.remove(&chosen);
        (self.admit)(Resize::Return(self.n()))?;
        Ok(Outcome::Ids(ids, self.n()))
    }

    fn choose(
        &self,
        candidates: Candidates,
        selection: &Selection,
    ) -> Result<Vec<usize>, OrderError> {
        Ok(select(
            &self.state.configuration,
            candidates,
            selection,
            self.state.seed,
            self.seq,
        )?)
    }

    /// The weight and direction an individual is to be informed with.
    fn preference(&self, direction: f64, weight: Option<f64>) -> Result<(f64, f64), OrderError> {
        let parameters = &self.state.parameters;
        let weight = weight.unwrap_or(parameters.pi2);
        check_coordinate("direction", direction)?;
        check_weight("weight", weight)?;
        let largest = self.state.configuration.largest_weight().max(weight);
        parameters.check(largest)?;
        Ok((weight, direction))
    }

    fn ids(&self, chosen: &[usize]) -> Outcome {
        let configuration = &self.state.configuration;
        let ids = chosen.iter().map(|&i| configuration.id[i]).collect();
        Outcome::Ids(ids, configuration.n())
    }

    fn n(&self) -> usize {
        self.state.configuration.n()
    }

    fn dt(&self) -> f64 {
        self.state.parameters.dt
    }
}

/// The first state of a recipe.
///
/// # Errors
///
/// [`OrderError::Parameters`] and [`OrderError::Start`].
pub fn begin(recipe: &Recipe) -> Result<State, OrderError> {
    recipe.parameters.check(0.0)?;
    let configuration: Configuration = match &recipe.start {
        Start::Disc(radius) => start::disc(&recipe.parameters, recipe.n, *radius, recipe.seed)?,
        Start::Given { x, y, alpha } => start::given(&recipe.parameters, x, y, alpha)?,
    };
    Ok(State {
        parameters: recipe.parameters,
        seed: recipe.seed,
        configuration,
        ..State::default()
    })
}

/// More steps than any swarm takes, and every whole number up to it is a double.
const MOST_STEPS: u64 = 1 << 53;

/// The first whole number of steps that lasts at least `time`, at most 2^53.
///
/// A quotient that is whole but for rounding is taken as whole: 0.06 in steps of 0.02 is 3.
pub fn steps_in(time: f64, dt: f64) -> u64 {
    const ROUNDING: f64 = 1e-9;
    let steps = (time / dt) * (1.0 - ROUNDING);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a float becomes the nearest integer that fits"
    )]
    let steps = steps.ceil() as u64;
    steps.min(MOST_STEPS)
}
