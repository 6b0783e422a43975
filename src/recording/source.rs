//! The source of a recording: a subscription to the states of a swarm.

use std::sync::Arc;

use jostle_physics::simulation::Spec;
use jostle_results::recording::{About, FROM_STEPS, SOURCE};

use super::gaps;
use super::status::{Position, Status};
use crate::convert::{self, Payload};
use crate::swarm::frame::Frame;
use crate::swarm::handle::Handle;
use crate::swarm::output::{Limits, Overflow, Subscription};

/// Capacity of the queue in states.
const MAX_FRAMES: usize = 64;

/// Capacity of the queue in individuals of these states: some megabytes.
const MAX_INDIVIDUALS: usize = 128 * 1024;

/// A subscription to the states of a swarm.
pub struct Source {
    /// Receives the states whose step is a multiple of `every`.
    pub subscription: Arc<Subscription>,
    /// The swarm's `publish_every` unless the recording has another one; for a replay every frame.
    pub every: u64,
    spec: Arc<Spec>,
    now: Arc<Frame>,
}

impl Source {
    /// Starts to receive the states that a recording of this status contains, beginning with the
    /// current one. Call it between two steps.
    pub fn subscribe(handle: &Handle, now: &Arc<Frame>, status: &Status) -> Self {
        Source::limited(handle, now, status, status.steps_left)
    }

    /// As [`Self::subscribe`], for a recording that was interrupted: the number of its remaining steps is
    /// known only once its files are open.
    pub(super) fn resume(handle: &Handle, now: &Arc<Frame>, status: &Status) -> Self {
        Source::limited(handle, now, status, None)
    }

    fn limited(handle: &Handle, now: &Arc<Frame>, status: &Status, steps: Option<u64>) -> Self {
        let default = match now.replay {
            None => now.publish_every,
            Some(_) => 1,
        };
        let every = status.every.unwrap_or(default).max(1);
        let limits = Limits {
            every,
            steps,
            frames: MAX_FRAMES,
            individuals: MAX_INDIVIDUALS,
            overflow: match status.drop_when_behind {
                true => Overflow::DropNewest,
                false => Overflow::Block(Box::new(handle.waker())),
            },
        };
        let subscription = handle.output.subscribe(limits);
        subscription.push_state((now.stamp.epoch, now.stamp.step), || now.clone());
        Source {
            subscription,
            every,
            spec: handle.spec.clone(),
            now: now.clone(),
        }
    }

    /// The first state that it receives, if that is a multiple of `every`.
    pub(super) fn began_at(&self) -> Position {
        (self.now.stamp.epoch, self.now.stamp.step).into()
    }

    pub fn about(&self, status: &Status) -> About {
        let json = |Payload { bytes, .. }| String::from_utf8_lossy(&bytes).into_owned();
        let spec = Payload::json(&jostle_convert::spec::to_proto(&self.spec, self.now.seed));
        let parameters = Payload::json(&convert::present(&self.now));
        let about = [
            ("swarm", status.swarm.clone()),
            ("spec", json(spec)),
            ("parameters", json(parameters)),
            ("rate", json(Payload::json(&self.now.rate))),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("began_unix_secs", status.began_unix_secs.to_string()),
            (SOURCE, FROM_STEPS.to_owned()),
            ("every", self.every.to_string()),
        ];
        let mut about = About::from(about.map(|(key, value)| (key.to_owned(), value)));
        gaps::describe(&status.gaps, &mut about);
        about
    }
}
