//! What a swarm shows of itself.

use std::sync::{Arc, OnceLock};

use jostle_physics::model::body::{self, Gaps};
use jostle_physics::model::configuration::Configuration;
use jostle_physics::model::parameters::Parameters;
use jostle_physics::observables::{Order, RunningMeans};
use jostle_physics::simulation::{Exactness, Rate};

use crate::swarm::error::SwarmError;
use crate::swarm::membership::Seen;
use crate::swarm::phase::Phase;
use crate::swarm::sender::Sender;

/// Where a swarm is: the head of every answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Grows whenever `step` does not continue what was shown before.
    pub epoch: u64,
    /// The number of steps since the start.
    pub step: u64,
    /// `step · dt`.
    pub time: f64,
    /// What it is doing.
    pub phase: Phase,
    /// Counts the applied commands.
    pub seq: u64,
}

/// A whole state, measured.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Where the swarm is.
    pub place: Place,
    /// The parameters in force.
    pub parameters: Parameters,
    /// Steps between two published states.
    pub publish_every: u64,
    /// The seed of every draw.
    pub seed: u64,
    /// Commands that wait for their step.
    pub scheduled: usize,
    /// Everybody.
    pub configuration: Configuration,
    /// Order and drift now.
    pub order: Order,
    /// Their means since the start or reset.
    pub means: RunningMeans,
    /// How exact the last step was.
    pub exactness: Exactness,
    /// How fast it is to run.
    pub rate: Rate,
    /// How fast it lately ran.
    pub real_time_factor: Option<f64>,
    /// What it is a frame of, if it was recorded.
    pub replay: Option<Replay>,
    /// The controllers that have joined, where they were asked for.
    pub controllers: Vec<Seen>,
    /// BLAKE3 of the state, where it was asked for.
    pub hash: Option<[u8; 32]>,
    /// Filled by the first who asks, so that the swarm's thread need not measure.
    pub(crate) gaps: OnceLock<Gaps>,
}

impl Frame {
    /// The gaps between the bodies, measured apart from the solver.
    pub fn gaps(&self) -> Gaps {
        *self
            .gaps
            .get_or_init(|| body::gaps(&self.parameters, &self.configuration))
    }
}

/// Where in a recording a frame stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Replay {
    /// The swarm that was recorded.
    pub of: Arc<str>,
    /// The number of the frame, from 1.
    pub frame: u64,
    /// How many there are.
    pub frames: u64,
    /// Time units since the first.
    pub position: f64,
    /// Time units from the first to the last.
    pub duration: f64,
}

/// A swarm in a list: cheap enough to be kept up to date always.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Where it is.
    pub place: Place,
    /// The size of the group.
    pub n: usize,
    /// How many of it are informed.
    pub informed: usize,
    /// The polar order parameter.
    pub order: f64,
    /// How fast it is to run.
    pub rate: Rate,
    /// How fast it lately ran.
    pub real_time_factor: Option<f64>,
    /// Whether it is a recording.
    pub is_replay: bool,
}

/// Something that happened to a swarm.
#[derive(Clone, Debug)]
pub struct Event {
    /// Counts them from 1.
    pub number: u64,
    /// Where the swarm was.
    pub place: Place,
    /// The wall-clock time, in seconds since 1970, if known.
    pub unix_secs: Option<f64>,
    /// What happened.
    pub kind: EventKind,
}

/// What happened.
#[derive(Clone, Debug)]
pub enum EventKind {
    /// It was created.
    Created,
    /// Its phase changed.
    Phase,
    /// A command was applied.
    Command(Arc<Sender>),
    /// A command waits for this step.
    Scheduled(u64, Arc<Sender>),
    /// A command that waited for its step was not carried out, for this reason.
    Refused(Arc<Sender>, SwarmError),
    /// These are uninformed again.
    Lapsed(Vec<u32>),
    /// A step failed.
    Fault(String),
    /// The daemon's recording of that name has failed, for this reason.
    RecordingFailed(Arc<str>, Arc<str>),
    /// A recording tells this, as JSON.
    Told(Arc<str>),
    /// It was deleted.
    Deleted,
}
