//! What a swarm can be told.

use jostle_physics::simulation::{Change, Rate, SetPoints};

use crate::swarm::membership::JoinOptions;

/// What a swarm is told to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
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
    Join(JoinOptions),
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

impl Command {
    /// The controller that it is from.
    pub fn controller(&self) -> Option<&str> {
        match self {
            Command::Join(JoinOptions { controller, .. })
            | Command::Advance { controller, .. }
            | Command::Leave(controller) => Some(controller),
            _ => None,
        }
    }

    /// Whether it is written down and safe before it is carried out. Steps are carried out first,
    /// and an end is written when it comes.
    pub fn is_write_ahead(&self) -> bool {
        !self.is_group_committed() && !matches!(self, Command::Delete)
    }

    /// Whether it is carried out before it is safe: what is exchanged thousands of times a second.
    pub fn is_group_committed(&self) -> bool {
        matches!(
            self,
            Command::Step(_)
                | Command::Advance { .. }
                | Command::Deadline(_)
                | Command::Lost(_)
                | Command::Control { .. }
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
