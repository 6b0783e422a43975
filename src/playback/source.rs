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
    pub step: u64,
    pub time: f64,
    /// Time units since the first frame, without resets and gaps.
    pub position: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct RecordedEvent {
    /// The number of frames before it.
    pub after: usize,
    pub step: u64,
    pub time: f64,
    /// The wall-clock time of the event, in seconds since 1970, if known.
    pub unix_secs: Option<f64>,
    pub what: Arc<str>,
}

#[derive(Clone, Debug)]
pub struct RecordedFrame {
    pub parameters: Parameters,
    pub configuration: Configuration,
    pub order: Order,
    pub means: RunningMeans,
    pub exactness: Exactness,
    pub gaps: Gaps,
}
