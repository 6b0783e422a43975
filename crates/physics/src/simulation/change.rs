//! What a simulation starts from, and the changes that can be applied to it between two steps.

use crate::model::Drive;
use crate::model::injection::{Pose, Region};
use crate::model::parameters::{Attraction, ContactRule, Parameters, Stepping};
use crate::model::selection::Selection;
use crate::simulation::error::ReserveError;

/// Time units per second of wall clock; `None` is as fast as possible.
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
    /// Steps between two published states. For the caller: it changes no step.
    pub publish_every: u64,
    /// How fast the caller is to step.
    pub rate: Rate,
}

impl Spec {
    /// A group of `n` individuals with the default parameters, drawn in a disc of the default radius.
    pub fn new(n: usize, seed: u64) -> Self {
        Spec {
            n,
            parameters: Parameters::default(),
            seed,
            start: Start::Disc(None),
            publish_every: 1,
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
    /// New values of the parameters named.
    Set(Settings),
    /// Gives individuals a direction of their own.
    Inform {
        /// The individuals.
        selection: Selection,
        /// Radians.
        direction: f64,
        /// `pi2` if left out.
        weight: Option<f64>,
        /// Time units after which they become uninformed again; never if left out.
        for_time: Option<f64>,
    },
    /// Makes individuals uninformed.
    Uninform(Selection),
    /// Adds individuals.
    Inject {
        /// Where they are placed.
        place: Placement,
        /// Makes them informed: direction in radians, and weight, `pi2` if left out.
        informed: Option<(f64, Option<f64>)>,
    },
    /// Removes individuals.
    Remove(Selection),
}

impl Change {
    /// Informs individuals of a direction in radians, with the weight `pi2` and for good.
    pub fn inform(selection: Selection, direction: f64) -> Self {
        Change::Inform {
            selection,
            direction,
            weight: None,
            for_time: None,
        }
    }

    /// The kind of this change.
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

/// New values of parameters; those left out keep theirs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Settings {
    /// Length over width of a body.
    pub pi1: Option<f64>,
    /// Weight of individuals informed without one.
    pub pi2: Option<f64>,
    /// Body size over turning radius.
    pub pi3: Option<f64>,
    /// Translational over rotational drag.
    pub pi4: Option<f64>,
    /// Which of a pair's contacts constrain a step.
    pub contacts: Option<ContactRule>,
    /// What a contact limits.
    pub stepping: Option<Stepping>,
    /// Whether a second program is solved.
    pub relinearise: Option<bool>,
    /// The law of attraction.
    pub attraction: Option<Attraction>,
    /// Intensity of noise.
    pub noise: Option<f64>,
    /// Steps between two published states.
    pub publish_every: Option<u64>,
    /// Whether to scale positions if bodies of the new `pi1` would overlap.
    pub make_room: bool,
}

impl Settings {
    /// The parameters with these settings, unchecked.
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
    /// So many around the group.
    Border(usize),
    /// So many in a disc.
    Within(usize, Region),
}

/// Directions, weights and drives of individuals, in columns of one length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SetPoints {
    /// The individuals.
    pub ids: Vec<u32>,
    /// Their preferred directions, in radians.
    pub direction: Vec<f64>,
    /// Their weights, 0 for uninformed; `pi2` if left out.
    pub weight: Option<Vec<f64>>,
    /// How each is driven directly; not at all if left out.
    pub drives: Option<Vec<Drive>>,
}

/// A callback that reserves memory for a group of another size, or rejects it.
pub type ReserveMemory = Box<dyn Fn(Resize) -> Result<(), ReserveError> + Send>;

/// A new size of the group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resize {
    /// Individuals are added: the limit of individuals applies.
    Grow(usize),
    /// Individuals are removed, a change is rolled back, or the swarm is reset to its spec. The limit
    /// of individuals may have been lowered since that size was admitted, so it does not apply.
    Return(usize),
}
