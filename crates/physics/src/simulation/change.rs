//! The spec of a simulation, the changes that can be applied to it between two steps, and their
//! outcomes.

use crate::model::Drive;
use crate::model::injection::{self, Pose, Region};
use crate::model::parameters::{Attraction, ContactRule, Parameters, Stepping};
use crate::model::selection::Selection;
use crate::simulation::error::{ChangeError, ReserveError};

/// Time units per second of wall clock; `None` is the highest possible rate.
pub type Rate = Option<f64>;

/// The start of a simulation. [`Simulation::new`](super::Simulation::new) checks it.
#[derive(Clone, Debug, PartialEq)]
pub struct Spec {
    /// The number of individuals at the start.
    pub n: usize,
    /// The parameters at the start.
    pub parameters: Parameters,
    /// The seed of every draw.
    pub seed: u64,
    /// Positions and headings at the start.
    pub start: Start,
    /// Steps between two published states. Only callers use it: it changes no step.
    pub publish_every: u64,
    /// Names of the measures that are published. Only callers use them: they change no step.
    pub measures: Vec<String>,
    /// Rate at which the caller steps.
    pub rate: Rate,
}

impl Spec {
    /// Creates the spec of `n` individuals with the default parameters, drawn in a disc of the
    /// default radius.
    pub fn new(n: usize, seed: u64) -> Self {
        Spec {
            n,
            parameters: Parameters::default(),
            seed,
            start: Start::Disc(None),
            publish_every: 1,
            measures: Vec::new(),
            rate: None,
        }
    }
}

/// Positions and headings at the start.
#[derive(Clone, Debug, PartialEq)]
pub enum Start {
    /// Drawn at random in a disc of this radius, or of the default one.
    Disc(Option<f64>),
    /// Given as three columns of n numbers.
    Given {
        /// Absolute positions, in body sizes.
        x: Vec<f64>,
        /// Absolute positions, in body sizes.
        y: Vec<f64>,
        /// Headings, in radians.
        alpha: Vec<f64>,
    },
}

/// A change of parameters or of the group. It is applied as a whole or rejected.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// Sets parameters to new values.
    Set(Settings),
    /// Gives individuals a direction of their own.
    Inform {
        /// The individuals.
        selection: Selection,
        /// Preferred direction, in radians.
        direction: f64,
        /// Weight of the direction; `None` is `pi2`.
        weight: Option<f64>,
        /// Time units after which the individuals become uninformed again; `None` is never.
        for_time: Option<f64>,
    },
    /// Makes individuals uninformed.
    Uninform(Selection),
    /// Adds individuals.
    Inject {
        /// Where they are placed.
        place: Placement,
        /// Direction in radians and weight of informed individuals. A weight of `None` is `pi2`.
        /// Without this pair the individuals are uninformed.
        informed: Option<(f64, Option<f64>)>,
    },
    /// Removes individuals.
    Remove(Selection),
}

impl Change {
    /// Creates the change that informs individuals of a direction in radians, with the weight `pi2`
    /// and without an end.
    pub fn inform(selection: Selection, direction: f64) -> Self {
        Change::Inform {
            selection,
            direction,
            weight: None,
            for_time: None,
        }
    }

    /// Checks the numbers of its selection and its poses that no swarm accepts, whatever its
    /// individuals and its parameters are.
    ///
    /// # Errors
    ///
    /// [`ChangeError::Selection`] and [`ChangeError::Injection`].
    pub fn check(&self) -> Result<(), ChangeError> {
        match self {
            Change::Inform { selection, .. }
            | Change::Uninform(selection)
            | Change::Remove(selection) => selection.check()?,
            Change::Inject { place, .. } => match place {
                Placement::At(poses) => injection::check_poses(poses)?,
                Placement::Within(_, region) => injection::check_region(*region)?,
                Placement::Border(_) => {}
            },
            Change::Set(_) => {}
        }
        Ok(())
    }

    /// Returns the kind of this change.
    pub fn kind(&self) -> ChangeKind {
        match self {
            Change::Set(_) => ChangeKind::Set,
            Change::Inform { .. } => ChangeKind::Inform,
            Change::Uninform(_) => ChangeKind::Uninform,
            Change::Inject { .. } => ChangeKind::Inject,
            Change::Remove(_) => ChangeKind::Remove,
        }
    }
}

/// Checks that changes that inform individuals, applied in turn, give them a weight above 0. `pi2` is
/// that of the swarm before them. [`Simulation::apply`](super::Simulation::apply) does not check it:
/// earlier versions applied such changes, and a replay applies them again.
///
/// # Errors
///
/// The index of the first change that informs with a weight of 0, and [`ChangeError::Weightless`].
pub fn check_weights(changes: &[Change], mut pi2: f64) -> Result<(), (usize, ChangeError)> {
    for (index, change) in changes.iter().enumerate() {
        let weight = match change {
            Change::Inform { weight, .. } => *weight,
            Change::Inject {
                informed: Some((_, weight)),
                ..
            } => *weight,
            Change::Set(settings) => {
                pi2 = settings.pi2.unwrap_or(pi2);
                continue;
            }
            Change::Inject { informed: None, .. } | Change::Uninform(_) | Change::Remove(_) => {
                continue;
            }
        };
        if weight.unwrap_or(pi2) == 0.0 {
            return Err((index, ChangeError::Weightless));
        }
    }
    Ok(())
}

/// The kinds of changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChangeKind {
    /// Parameters were set.
    Set,
    /// Individuals were informed.
    Inform,
    /// Individuals were uninformed.
    Uninform,
    /// Individuals were added.
    Inject,
    /// Individuals were removed.
    Remove,
}

/// The result of a change.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is one for each command, which is not kept"
)]
pub enum ChangeOutcome {
    /// Parameters were set.
    Set {
        /// The values before.
        before: SettingValues,
        /// The values now.
        now: SettingValues,
        /// The factor by which positions were scaled; 1 if they were not.
        scaled_by: f64,
    },
    /// Individuals were changed.
    Ids {
        /// Their ids, ascending.
        ids: Vec<u32>,
        /// The size of the group now.
        n: usize,
    },
}

/// The values of all settings.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingValues {
    /// The parameters.
    pub parameters: Parameters,
    /// Steps between two published states.
    pub publish_every: u64,
    /// Names of the measures that are published.
    pub measures: Vec<String>,
    /// The longest time in seconds for which the caller waits for a controller that sends nothing.
    pub max_idle_secs: Option<f64>,
}

/// New values of parameters. Parameters that are `None` keep their values.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// Length over width of a body.
    pub pi1: Option<f64>,
    /// Default weight of informed individuals.
    pub pi2: Option<f64>,
    /// Body size over turning radius.
    pub pi3: Option<f64>,
    /// Translational over rotational drag.
    pub pi4: Option<f64>,
    /// Which of a pair's contacts constrain a step.
    pub contacts: Option<ContactRule>,
    /// Whether a contact limits gaps or velocities.
    pub stepping: Option<Stepping>,
    /// Whether each step solves a second program, linearised about the result of the first.
    pub relinearise: Option<bool>,
    /// The law of attraction.
    pub attraction: Option<Attraction>,
    /// Intensity of noise.
    pub noise: Option<f64>,
    /// Steps between two published states.
    pub publish_every: Option<u64>,
    /// See [`SettingValues::max_idle_secs`]; `Some(None)` removes the limit.
    pub max_idle_secs: Option<Option<f64>>,
    /// Names of the measures that are published.
    pub measures: Option<Vec<String>>,
    /// Whether to scale positions if bodies of the new `pi1` would overlap.
    pub make_room: bool,
}

impl Settings {
    /// Returns the settings that set all of these parameters but `dt`, which no command changes.
    #[must_use]
    pub fn all(parameters: Parameters) -> Self {
        let Parameters {
            pi1,
            pi2,
            pi3,
            pi4,
            dt: _,
            contacts,
            stepping,
            relinearise,
            attraction,
            noise,
        } = parameters;
        Settings {
            pi1: Some(pi1),
            pi2: Some(pi2),
            pi3: Some(pi3),
            pi4: Some(pi4),
            contacts: Some(contacts),
            stepping: Some(stepping),
            relinearise: Some(relinearise),
            attraction: Some(attraction),
            noise: Some(noise),
            publish_every: None,
            max_idle_secs: None,
            measures: None,
            make_room: false,
        }
    }

    /// Returns `before` with these settings, unchecked.
    #[must_use]
    pub fn of(&self, before: Parameters) -> Parameters {
        Parameters {
            pi1: self.pi1.unwrap_or(before.pi1),
            pi2: self.pi2.unwrap_or(before.pi2),
            pi3: self.pi3.unwrap_or(before.pi3),
            pi4: self.pi4.unwrap_or(before.pi4),
            dt: before.dt,
            contacts: self.contacts.unwrap_or(before.contacts),
            stepping: self.stepping.unwrap_or(before.stepping),
            relinearise: self.relinearise.unwrap_or(before.relinearise),
            attraction: self.attraction.unwrap_or(before.attraction),
            noise: self.noise.unwrap_or(before.noise),
        }
    }
}

/// Where new individuals are placed.
#[derive(Clone, Debug, PartialEq)]
pub enum Placement {
    /// At these positions and headings.
    At(Vec<Pose>),
    /// This number of individuals around the group.
    Border(usize),
    /// This number of individuals in a region.
    Within(usize, Region),
}

/// Directions, weights and drives of individuals, in columns of one length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SetPoints {
    /// The individuals.
    pub ids: Vec<u32>,
    /// Their preferred directions, in radians.
    pub direction: Vec<f64>,
    /// Their weights, 0 for uninformed individuals; `None` is `pi2` for all.
    pub weight: Option<Vec<f64>>,
    /// Their drives; `None` leaves the drives unchanged.
    pub drives: Option<Vec<Drive>>,
}

impl SetPoints {
    /// Checks that directions without weights and drives inform individuals, where `pi2` is that of the
    /// swarm. [`Simulation::steer`](super::Simulation::steer) does not check it, as
    /// [`check_weights`] says.
    ///
    /// # Errors
    ///
    /// [`ChangeError::Weightless`] if `pi2` is 0.
    pub fn check_weights(&self, pi2: f64) -> Result<(), ChangeError> {
        let steers = self.weight.is_some() || self.drives.is_some() || self.ids.is_empty();
        match pi2 == 0.0 && !steers {
            true => Err(ChangeError::Weightless),
            false => Ok(()),
        }
    }
}

/// A callback that reserves memory for a group of another size, or rejects it.
pub type ReserveMemory = Box<dyn Fn(Reservation) -> Result<(), ReserveError> + Send>;

/// A request to reserve memory for a group of another size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reservation {
    /// Individuals are added: the limit of individuals applies.
    Grow(usize),
    /// Individuals are removed, a change is rolled back, or the swarm is reset to its spec. The
    /// limit of individuals may have been lowered since that size was admitted, so it does not
    /// apply.
    Return(usize),
}
