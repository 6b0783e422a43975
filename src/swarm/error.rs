//! Why a swarm rejects a command.

use jostle_physics::simulation::{ChangeError, ReserveError};
use thiserror::Error;

use crate::swarm::membership::{Departure, MAX_MISSES};
use crate::swarm::phase::PhaseError;

/// Why an order was not carried out; nothing has changed then.
#[derive(Clone, Debug, Error)]
pub enum SwarmError {
    /// The phase does not allow it.
    #[error(transparent)]
    Phase(#[from] PhaseError),
    /// The swarm is elsewhere than the sender takes it to be.
    #[error("the swarm is at {what} {actual}, not {expected}: look at its status and send again")]
    Conflict {
        /// `step` or `epoch`.
        what: &'static str,
        /// Where the sender takes it to be.
        expected: u64,
        /// Where it is.
        actual: u64,
    },
    /// The step it was to be carried out at lies behind.
    #[error("at_step {at_step} is in the past, the swarm is at step {step}: name a later one")]
    Late {
        /// The step asked for.
        at_step: u64,
        /// Where it is.
        step: u64,
    },
    /// Too many commands wait for their step.
    #[error("{limit} commands wait for their step already: send this one later, or reset")]
    TooManyScheduled {
        /// The limit.
        limit: usize,
    },
    /// The swarm was reset before the command's step came.
    #[error(
        "the swarm was reset before step {at_step} came: send it anew, under another request_id"
    )]
    Overtaken {
        /// The step it was to be carried out at.
        at_step: u64,
    },
    /// One of several changes is not possible, so none was made.
    #[error("commands[{index}]: {error}; none was applied")]
    InBatch {
        /// Which.
        index: usize,
        /// Why.
        error: Box<SwarmError>,
    },
    /// The order uncovered a defect.
    #[error("a defect of the daemon: nothing was changed; please report what you sent")]
    Panicked,
    /// The end of a run lies behind.
    #[error("until_step {until} is in the past, the swarm is at step {step}: name a later one")]
    Past {
        /// The end asked for.
        until: u64,
        /// Where it is.
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
        /// Why it is no longer there, and at which step it left.
        left: Option<(Departure, u64)>,
    },
    /// A controller of this name has joined.
    #[error(
        "a controller {0} has joined: take another name, or say `again` if it is the same one that \
         comes back"
    )]
    HasJoined(String),
    /// No more controllers can join.
    #[error("{limit} controllers have joined already: have one leave")]
    TooManyControllers {
        /// The limit.
        limit: usize,
    },
    /// Another controller steers an individual.
    #[error(
        "individual {id} is steered by controller {controller}: choose others, or have it leave"
    )]
    Claimed {
        /// Which.
        id: u32,
        /// Whose it is.
        controller: String,
    },
    /// A controller wants to steer an individual that is not its own.
    #[error("{}", not_claimed(*.id, .owner.as_deref()))]
    NotClaimed {
        /// Which.
        id: u32,
        /// Whose it is.
        owner: Option<String>,
    },
    /// A controller wants to drive individuals directly that did not join for it.
    #[error("controller {0} did not join to drive individuals directly: join with `driving`")]
    NotDriving(String),
    /// The swarm moves when its controllers advance.
    #[error(
        "controllers have joined, and the swarm steps when all of them `advance`: have them leave \
         first"
    )]
    Lockstep,
    /// A controller that steers while the swarm runs does not advance it.
    #[error("controller {0} joined a swarm that runs freely: join in mode lockstep to advance it")]
    RunsFreely(String),
    /// A controller's last advance is under way.
    #[error("controller {controller} is advancing to step {target} already: wait for that answer")]
    Advancing {
        /// Which.
        controller: String,
        /// Whither.
        target: u64,
    },
    /// The same controller asked again, and the newer request takes the place of this one.
    #[error("a later request of the same controller took the place of this one")]
    Superseded,
    /// It was refused before the daemon restarted, and is not tried again.
    #[error("it was refused before the daemon restarted: send it anew")]
    RefusedBefore,
    /// The order could not be made safe, so it was not carried out.
    #[error("{0}: nothing was changed; make room on the disk of data_dir and send it again")]
    Unsafe(WriteFault),
    /// A recording has no future that could be changed.
    #[error(
        "this is a replay of a recording: it takes run, pause, step, seek, reset and delete; create \
         or restore a swarm to change what happens"
    )]
    Recorded,
    /// Only a recording can be sought through.
    #[error("this swarm is no replay: fork it at a step it has passed, or replay a recording")]
    NotRecorded,
    /// A replay has no frame there.
    #[error(
        "{field} = {value} is outside the run that was recorded: give a {field} from {first} to \
         {last}, or a fraction from 0 to 1"
    )]
    OutsideRecording {
        /// `step` or `time`.
        field: &'static str,
        /// What was sought.
        value: f64,
        /// The first there is in the run of the recorded swarm that the replay is at.
        first: f64,
        /// The last there is.
        last: f64,
    },
    /// A recording cannot be shown.
    #[error("the recording cannot be shown: {0}")]
    Film(String),
    /// More than `limit` waited for the swarm, and this one had waited longest.
    #[error(
        "not yet so after {after_secs:.3} s, and more than {limit} wait for this swarm, of which \
         this one has waited longest: ask again in a moment"
    )]
    Displaced {
        /// How long it was waited for.
        after_secs: f64,
        /// How many may wait.
        limit: usize,
    },
    /// Too many orders at once.
    #[error("too much at once for this swarm: try again in a moment")]
    Busy,
    /// A step failed while the order ran.
    #[error("the swarm faulted while this ran ({0}): reset or delete it")]
    Faulted(String),
    /// The swarm ended before the order's turn.
    #[error("the swarm was deleted")]
    Gone,
}

/// Why something could not be written; nothing of it was.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum WriteFault {
    /// There is no space.
    #[error("no space is left for the journal")]
    Full,
    /// It failed otherwise, or the daemon stops.
    #[error("the journal cannot be written ({0})")]
    Failed(String),
}

impl SwarmError {
    /// Whether it may come out otherwise when the same is ordered again of the same state.
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

impl From<ReserveError> for SwarmError {
    fn from(error: ReserveError) -> Self {
        SwarmError::Change(error.into())
    }
}

fn not_joined(controller: &str, left: Option<(Departure, u64)>) -> String {
    let why = match left {
        None => return format!("no controller {controller} has joined: join first"),
        Some((Departure::Left, step)) => format!("left at step {step}"),
        Some((Departure::Lost, step)) => format!("was lost at step {step}, its token went"),
        Some((Departure::Late, step)) => {
            format!("missed {MAX_MISSES} deadlines up to step {step} and was let go")
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
