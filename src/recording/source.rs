//! The source of a recording: a subscription to the states of a swarm.

use std::sync::Arc;

use jostle_physics::simulation::Spec;
use jostle_results::recording::{About, FROM_STEPS, SOURCE};

use super::queue::{Choice, FrameQueue};
use super::status::Status;
use crate::convert::{self, Payload};
use crate::swarm::frame::Frame;
use crate::swarm::handle::Handle;
use crate::swarm::output::Subscriber;

/// A subscription to the states of a swarm.
pub struct Source {
    /// The swarm's name.
    pub swarm: String,
    /// Which of its states are recorded.
    pub choice: Choice,
    /// Receives these states until `tap` is dropped.
    pub queue: Arc<FrameQueue>,
    /// Keeps the subscription.
    pub subscriber: Arc<dyn Subscriber>,
    spec: Arc<Spec>,
    now: Arc<Frame>,
}

impl Source {
    /// Starts to receive the swarm's states, beginning with the current one. If `every` is not
    /// given, it is the swarm's `publish_every`, or for a replay every frame. Call it between two
    /// steps. `missed` continues the count of dropped states.
    pub fn tap(
        handle: &Handle,
        now: &Arc<Frame>,
        (every, steps, drops): (Option<u64>, Option<u64>, bool),
        missed: u64,
    ) -> Self {
        let default = match now.replay {
            None => now.publish_every,
            Some(_) => 1,
        };
        let choice = Choice {
            every: every.unwrap_or(default).max(1),
            drops,
            steps,
        };
        let queue = Arc::new(FrameQueue::new(choice, missed, handle.waker()));
        let subscriber: Arc<dyn Subscriber> = queue.clone();
        subscriber.state((now.stamp.epoch, now.stamp.step), &|| now.clone());
        handle.output.subscribe(&subscriber);
        Source {
            swarm: handle.output.name.clone(),
            choice,
            spec: handle.spec.clone(),
            now: now.clone(),
            queue,
            subscriber,
        }
    }

    /// The metadata of its recording.
    pub fn about(&self, status: &Status) -> About {
        let json = |Payload { bytes, .. }| String::from_utf8_lossy(&bytes).into_owned();
        let spec = Payload::json(&jostle_convert::spec::to_proto(&self.spec, self.now.seed));
        let parameters = Payload::json(&convert::status(&self.now, None).parameters);
        let began = status.began_unix_secs.to_string();
        About::from([
            ("swarm".to_owned(), self.swarm.clone()),
            ("spec".to_owned(), json(spec)),
            ("parameters".to_owned(), json(parameters)),
            ("rate".to_owned(), json(Payload::json(&self.now.rate))),
            ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("began_unix_secs".to_owned(), began),
            (SOURCE.to_owned(), FROM_STEPS.to_owned()),
            ("every".to_owned(), self.choice.every.to_string()),
        ])
    }
}
