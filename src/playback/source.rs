//! The contents of a recording as its player reads them: frames, and the events between them.

use std::sync::Arc;

use jostle_physics::model::body::Gaps;
use jostle_physics::model::configuration::Configuration;
use jostle_physics::model::parameters::Parameters;
use jostle_physics::observables::{Order, RunningMeans};
use jostle_physics::simulation::Exactness;

/// The position of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameIndex {
    /// The epoch of the recorded swarm.
    pub epoch: u64,
    /// Its step.
    pub step: u64,
    /// Its time.
    pub time: f64,
    /// Time units since the first frame, without resets and gaps.
    pub position: f64,
}

/// An event of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedEvent {
    /// The number of frames before it.
    pub after: usize,
    /// Its step.
    pub step: u64,
    /// Its time.
    pub time: f64,
    /// The wall-clock time of the event, in seconds since 1970, if known.
    pub unix_secs: Option<f64>,
    /// The event as JSON.
    pub what: Arc<str>,
}

/// A frame of a recording.
#[derive(Clone, Debug)]
pub struct RecordedFrame {
    /// The parameters at this step.
    pub parameters: Parameters,
    /// The individuals.
    pub configuration: Configuration,
    /// Order and drift.
    pub order: Order,
    /// Their means.
    pub means: RunningMeans,
    /// The exactness of the step.
    pub exactness: Exactness,
    /// The measured gaps.
    pub gaps: Gaps,
}
