//! The data of controllers: how they join, what is persisted, and their replies.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::SetPoints;

use crate::swarm::sender::Sender;

/// Missed deadlines in a row after which a controller is removed.
pub const MAX_MISSES: u32 = 3;

/// The longest deadline or lease.
const MAX_DEADLINE_SECS: f64 = 60.0;

/// A deadline of `secs` seconds, if that is valid.
pub fn deadline(secs: f64) -> Option<Duration> {
    let is_valid = secs > 0.0 && secs <= MAX_DEADLINE_SECS;
    is_valid.then(|| Duration::from_secs_f64(secs).max(Duration::from_nanos(1)))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The swarm steps when all controllers in lockstep have advanced.
    Lockstep,
    /// The swarm runs, and set-points are put meanwhile.
    FreeRunning,
}

/// What happens when a controller misses its deadline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnTimeout {
    /// Its individuals keep their last set-points.
    Hold,
    /// Its individuals become uninformed.
    Free,
    Pause,
}

/// How a controller takes part, as it requested when it joined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerSettings {
    pub mode: Mode,
    /// How long the swarm waits for it in lockstep, or how long its set-points hold otherwise.
    pub deadline: Duration,
    pub on_timeout: OnTimeout,
    /// Whether it may drive individuals directly.
    pub driving: bool,
}

#[derive(Clone, Debug, PartialEq)]
pub struct JoinOptions {
    pub controller: String,
    /// The individuals to steer; without it those that it claimed before, or none.
    pub selection: Option<Selection>,
    pub settings: ControllerSettings,
    /// Whether it rejoins and may replace itself.
    pub again: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Departure {
    Left,
    Lost,
    Late,
    /// It held the swarm and sent nothing for `max_idle_secs`. To others it was late.
    Idle,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Miss {
    pub controller: String,
    /// The step at which the swarm waited.
    pub step: u64,
    /// How many it has missed in a row.
    pub misses: u32,
}

/// What has happened since the last reply to a controller.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct News {
    /// Deadlines that fired, including its own.
    pub missed: Vec<Miss>,
    pub left: Vec<(String, Departure)>,
    /// Its individuals that were removed from the group.
    pub removed: Vec<u32>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct ControllerState {
    pub settings: ControllerSettings,
    pub claims: BTreeSet<u32>,
    pub steered: BTreeSet<u32>,
    /// The step that it has advanced to.
    pub target: u64,
    /// The step at which its last `advance` began.
    pub from: u64,
    /// The `advance` that has no reply yet.
    pub advance: Option<Arc<Sender>>,
    pub misses: u32,
    /// What its next reply contains.
    pub news: News,
    /// The number of the newest set-points that were applied.
    pub sequence: u64,
}

/// Set-points that wait for the next step.
#[derive(Clone, Debug)]
pub struct Put {
    pub sequence: u64,
    pub set: SetPoints,
    pub sender: Arc<Sender>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Puts {
    pub applied: u64,
    /// Not newer than an earlier one, or of another epoch.
    pub stale: u64,
    /// Replaced by a newer one before the next step.
    pub overtaken: u64,
    /// Rejected: for individuals that it has not claimed, or out of range.
    pub rejected: u64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct ControllerStatus {
    pub controller: String,
    pub state: ControllerState,
    /// How long the swarm has waited for it.
    pub waited: Option<Duration>,
    pub puts: Puts,
}
