//! Why a swarm rejects a command.

use jostle_physics::simulation::{ChangeError, ReserveError};
use thiserror::Error;

use crate::swarm::membership::{Departure, MAX_MISSES};
use crate::swarm::phase::PhaseError;

/// Why a command was rejected; nothing has changed.
#[derive(Clone, Debug, Error)]
pub enum SwarmError {
    /// The phase does not allow it.
    #[error(transparent)]
    Phase(#[from] PhaseError),
    /// The swarm is not at the expected step or epoch.
    #[error("the swarm is at {what} {actual}, not {expected}: look at its status and send again")]
    Conflict {
        /// `step` or `epoch`.
        what: &'static str,
        /// What the client expected.
        expected: u64,
        /// What it is.
        actual: u64,
    },
    /// `at_step` is in the past.
    #[error("at_step {at_step} is in the past, the swarm is at step {step}: name a later one")]
    Late {
        /// The requested step.
        at_step: u64,
        /// The present step.
        step: u64,
    },
    /// Too many commands are scheduled.
    #[error("{limit} commands are scheduled already: send this one later, or reset")]
    TooManyScheduled {
        /// The limit.
        limit: usize,
    },
    /// The swarm was reset before the step of a scheduled command.
    #[error(
        "the swarm was reset before step {at_step} came: send it again with another request_id"
    )]
    Overtaken {
        /// The step for which it was scheduled.
        at_step: u64,
    },
    /// One change of a batch was rejected, so none was applied.
    #[error("commands[{index}]: {error}; none was applied")]
    InBatch {
        /// Its index.
        index: usize,
        /// Why.
        error: Box<SwarmError>,
    },
    /// The command panicked.
    #[error("a defect of the daemon: nothing was changed; please report what you sent")]
    Panicked,
    /// The end of a run is in the past.
    #[error("until_step {until} is in the past, the swarm is at step {step}: name a later one")]
    Past {
        /// The requested end.
        until: u64,
        /// The present step.
        step: u64,
    },
    /// A start or a change was rejected.
    #[error(transparent)]
    Change(#[from] ChangeError),
    /// No controller of this name has joined.
    #[error("{}", not_joined(.controller, *.left))]
    NotJoined {
        /// The name.
        controller: String,
        /// Why and at which step it left, if it had joined.
        left: Option<(Departure, u64)>,
    },
    /// A controller of this name has joined.
    #[error(
        "a controller {0} has joined: take another name, or set `again` if it is the same one that \
         rejoins"
    )]
    HasJoined(String),
    /// No more controllers can join.
    #[error("{limit} controllers have joined already: remove one with `leave`")]
    TooManyControllers {
        /// The limit.
        limit: usize,
    },
    /// Another controller has claimed an individual.
    #[error(
        "individual {id} is steered by controller {controller}: choose others, or send `leave` for it"
    )]
    Claimed {
        /// The individual.
        id: u32,
        /// The controller that has claimed it.
        controller: String,
    },
    /// The controller has not claimed an individual that it steers.
    #[error("{}", not_claimed(*.id, .owner.as_deref()))]
    NotClaimed {
        /// The individual.
        id: u32,
        /// The controller that has claimed it.
        owner: Option<String>,
    },
    /// The controller did not join with `driving`.
    #[error("controller {0} did not join to drive individuals directly: join with `driving`")]
    NotDriving(String),
    /// The swarm moves when its controllers advance.
    #[error(
        "controllers have joined, and the swarm steps when all of them `advance`: remove them \
         first"
    )]
    Lockstep,
    /// A free-running controller cannot advance the swarm.
    #[error("controller {0} joined a swarm that runs freely: join in mode lockstep to advance it")]
    RunsFreely(String),
    /// The last advance of the controller is pending.
    #[error("controller {controller} is advancing to step {target} already: wait for that reply")]
    Advancing {
        /// The controller.
        controller: String,
        /// The step it advances to.
        target: u64,
    },
    /// A newer request of the same controller replaced this one.
    #[error("a later request of the same controller took the place of this one")]
    Superseded,
    /// The command was rejected before the daemon restarted; a replay does not execute it.
    #[error("it was rejected before the daemon restarted: send it again")]
    RejectedBefore,
    /// The command could not be made durable, so it was not executed.
    #[error("{0}: nothing was changed; make room on the disk of data_dir and send it again")]
    Unsafe(WriteFault),
    /// A playback does not accept this command.
    #[error(
        "this is a replay of a recording: it takes run, pause, step, seek, reset and delete; create \
         or restore a swarm to change what happens"
    )]
    Recorded,
    /// Only a playback can seek.
    #[error("this swarm is no replay: fork it at a step it has passed, or replay a recording")]
    NotRecorded,
    /// The recording has no frame there.
    #[error(
        "{field} = {value} is outside the run that was recorded: give a {field} from {first} to \
         {last}, or a fraction from 0 to 1"
    )]
    OutsideRecording {
        /// `step` or `time`.
        field: &'static str,
        /// The requested value.
        value: f64,
        /// The first in the run at which the playback is.
        first: f64,
        /// The last in that run.
        last: f64,
    },
    /// The recording cannot be read.
    #[error("cannot play the recording: {0}")]
    Playback(String),
    /// More than `limit` queries wait for the swarm, and this one has waited longest.
    #[error(
        "condition not met within {after_secs:.3} s, and more than {limit} queries wait for this \
         swarm, of which this one has waited longest: retry"
    )]
    Displaced {
        /// How long it has waited.
        after_secs: f64,
        /// The limit.
        limit: usize,
    },
    /// The queue of the swarm is full.
    #[error("the queue of this swarm is full: retry in a moment")]
    Busy,
    /// A step failed while the command was executed.
    #[error("the swarm faulted while this ran ({0}): reset or delete it")]
    Faulted(String),
    /// The swarm ended before it received the command.
    #[error("the swarm was deleted")]
    Gone,
}

/// Why a write to the journal failed; nothing was written.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum WriteFault {
    /// The disk is full.
    #[error("no space is left for the journal")]
    Full,
    /// Another failure, or the daemon is stopping.
    #[error("the journal cannot be written ({0})")]
    Failed(String),
}

impl SwarmError {
    /// Whether the same command may succeed later in the same state.
    pub fn may_succeed_later(&self) -> bool {
        match self {
            SwarmError::Change(ChangeError::Reserve(_))
            | SwarmError::Panicked
            | SwarmError::Unsafe(_) => true,
            SwarmError::InBatch { error, .. } => error.may_succeed_later(),
            _ => false,
        }
    }
}

impl SwarmError {
    /// Checks that the end of a run is not before the present step.
    ///
    /// # Errors
    ///
    /// [`SwarmError::Past`].
    pub fn check_not_past(until: Option<u64>, step: u64) -> Result<(), Self> {
        match until {
            Some(until) if until < step => Err(SwarmError::Past { until, step }),
            _ => Ok(()),
        }
    }
}

impl From<ReserveError> for SwarmError {
    fn from(error: ReserveError) -> Self {
        SwarmError::Change(error.into())
    }
}

fn not_joined(controller: &str, left: Option<(Departure, u64)>) -> String {
    let why = match left {
        None => return format!("no controller {controller} has joined: join first"),
        Some((Departure::Left, step)) => format!("left at step {step}"),
        Some((Departure::Lost, step)) => {
            format!("was lost at step {step} (its liveliness token is gone)")
        }
        Some((Departure::Late, step)) => {
            format!("missed {MAX_MISSES} deadlines up to step {step} and was removed")
        }
    };
    format!("controller {controller} {why}: join again")
}

fn not_claimed(id: u32, owner: Option<&str>) -> String {
    match owner {
        Some(owner) => format!("individual {id} is steered by controller {owner}"),
        None => format!("individual {id} is not among those that the controller joined for"),
    }
}
