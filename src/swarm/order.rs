//! What a swarm can be told.

use crate::model::injection::{Pose, Region};
use crate::model::parameters::{Attraction, ContactRule, Parameters, Stepping};
use crate::model::selection::Selection;
use crate::swarm::control::{SetPoints, Terms};
use crate::swarm::outcome::OrderError;

/// Time units per second of wall clock; `None` is as fast as possible.
pub type Rate = Option<f64>;

/// What a swarm is made from: checked field by field, not yet built.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    /// The number of individuals at the start.
    pub n: usize,
    /// The parameters at the start.
    pub parameters: Parameters,
    /// The seed of every draw.
    pub seed: u64,
    /// Where the individuals begin.
    pub start: Start,
    /// Steps between two published states.
    pub publish_every: u64,
    /// How fast it runs.
    pub rate: Rate,
}

/// Where the individuals begin.
#[derive(Clone, Debug, PartialEq)]
pub enum Start {
    /// Drawn in a disc of this radius, or of the default one.
    Disc(Option<f64>),
    /// Exactly there: three columns of n numbers.
    Given {
        /// Absolute positions.
        x: Vec<f64>,
        /// Absolute positions.
        y: Vec<f64>,
        /// Headings.
        alpha: Vec<f64>,
    },
}

/// What a swarm is told to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Order {
    /// Run, to an end or for good; `rate` only if it is to change.
    Run {
        /// Where to pause.
        until: Option<Until>,
        /// How fast, if it is to change.
        rate: Option<Rate>,
    },
    /// Stand still.
    Pause,
    /// Take this many steps as fast as possible, and answer when they are taken.
    Step(u64),
    /// Go back to the start, with a new seed or the old one.
    Reset(Option<u64>),
    /// Change parameters or the group.
    Change(Change),
    /// Several changes at one step, or none of them.
    Batch(Vec<Change>),
    /// Take a controller in.
    Join(Terms),
    /// A controller has advanced by so many steps, with these set-points.
    Advance {
        /// Which.
        controller: String,
        /// How many.
        steps: u64,
        /// What it wants from now on; without them what it wanted before.
        set: Option<SetPoints>,
    },
    /// Let a controller go.
    Leave(String),
    /// The others have waited long enough for this controller.
    Deadline(String),
    /// This controller's token is gone.
    Lost(String),
    /// Set-points that a controller put.
    Control {
        /// Which.
        controller: String,
        /// Counts its puts.
        sequence: u64,
        /// What it wants.
        set: SetPoints,
    },
    /// End.
    Delete,
}

impl Order {
    /// The controller that it is from.
    pub fn controller(&self) -> Option<&str> {
        match self {
            Order::Join(Terms { controller, .. })
            | Order::Advance { controller, .. }
            | Order::Leave(controller) => Some(controller),
            _ => None,
        }
    }

    /// Whether it is written down and safe before it is carried out. Steps are carried out first,
    /// and an end is written when it comes.
    pub fn is_written_first(&self) -> bool {
        !self.is_carried_out_first() && !matches!(self, Order::Delete)
    }

    /// Whether it is carried out before it is safe: what is exchanged thousands of times a second.
    pub fn is_carried_out_first(&self) -> bool {
        matches!(
            self,
            Order::Step(_)
                | Order::Advance { .. }
                | Order::Deadline(_)
                | Order::Lost(_)
                | Order::Control { .. }
        )
    }
}

/// An end of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// This step.
    Step(u64),
    /// The first step at or after this time.
    Time(f64),
}

/// Where a recording is to go: to the last frame that is not later.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Seek {
    /// This step of its present run.
    Step(u64),
    /// This time of its present run.
    Time(f64),
    /// This share of all of it, from 0 to 1.
    Fraction(f64),
}

/// A change of parameters or of the group: all of it or nothing.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// New values of the parameters named.
    Set(Settings),
    /// Gives individuals a direction of their own.
    Inform {
        /// Whom.
        selection: Selection,
        /// Radians.
        direction: f64,
        /// `pi2` if left out.
        weight: Option<f64>,
        /// Time units after which they are uninformed again.
        for_time: Option<f64>,
    },
    /// Takes individuals' direction away.
    Uninform(Selection),
    /// Adds individuals.
    Inject {
        /// Where.
        place: Placement,
        /// Informs them: direction in radians, and weight, `pi2` if left out.
        informed: Option<(f64, Option<f64>)>,
    },
    /// Takes individuals out of the group.
    Remove(Selection),
}

impl Change {
    /// Which change it is.
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

/// Which change something was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChangeKind {
    /// Of parameters.
    Set,
    /// Individuals were informed.
    Inform,
    /// Individuals were uninformed.
    Uninform,
    /// Individuals joined.
    Inject,
    /// Individuals left.
    Remove,
}

/// New values; what is left out stays.
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
    /// Whom an individual is attracted to.
    pub attraction: Option<Attraction>,
    /// Intensity of noise.
    pub noise: Option<f64>,
    /// Steps between two published states.
    pub publish_every: Option<u64>,
    /// Whether to scale positions so that a new `pi1` fits.
    pub make_room: bool,
}

impl Settings {
    /// What they make of parameters; unchecked.
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

/// Where new individuals go.
#[derive(Clone, Debug, PartialEq)]
pub enum Placement {
    /// Exactly there.
    At(Vec<Pose>),
    /// This many around the group.
    Border(usize),
    /// This many in a disc.
    Within(usize, Region),
}

/// Who sent a command and how, for the event that tells of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sender {
    /// The verb's name.
    pub verb: &'static str,
    /// The arguments as they came, JSON.
    pub args: String,
    /// Who says to have sent it.
    pub client: Option<String>,
    /// What the sender called it.
    pub request_id: Option<String>,
    /// What tells it from any other request of that name.
    pub digest: Option<[u8; 32]>,
}

/// When an order is to be carried out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct When {
    /// At this step; at once without one.
    pub at_step: Option<u64>,
    /// Only if the swarm is in this epoch when it comes.
    pub expect_epoch: Option<u64>,
    /// Only if the swarm is at this step when it comes.
    pub expect_step: Option<u64>,
}

/// When a waiting `get` is answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Awaited {
    /// When this step is reached, or the swarm stands still.
    Step(u64),
    /// When this step is reached, however often the swarm stands still before.
    Reached(u64),
    /// When it is paused.
    Paused,
    /// When it moves.
    Running,
    /// When it has faulted.
    Faulted,
}

/// Reserves memory for a group of another size, or says why not.
pub type Admit = Box<dyn Fn(Resize) -> Result<(), OrderError> + Send>;

/// The size that a group is to have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resize {
    /// Individuals are added: the limit of individuals applies.
    Grow(usize),
    /// Individuals are removed, a change is rolled back, or the swarm is reset to its spec. The limit
    /// of individuals may have been lowered since that size was admitted, so it does not apply.
    Return(usize),
}
