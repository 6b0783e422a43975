//! Commands of a swarm.

use std::sync::Arc;

use jostle_physics::simulation::{Change, Rate, SetPoints};

use crate::swarm::error::SwarmError;
use crate::swarm::membership::JoinOptions;
use crate::swarm::watch::{Action, Draws, Watch};

/// A command.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Run.
    Run {
        /// Where to pause; without it the swarm runs until another command.
        until: Option<Until>,
        /// The new rate; without it the rate does not change.
        rate: Option<Rate>,
    },
    /// Pause.
    Pause,
    /// Take this many steps as fast as possible, and reply after them.
    Step(u64),
    /// Return to the start, with a new seed or the old one.
    Reset(Option<u64>),
    /// Change parameters or the group.
    Change(Change),
    /// Apply all these changes at one step, or none.
    Batch {
        /// The changes, in order.
        changes: Vec<Change>,
        /// The key of their random draws.
        draws: Draws,
    },
    /// Add a controller.
    Join(JoinOptions),
    /// Advance a controller in lockstep.
    Advance {
        /// Its name.
        controller: String,
        /// By how many steps.
        steps: u64,
        /// New set-points; without them the old ones stay.
        set: Option<SetPoints>,
    },
    /// Remove a controller at its request.
    Leave(String),
    /// The deadline of this controller has passed.
    Deadline(String),
    /// The liveliness token of this controller is lost.
    Lost(String),
    /// This controller held the swarm and sent nothing for too long.
    Idle(String),
    /// Apply set-points that a controller put.
    Control {
        /// Its name.
        controller: String,
        /// The number of the put.
        sequence: u64,
        /// The set-points.
        set: SetPoints,
    },
    /// Write a note into the journal and the events. Its text is in the arguments of its sender.
    Annotate,
    /// Reject `delete` and `reset` from now on, or accept them again.
    Protect(bool),
    /// Execute an action once a condition holds.
    Watch(Box<Watch>),
    /// Remove waiting conditions.
    Unwatch(Which),
    /// This condition holds: execute its action.
    Fired(Box<Watch>),
    /// Delete the swarm.
    Delete,
}

/// The verb of notes.
pub const ANNOTATE: &str = "annotate";

impl Command {
    /// The controller that sent it.
    pub fn controller(&self) -> Option<&str> {
        match self {
            Command::Join(JoinOptions { controller, .. })
            | Command::Advance { controller, .. }
            | Command::Leave(controller) => Some(controller),
            Command::Run { .. }
            | Command::Pause
            | Command::Step(_)
            | Command::Reset(_)
            | Command::Change(_)
            | Command::Batch { .. }
            | Command::Deadline(_)
            | Command::Lost(_)
            | Command::Idle(_)
            | Command::Control { .. }
            | Command::Annotate
            | Command::Protect(_)
            | Command::Watch(_)
            | Command::Unwatch(_)
            | Command::Fired(_)
            | Command::Delete => None,
        }
    }

    /// The changes that it applies, at once or when its condition holds.
    pub fn changes(&self) -> &[Change] {
        match self {
            Command::Change(change) => std::slice::from_ref(change),
            Command::Batch { changes, .. } => changes,
            Command::Watch(watch) | Command::Fired(watch) => watch.changes(),
            Command::Run { .. }
            | Command::Pause
            | Command::Step(_)
            | Command::Reset(_)
            | Command::Join(_)
            | Command::Advance { .. }
            | Command::Leave(_)
            | Command::Deadline(_)
            | Command::Lost(_)
            | Command::Idle(_)
            | Command::Control { .. }
            | Command::Annotate
            | Command::Protect(_)
            | Command::Unwatch(_)
            | Command::Delete => &[],
        }
    }

    /// Whether a faulted swarm executes it.
    pub fn is_allowed_when_faulted(&self) -> bool {
        match self {
            Command::Reset(_) | Command::Delete | Command::Annotate | Command::Protect(_) => true,
            Command::Run { .. }
            | Command::Pause
            | Command::Step(_)
            | Command::Change(_)
            | Command::Batch { .. }
            | Command::Join(_)
            | Command::Advance { .. }
            | Command::Leave(_)
            | Command::Deadline(_)
            | Command::Lost(_)
            | Command::Idle(_)
            | Command::Control { .. }
            | Command::Watch(_)
            | Command::Unwatch(_)
            | Command::Fired(_) => false,
        }
    }

    /// Whether it counts as an annotation: the number of the next command, which keys random draws, does
    /// not depend on it.
    pub fn is_annotation(&self) -> bool {
        match self {
            Command::Annotate | Command::Protect(_) | Command::Unwatch(Which::Event(_)) => true,
            Command::Watch(watch) | Command::Fired(watch) => {
                matches!(watch.action, Action::Event(_))
            }
            Command::Run { .. }
            | Command::Pause
            | Command::Step(_)
            | Command::Reset(_)
            | Command::Change(_)
            | Command::Batch { .. }
            | Command::Join(_)
            | Command::Advance { .. }
            | Command::Leave(_)
            | Command::Deadline(_)
            | Command::Lost(_)
            | Command::Idle(_)
            | Command::Control { .. }
            | Command::Unwatch(Which::All | Which::Id(_))
            | Command::Delete => false,
        }
    }

    /// Whether it is executed before it is durable (group commit), as frequent and internal commands are.
    pub fn is_group_committed(&self) -> bool {
        match self {
            Command::Step(_)
            | Command::Advance { .. }
            | Command::Deadline(_)
            | Command::Lost(_)
            | Command::Idle(_)
            | Command::Control { .. } => true,
            Command::Run { .. }
            | Command::Pause
            | Command::Reset(_)
            | Command::Change(_)
            | Command::Batch { .. }
            | Command::Join(_)
            | Command::Leave(_)
            | Command::Annotate
            | Command::Protect(_)
            | Command::Watch(_)
            | Command::Unwatch(_)
            | Command::Fired(_)
            | Command::Delete => false,
        }
    }
}

/// Which waiting conditions are removed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Which {
    /// All.
    All,
    /// The one with this event.
    Event(Arc<str>),
    /// The one of this id.
    Id(String),
}

/// Where a run ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// At this step.
    Step(u64),
    /// At the first step at or after this time.
    Time(f64),
}

/// A position in a recording: the last frame that is not later.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Seek {
    /// This step of the present run.
    Step(u64),
    /// This time of the present run.
    Time(f64),
    /// This fraction of the recording, from 0 to 1.
    Fraction(f64),
}

/// When a command is executed, and on which conditions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct When {
    /// At this step; without it at once.
    pub at_step: Option<u64>,
    /// Only if the swarm is in this epoch when the command is received.
    pub expect_epoch: Option<u64>,
    /// Only if the swarm is at this step when the command is received.
    pub expect_step: Option<u64>,
}

impl When {
    /// Checks the expected epoch and step.
    ///
    /// # Errors
    ///
    /// [`SwarmError::Conflict`].
    pub fn check(&self, epoch: u64, step: u64) -> Result<(), SwarmError> {
        let expected = [
            ("epoch", self.expect_epoch, epoch),
            ("step", self.expect_step, step),
        ];
        for (what, expected, actual) in expected {
            if let Some(expected) = expected.filter(|it| *it != actual) {
                return Err(SwarmError::Conflict {
                    what,
                    expected,
                    actual,
                });
            }
        }
        Ok(())
    }
}

/// The condition of `get/wait`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WaitCondition {
    /// At this step, or when the swarm does not move.
    Step(u64),
    /// At this step, whether or not the swarm pauses before.
    Reached(u64),
    /// When the swarm is paused.
    Paused,
    /// When the swarm moves.
    Running,
    /// When the swarm has faulted.
    Faulted,
    /// When the condition with this event has held, or when the swarm has faulted.
    Event(Arc<str>),
}
