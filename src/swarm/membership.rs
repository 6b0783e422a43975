//! Controllers as data: how they join, what persists of them, and what they are sent.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::SetPoints;

use crate::swarm::sender::Sender;

/// Misses after which a controller has left.
pub const MAX_MISSES: u32 = 3;

/// The longest that others wait for a controller, or that its set-points hold.
const LONGEST_DEADLINE_SECS: f64 = 60.0;

/// So many seconds, if a deadline may be so long.
pub fn deadline(secs: f64) -> Option<Duration> {
    let is_fine = secs > 0.0 && secs <= LONGEST_DEADLINE_SECS;
    is_fine.then(|| Duration::from_secs_f64(secs).max(Duration::from_nanos(1)))
}

/// How a controller takes part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The swarm steps when every one of these has advanced.
    Lockstep,
    /// The swarm runs; set-points are put while it does.
    FreeRunning,
}

/// What becomes of the individuals of a controller that is late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnTimeout {
    /// They keep their last set-points.
    Hold,
    /// They are uninformed.
    Free,
    /// The swarm pauses.
    Pause,
}

/// What a controller joins with.
#[derive(Clone, Debug, PartialEq)]
pub struct JoinOptions {
    /// Its name.
    pub controller: String,
    /// Whom it is to steer; without one nobody, or whom it steered before.
    pub selection: Option<Selection>,
    /// How it takes part.
    pub mode: Mode,
    /// How long others wait for it, or how long its set-points hold.
    pub deadline: Duration,
    /// What becomes of its individuals when it is late.
    pub on_timeout: OnTimeout,
    /// Whether it may drive individuals directly.
    pub driving: bool,
    /// Whether it comes back, and takes the place it had.
    pub again: bool,
}

/// Why a controller has left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Departure {
    /// It said so.
    Left,
    /// Its liveliness token went.
    Lost,
    /// It was late too often.
    Late,
}

/// A deadline that fired.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Miss {
    /// Whose.
    pub controller: String,
    /// The step at which the swarm waited.
    pub step: u64,
    /// How many it has missed in a row.
    pub misses: u32,
}

/// What a controller is told beside the step reached: what came about since it was last told.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct News {
    /// Deadlines that fired, its own too.
    pub missed: Vec<Miss>,
    /// Controllers that have left.
    pub left: Vec<(String, Departure)>,
    /// Individuals of its own that were removed.
    pub removed: Vec<u32>,
}

/// All of a controller that outlives a crash.
#[derive(Clone, Debug, PartialEq)]
pub struct ControllerState {
    /// How it takes part.
    pub mode: Mode,
    /// How long others wait for it, or how long its set-points hold.
    pub deadline: Duration,
    /// What becomes of its individuals when it is late.
    pub on_timeout: OnTimeout,
    /// Whether it may drive individuals directly.
    pub driving: bool,
    /// Whom it may steer.
    pub claims: BTreeSet<u32>,
    /// Whom it has steered.
    pub steered: BTreeSet<u32>,
    /// The step that it has advanced to.
    pub target: u64,
    /// The step at which it began to.
    pub from: u64,
    /// The `advance` that is to be answered.
    pub advance: Option<Arc<Sender>>,
    /// Deadlines missed in a row.
    pub misses: u32,
    /// What it is yet to be told.
    pub news: News,
    /// The newest set-points that were applied have this number.
    pub sequence: u64,
}

/// Set-points by `put` that wait for the next step.
#[derive(Clone, Debug)]
pub struct Put {
    /// Counts a controller's puts.
    pub sequence: u64,
    /// What it wants.
    pub set: SetPoints,
    /// As they came.
    pub sender: Arc<Sender>,
}

/// What has become of a controller's puts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Puts {
    /// Applied.
    pub applied: u64,
    /// Not newer than one that came before, or of another epoch.
    pub stale: u64,
    /// Overtaken by a newer one before the next step.
    pub overtaken: u64,
    /// Of individuals that are not its own, or with a number out of range.
    pub refused: u64,
}

/// A controller as others see it.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Its name.
    pub controller: String,
    /// How it takes part.
    pub mode: Mode,
    /// Its individuals.
    pub ids: Vec<u32>,
    /// Its deadline or lease.
    pub deadline: Duration,
    /// What becomes of its individuals when it is late.
    pub on_timeout: OnTimeout,
    /// Whether it may drive individuals directly.
    pub driving: bool,
    /// The step that it has advanced to, in lock-step.
    pub target: Option<u64>,
    /// Deadlines missed in a row.
    pub misses: u32,
    /// How long the swarm has waited for it.
    pub waited: Option<Duration>,
    /// What has become of its puts.
    pub puts: Puts,
}
