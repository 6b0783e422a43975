//! Why a swarm rejects a command.

use std::sync::Arc;

use jostle_measures::{PastError, TooCostly, TooCostlyTogether};
use jostle_physics::simulation::{ChangeError, ReserveError};
use thiserror::Error;

use crate::swarm::membership::{Departure, MAX_MISSES};
use crate::swarm::phase::PhaseError;

/// Controllers that an error names.
const MAX_NAMED: usize = 3;

/// Why a command was rejected; nothing has changed.
#[derive(Clone, Debug, Error)]
#[expect(missing_docs, reason = "the messages say when each is returned")]
pub enum SwarmError {
    #[error(transparent)]
    Phase(#[from] PhaseError),
    #[error("the swarm is at {what} {actual}, not {expected}: look at its status and send again")]
    Conflict {
        /// `step` or `epoch`.
        what: &'static str,
        expected: u64,
        actual: u64,
    },
    #[error("at_step {at_step} is in the past, the swarm is at step {step}: name a later one")]
    Late { at_step: u64, step: u64 },
    #[error("{}", too_many_scheduled(*.count, *.max_bytes, .user.as_deref()))]
    TooManyScheduled {
        /// How many are scheduled.
        count: usize,
        /// What the text of all may take.
        max_bytes: usize,
        /// The user whose they are, of a daemon with users.
        user: Option<String>,
    },
    #[error(
        "{0} conditions wait already: `jostle when NAME` lists them, and `jostle when NAME --cancel ID` removes one"
    )]
    TooManyWatches(usize),
    #[error("{}", too_many_waits(*.count, .user.as_deref()))]
    TooManyWaits {
        /// How many wait.
        count: usize,
        /// The user whose they are, if the limit is that of a user.
        user: Option<String>,
    },
    #[error("{}", too_many_measures(*.count, *.limit, .user))]
    TooManyMeasuresOfUser {
        /// How many different ones the waits of the user would compare.
        count: usize,
        limit: usize,
        user: String,
    },
    /// The measures of the conditions take too long together.
    #[error(transparent)]
    TooCostlyTogether(#[from] TooCostlyTogether),
    #[error(
        "no memory is left for the earlier states of the condition: {needed} bytes are needed, {free} are \
             free: choose a shorter lag, end other waits, delete a swarm, or raise max_memory_mb"
    )]
    NoMemoryOfPast { needed: u64, free: u64 },
    /// The key of a liveliness token; empty for a connection.
    #[error("{}", not_held(.0))]
    NotHeld(String),
    #[error("no condition {0:?} waits: `jostle when NAME` lists those that do")]
    NoCondition(String),
    /// The measures of a condition need too many states of earlier steps.
    #[error(transparent)]
    TooMuchPast(#[from] PastError),
    #[error("the swarm was reset before step {0} came: send it again with another request_id")]
    Overtaken(u64),
    #[error("a condition ended the protocol before step {0} came")]
    Ended(u64),
    #[error(
        "the condition holds already: send the action itself; without from_step the condition waits for \
         the next step"
    )]
    HoldsAlready,
    #[error(
        "no condition with event {0:?} waits, and none of the newest commands is that it held: it was removed \
         by cancel, reset or its last step; send `when` again"
    )]
    NoEvent(Arc<str>),
    #[error("commands[{index}]: {error}; none was applied")]
    InBatch {
        index: usize,
        error: Box<SwarmError>,
    },
    /// The group is too large for a measure that it would publish.
    #[error(transparent)]
    TooCostly(#[from] TooCostly),
    /// The command panicked.
    #[error("a defect of the daemon: nothing was changed; please report what you sent")]
    Panicked,
    #[error("until_step {until} is in the past, the swarm is at step {step}: name a later one")]
    Past { until: u64, step: u64 },
    #[error(transparent)]
    Change(#[from] ChangeError),
    #[error("{}", not_joined(.controller, *.left))]
    NotJoined {
        controller: String,
        /// Why and at which step it left, if it had joined.
        left: Option<(Departure, u64)>,
    },
    #[error(
        "a controller {0} has joined: take another name, or set `again` if it is the same one that \
         rejoins"
    )]
    HasJoined(String),
    #[error("{0} controllers have joined already: remove one with `leave`")]
    TooManyControllers(usize),
    #[error(
        "{count} controllers of {user} have joined this swarm or are scheduled to join, which is the most \
         of a user who is no operator: remove one with `leave`"
    )]
    TooManyOfUser { count: usize, user: String },
    #[error(
        "individual {id} is steered by controller {controller}: choose others, or send `leave` for it"
    )]
    Claimed { id: u32, controller: String },
    #[error("{}", not_claimed(*.id, .owner.as_deref()))]
    NotClaimed { id: u32, owner: Option<String> },
    #[error("controller {0} did not join to drive individuals directly: join with `driving`")]
    NotDriving(String),
    #[error("{}", lockstep(.swarm, .controllers))]
    Lockstep {
        swarm: String,
        /// Those that the swarm waits for; all in lock-step while it steps.
        controllers: Vec<String>,
    },
    #[error("controller {0} joined in mode free_running: join again in mode lockstep to advance")]
    RunsFreely(String),
    #[error("controller {controller} is advancing to step {target} already: wait for that reply")]
    Advancing { controller: String, target: u64 },
    /// A `delete` or `reset` of the swarm of this name, which is protected.
    #[error(
        "{0} is protected from delete and reset: `jostle protect --off {0}`, or `protect` with \"on\": false, \
         ends that; then send this again"
    )]
    Protected(String),
    #[error("a later request of the same controller took the place of this one")]
    Superseded,
    /// The command was rejected before the daemon restarted; a replay does not execute it.
    #[error("it was rejected before the daemon restarted: send it again")]
    RejectedBefore,
    /// The command could not be made durable, so it was not executed.
    #[error("{0}: nothing was changed; make room on the disk of data_dir and send it again")]
    NotDurable(WriteFault),
    /// A playback does not accept this command.
    #[error(
        "this is a replay of a recording: it takes run, pause, step, seek, reset and delete; create \
         or restore a swarm to change what happens"
    )]
    Recorded,
    /// A playback has no conditions.
    #[error(
        "this is a replay of a recording: one waits in it for a step or a phase, not for a condition; \
         create or restore a swarm for that"
    )]
    NoConditions,
    /// Only a playback can seek.
    #[error("this swarm is no replay: fork it at a step it has passed, or replay a recording")]
    NotRecorded,
    #[error(
        "{field} = {value} is outside the run that was recorded: give a {field} from {first} to \
         {last}, or a fraction from 0 to 1"
    )]
    OutsideRecording {
        /// `step` or `time`.
        field: &'static str,
        value: f64,
        /// The first in the run at which the playback is.
        first: f64,
        /// The last in that run.
        last: f64,
    },
    #[error("cannot play the recording: {0}")]
    Playback(String),
    #[error(
        "condition not met within {after_secs:.3} s, and more than {limit} queries wait for this \
         swarm, of which this one has waited longest: retry"
    )]
    Displaced { after_secs: f64, limit: usize },
    #[error("the queue of this swarm is full: retry in a moment")]
    Busy,
    #[error("the swarm faulted while this ran ({0}): reset or delete it")]
    Faulted(String),
    /// The swarm ended before it received the command.
    #[error("the swarm was deleted")]
    Gone,
}

/// Why a write to the journal failed; nothing was written.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[expect(missing_docs, reason = "the messages say when each is returned")]
pub enum WriteFault {
    #[error("no space is left for the journal")]
    Full,
    /// Another failure, or the daemon is stopping.
    #[error("the journal cannot be written ({0})")]
    Failed(String),
}

impl SwarmError {
    /// Whether the same command may succeed later in the same state. A replay applies changes that are
    /// weightless, as earlier versions did.
    pub fn may_succeed_later(&self) -> bool {
        match self {
            SwarmError::Change(ChangeError::Reserve(_) | ChangeError::Weightless)
            | SwarmError::Panicked
            | SwarmError::NotDurable(_) => true,
            SwarmError::InBatch { error, .. } => error.may_succeed_later(),
            _ => false,
        }
    }

    /// The error of a change of a batch, with its index.
    pub fn in_batch((index, error): (usize, ChangeError)) -> Self {
        SwarmError::InBatch {
            index,
            error: Box::new(error.into()),
        }
    }

    /// Checks that the end of a run is not before the present step.
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
        Some((Departure::Idle, step)) => {
            format!("was removed at step {step}, since it sent nothing for max_idle_secs")
        }
    };
    format!("controller {controller} {why}: join again")
}

fn lockstep(swarm: &str, controllers: &[String]) -> String {
    let named = controllers.len().min(MAX_NAMED);
    let mut names = controllers[..named].join(", ");
    if named < controllers.len() {
        names = format!("{names} and {} others", controllers.len() - named);
    }
    let one = controllers.first().map_or("", String::as_str);
    format!(
        "the swarm steps when its controllers in lock-step `advance`, and waits for {names}: an operator \
         removes one with `jostle leave {swarm} {one}`, and those that send nothing for a minute with \
         `jostle set {swarm} max_idle_secs=60`"
    )
}

fn too_many_scheduled(count: usize, max_bytes: usize, user: Option<&str>) -> String {
    let max = max_bytes / 1024;
    match user {
        Some(user) => format!(
            "{count} commands of {user} are scheduled in this swarm, of at most {max} KiB: send this one once \
             some of them are executed; a `reset` of an operator removes them"
        ),
        None => format!(
            "{count} commands are scheduled, of at most {max} KiB: send this one later, or reset"
        ),
    }
}

fn too_many_waits(count: usize, user: Option<&str>) -> String {
    match user {
        Some(user) => format!(
            "{count} requests of {user} wait for conditions of this swarm already, which is the most of a \
             user: end one of them, or wait until its condition holds"
        ),
        None => format!(
            "{count} requests wait for conditions of this swarm already: `jostle status` lists them; send this \
             one once one of them has ended"
        ),
    }
}

fn too_many_measures(count: usize, limit: usize, user: &str) -> String {
    let of = match user {
        "" => "of clients without a token".to_owned(),
        user => format!("of {user}"),
    };
    format!(
        "the waits {of} in this swarm would compare {count} different measures after every step, the limit of a \
         user who is no operator is {limit}: compare fewer, or end other waits"
    )
}

fn not_held(key: &str) -> String {
    match key {
        "" => "the connection that held this wait is closed: send it again".to_owned(),
        key => format!(
            "the liveliness token {key} of this wait is not declared: declare it before the query, and keep it \
             until the wait has ended"
        ),
    }
}

fn not_claimed(id: u32, owner: Option<&str>) -> String {
    match owner {
        Some(owner) => format!("individual {id} is steered by controller {owner}"),
        None => format!("individual {id} is not among those that the controller joined for"),
    }
}
