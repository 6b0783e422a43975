//! Frames, summaries and events of a swarm.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};
use std::time::{SystemTime, UNIX_EPOCH};

use jostle_measures::{Measure, Past, TooCostly, View};
use jostle_physics::model::body::{self, Gaps};
use jostle_physics::model::configuration::Configuration;
use jostle_physics::model::parameters::Parameters;
use jostle_physics::model::{State, WarmStart};
use jostle_physics::observables::{Order, RunningMeans};
use jostle_physics::simulation::{Exactness, Rate};

use crate::swarm::awaited::{WaitSummary, WatchStatus};
use crate::swarm::checkpoint::EarlierModel;
use crate::swarm::error::SwarmError;
use crate::swarm::fault::Fault;
use crate::swarm::membership::ControllerStatus;
use crate::swarm::phase::Phase;
use crate::swarm::sender::{Creation, Sender};

/// The epoch, step, time, phase and sequence number of a swarm, in every reply and event.
#[derive(Clone, Debug, PartialEq)]
pub struct Stamp {
    /// Grows whenever `step` does not continue the steps before.
    pub epoch: u64,
    /// The number of steps since the start.
    pub step: u64,
    /// `step · dt`.
    pub time: f64,
    /// The phase.
    pub phase: Phase,
    /// The number of applied commands.
    pub seq: u64,
}

/// A state and its observables.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Where the swarm was.
    pub stamp: Stamp,
    /// The parameters in force.
    pub parameters: Parameters,
    /// Steps between two published states.
    pub publish_every: u64,
    /// The names of the measures that are published.
    pub measures: Vec<String>,
    /// For how many seconds the swarm waits for a silent controller in lockstep.
    pub max_idle_secs: Option<f64>,
    /// The seed of every draw.
    pub seed: u64,
    /// The number of scheduled commands.
    pub scheduled: usize,
    /// The conditions that it waits for.
    pub conditions: Vec<WatchStatus>,
    /// The individuals.
    pub configuration: Configuration,
    /// Order and drift now.
    pub order: Order,
    /// Their means since the start or reset.
    pub means: RunningMeans,
    /// The exactness of the last step.
    pub exactness: Exactness,
    /// What went wrong, of a swarm that has faulted.
    pub fault: Option<Fault>,
    /// Whether the swarm rejects `delete` and `reset`.
    pub is_protected: bool,
    /// The versions of the model that computed steps before this one, oldest first.
    pub earlier_models: Vec<EarlierModel>,
    /// The rate.
    pub rate: Rate,
    /// The measured rate.
    pub real_time_factor: Option<f64>,
    /// Whether it is behind its rate.
    pub is_behind: bool,
    /// How many states a second are published at most; unknown for a playback.
    pub published_hz: Option<f64>,
    /// When its step was taken, if that is known.
    pub stepped: Option<SystemTime>,
    /// The numbers of the newest set-points that hold, by controller.
    pub sequences: BTreeMap<String, u64>,
    /// The position in the recording, of a playback.
    pub replay: Option<Replay>,
    /// The controllers that have joined, if requested.
    pub controllers: Vec<ControllerStatus>,
    /// The waits for conditions, if requested.
    pub waits: Vec<WaitSummary>,
    /// BLAKE3 of the state, if requested.
    pub hash: Option<[u8; 32]>,
    /// Computed by the first reader, not on the thread of the swarm.
    pub(crate) gaps: OnceLock<Gaps>,
    /// Computed by the thread of the swarm if the frame is published, otherwise by the first reader.
    pub(crate) values: OnceLock<BTreeMap<String, Option<f64>>>,
}

impl Frame {
    /// The gaps between the bodies, computed independently of the solver.
    pub fn gaps(&self) -> Gaps {
        *self
            .gaps
            .get_or_init(|| body::gaps(&self.parameters, &self.configuration))
    }

    /// The state, without what only steps need.
    pub fn state(&self) -> State {
        State {
            parameters: self.parameters,
            seed: self.seed,
            step: self.stamp.step,
            configuration: self.configuration.clone(),
            warm_start: WarmStart::default(),
        }
    }

    /// The values of the published measures by name: `None` where one is undefined or the group too
    /// large for it.
    pub fn values(&self) -> &BTreeMap<String, Option<f64>> {
        self.values.get_or_init(|| {
            if self.measures.is_empty() {
                return BTreeMap::new();
            }
            let (state, past) = (self.state(), Past::new(0));
            let view = View::new(&state, &past);
            let value = |name: &String| {
                let measure = name.parse::<Measure>().ok()?;
                measure.check_size(self.configuration.n()).ok()?;
                measure.evaluate(&view)
            };
            let values = self.measures.iter().map(|it| (it.clone(), value(it)));
            values.collect()
        })
    }
}

/// The position of a frame in a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Replay {
    /// The swarm that was recorded.
    pub of: Arc<str>,
    /// The number of the frame, from 1.
    pub frame: u64,
    /// The number of frames.
    pub frames: u64,
    /// Time units since the first.
    pub position: f64,
    /// Time units from the first to the last.
    pub duration: f64,
}

/// A swarm in a list: cheap enough to be kept up to date.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Where the swarm was.
    pub stamp: Stamp,
    /// The size of the group.
    pub n: usize,
    /// The number of informed individuals.
    pub informed: usize,
    /// The polar order parameter.
    pub order: f64,
    /// The rate.
    pub rate: Rate,
    /// The measured rate.
    pub real_time_factor: Option<f64>,
    /// Whether it is behind its rate.
    pub is_behind: bool,
    /// Whether it is a playback.
    pub is_replay: bool,
    /// Whether it rejects `delete` and `reset`.
    pub is_protected: bool,
    /// The versions of the model that computed steps before this one, oldest first.
    pub earlier_models: Vec<EarlierModel>,
}

/// An event of a swarm.
#[derive(Clone, Debug)]
pub struct Event {
    /// Its number, from 1.
    pub number: u64,
    /// Where the swarm was.
    pub stamp: Stamp,
    /// The wall-clock time, in seconds since 1970, if known.
    pub unix_secs: Option<f64>,
    /// What happened.
    pub kind: EventKind,
}

/// What happened.
#[derive(Clone, Debug)]
pub enum EventKind {
    /// It was created; `None` if the request is not known.
    Created(Option<Arc<Creation>>),
    /// Its phase changed.
    Phase,
    /// A command was applied.
    Command(Arc<Sender>),
    /// A command was scheduled for this step.
    Scheduled(u64, Arc<Sender>),
    /// A scheduled command was rejected, for this reason.
    Rejected(Arc<Sender>, SwarmError),
    /// These individuals are uninformed again.
    Lapsed(Vec<u32>),
    /// This version of the model goes on from a state of an earlier one.
    Model {
        /// The version that computed the state.
        from: u32,
        /// This version.
        to: u32,
    },
    /// A step failed.
    Fault(String),
    /// The recording of this name has failed, for this reason.
    RecordingFailed(Arc<str>, Arc<str>),
    /// An event of a recording, as JSON.
    Recorded(Arc<str>),
    /// It was deleted.
    Deleted(Arc<Sender>),
}

/// Checks that a group of `n` is not too large for measures of these names.
///
/// # Errors
///
/// [`TooCostly`].
pub fn check_sizes(names: &[String], n: usize) -> Result<(), TooCostly> {
    let measures = names.iter().filter_map(|it| it.parse::<Measure>().ok());
    measures.into_iter().try_for_each(|it| it.check_size(n))
}

/// The wall-clock time in events and in the journal: seconds since 1970, UTC, to the millisecond; `None`
/// if the clock is before 1970. No result depends on it, and no hash contains it.
pub fn unix_secs() -> Option<f64> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    Some(since.as_millis() as f64 / 1000.0)
}
