//! A recording as its player sees it: frames, what they show, and what was told between them.

use std::sync::Arc;

use jostle_physics::model::body::Gaps;
use jostle_physics::model::configuration::Configuration;
use jostle_physics::model::parameters::Parameters;
use jostle_physics::observables::{Order, RunningMeans};
use jostle_physics::simulation::Exactness;

/// A recording, as far as it is to be shown.
pub trait Film: Send {
    /// The swarm that was recorded.
    fn swarm(&self) -> &Arc<str>;
    /// Its frames, at least one; positions never fall.
    fn marks(&self) -> &[Mark];
    /// Its events, in order.
    fn told(&self) -> &[Told];
    /// A frame as a whole.
    ///
    /// # Errors
    ///
    /// Why it cannot be read.
    fn shot(&mut self, frame: usize) -> Result<Shot, String>;
}

/// Where a frame belongs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// The epoch of the recorded swarm.
    pub epoch: u64,
    /// Its step.
    pub step: u64,
    /// Its time.
    pub time: f64,
    /// Time units since the film's first frame, resets and gaps left out.
    pub position: f64,
}

/// An event of a film.
#[derive(Clone, Debug, PartialEq)]
pub struct Told {
    /// How many frames come before it.
    pub after: usize,
    /// The step it happened at.
    pub step: u64,
    /// Its time.
    pub time: f64,
    /// The wall-clock time when it was recorded, in seconds since 1970, if known.
    pub unix_secs: Option<f64>,
    /// What happened, as JSON.
    pub what: Arc<str>,
}

/// A frame of a film.
#[derive(Clone, Debug)]
pub struct Shot {
    /// The parameters then in force.
    pub parameters: Parameters,
    /// Everybody.
    pub configuration: Configuration,
    /// Order and drift.
    pub order: Order,
    /// Their means.
    pub means: RunningMeans,
    /// How exact the step was.
    pub exactness: Exactness,
    /// The gaps, as they were measured.
    pub gaps: Gaps,
}
