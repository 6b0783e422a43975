//! The source of a recording: a subscription to the states of a swarm.

use std::sync::Arc;

use jostle_physics::simulation::Spec;
use jostle_results::recording::{About, FROM_STEPS, SOURCE};

use super::status::Status;
use crate::convert::{self, Payload};
use crate::swarm::frame::Frame;
use crate::swarm::handle::Handle;
use crate::swarm::output::{Limits, Overflow, Subscription};

/// Capacity of the queue in states.
const MAX_FRAMES: usize = 64;

/// Capacity of the queue in individuals of these states: some megabytes.
const MAX_INDIVIDUALS: usize = 128 * 1024;

/// Which states of a swarm are recorded.
#[derive(Clone, Copy, Debug)]
pub struct Choice {
    /// Those whose step is a multiple of this. If not given, it is the swarm's `publish_every`, or for
    /// a replay every frame.
    pub every: Option<u64>,
    /// The number of steps of the swarm after which the recording ends.
    pub steps: Option<u64>,
    /// Whether a state is dropped while the queue is full; otherwise the swarm waits.
    pub drops: bool,
}

/// A subscription to the states of a swarm.
pub struct Source {
    /// The swarm's name.
    pub swarm: String,
    /// Which of its states are recorded.
    pub choice: Choice,
    /// Receives these states.
    pub subscription: Arc<Subscription>,
    spec: Arc<Spec>,
    now: Arc<Frame>,
}

impl Source {
    /// Starts to receive the swarm's states, beginning with the current one. Call it between two
    /// steps.
    pub fn subscribe(handle: &Handle, now: &Arc<Frame>, choice: Choice) -> Self {
        let default = match now.replay {
            None => now.publish_every,
            Some(_) => 1,
        };
        let every = choice.every.unwrap_or(default).max(1);
        let limits = Limits {
            every,
            steps: choice.steps,
            frames: MAX_FRAMES,
            individuals: MAX_INDIVIDUALS,
            overflow: match choice.drops {
                true => Overflow::DropNewest,
                false => Overflow::Block(Box::new(handle.waker())),
            },
        };
        let subscription = handle.output.subscribe(limits);
        subscription.state((now.stamp.epoch, now.stamp.step), || now.clone());
        Source {
            swarm: handle.output.name.clone(),
            choice: Choice {
                every: Some(every),
                ..choice
            },
            subscription,
            spec: handle.spec.clone(),
            now: now.clone(),
        }
    }

    /// The metadata of its recording.
    pub fn about(&self, status: &Status) -> About {
        let json = |Payload { bytes, .. }| String::from_utf8_lossy(&bytes).into_owned();
        let spec = Payload::json(&jostle_convert::spec::to_proto(&self.spec, self.now.seed));
        let parameters = Payload::json(&convert::status(&self.now, None).parameters);
        let every = self.choice.every.unwrap_or_default();
        let about = [
            ("swarm", self.swarm.clone()),
            ("spec", json(spec)),
            ("parameters", json(parameters)),
            ("rate", json(Payload::json(&self.now.rate))),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("began_unix_secs", status.began_unix_secs.to_string()),
            (SOURCE, FROM_STEPS.to_owned()),
            ("every", every.to_string()),
        ];
        About::from(about.map(|(key, value)| (key.to_owned(), value)))
    }
}
