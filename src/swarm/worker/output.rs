//! The frames, events and summary that a worker publishes, and its replies to waiting queries.

use std::sync::{Arc, OnceLock};
use std::time::Instant;

use serde_json::Value;

use crate::swarm::frame::{self, Event, EventKind, Frame, Stamp, Summary};
use crate::swarm::handle::Outcome;
use crate::swarm::history::Entry;
use crate::swarm::waiters::EventStatus;
use crate::swarm::worker::Worker;

impl Worker {
    pub fn stamp_and_frame(&self) -> (Stamp, Arc<Frame>) {
        (self.stamp(), self.frame(true))
    }

    pub(super) fn state_with_controllers(&self) -> (Stamp, Arc<Frame>) {
        let (stamp, frame) = self.stamp_and_frame();
        if self.controllers.is_empty() && self.waits.is_empty() {
            return (stamp, frame);
        }
        let mut frame = Arc::unwrap_or_clone(frame);
        frame.controllers = self.controllers.statuses(Instant::now());
        frame.waits = self.waits.summaries();
        (stamp, Arc::new(frame))
    }

    pub(super) fn reply_to_waiters(&mut self) {
        let mut waiters = std::mem::take(&mut self.waiters);
        let step = self.simulation.state.step;
        let state = || {
            let (stamp, frame) = self.state_with_controllers();
            Ok((stamp, Outcome::State(frame)))
        };
        waiters.reply(step, &self.phase, state, |event| self.event_status(event));
        self.waiters = waiters;
    }

    /// Whether the condition with an event waits, or the last command that concerns it is that it held.
    fn event_status(&self, event: &str) -> EventStatus {
        if self.watches.has_event(event) {
            return EventStatus::Waits;
        }
        let entries = self.history.entries(0, usize::MAX).records;
        let mut newest_first = entries.iter().rev();
        match newest_first.find(|it| concerns(it, event)) {
            Some(entry) if entry.sender.verb == "fired" => EventStatus::Held,
            _ => EventStatus::Unknown,
        }
    }

    pub(super) fn stamp(&self) -> Stamp {
        Stamp {
            epoch: self.simulation.epoch,
            step: self.simulation.state.step,
            time: self.simulation.state.time(),
            phase: self.phase.clone(),
            seq: self.seq(),
        }
    }

    pub(super) fn frame(&self, hashed: bool) -> Arc<Frame> {
        let simulation = &self.simulation;
        Arc::new(Frame {
            stamp: self.stamp(),
            parameters: simulation.state.parameters,
            publish_every: simulation.publish_every,
            measures: simulation.measures.clone(),
            max_idle_secs: simulation.max_idle_secs,
            seed: simulation.state.seed,
            is_protected: self.is_protected,
            earlier_models: self.earlier_models.clone(),
            scheduled: self.schedule.count(),
            conditions: self.watches.statuses(
                simulation.state.configuration.n(),
                simulation.state.parameters.dt,
            ),
            configuration: simulation.state.configuration.clone(),
            order: simulation.order(),
            means: simulation.means,
            exactness: simulation.exactness,
            fault: self.fault.clone().filter(|_| self.is_faulted()),
            rate: self.rate,
            real_time_factor: self.real_time_factor(),
            is_behind: self.is_behind(),
            published_hz: Some(self.published_hz()),
            stepped: self
                .stepped
                .and_then(|(at, time)| (at == self.at()).then_some(time)),
            sequences: self.controllers.sequences(),
            replay: None,
            controllers: Vec::new(),
            waits: Vec::new(),
            hash: hashed.then(|| simulation.state.hash()),
            gaps: OnceLock::new(),
            values: OnceLock::new(),
        })
    }

    /// How many states a second are published at most while it runs.
    pub(super) fn published_hz(&self) -> f64 {
        // `max_hz` is whole, the interval is rounded to nanoseconds.
        let most = self.min_frame_interval.as_secs_f64().recip().round();
        let every = self.simulation.publish_every as f64 * self.simulation.state.parameters.dt;
        self.rate.map_or(most, |rate| most.min(rate / every))
    }

    fn is_behind(&self) -> bool {
        self.phase.is_moving() && self.pace.is_behind(Instant::now())
    }

    fn real_time_factor(&self) -> Option<f64> {
        self.phase
            .is_moving()
            .then(|| self.pace.real_time_factor())
            .flatten()
    }

    pub(super) fn push_frame(&self) {
        let is_moving = self.phase.is_moving();
        self.output.push_frame(is_moving, || {
            let frame = self.frame(false);
            // Here, so that costly measures delay only this swarm and not the publisher of all.
            frame.values();
            frame
        });
    }

    /// The wall-clock time of what happens now, in seconds since 1970. During a replay only the times
    /// in the journal are known.
    pub(super) fn unix_secs(&self) -> Option<f64> {
        match self.applied_at {
            Some(at) => at,
            None if self.journal.is_replaying() => None,
            None => frame::unix_secs(),
        }
    }

    /// Executes `work` with one wall-clock time, which its journal line and its events share.
    pub(super) fn applied_at<T>(
        &mut self,
        unix_secs: Option<f64>,
        work: impl FnOnce(&mut Self) -> T,
    ) -> T {
        let outer = self.applied_at.replace(unix_secs);
        let done = work(self);
        self.applied_at = outer;
        done
    }

    /// Passes the state to the recordings, whether or not it is published.
    pub(super) fn record_state(&self) {
        self.output.push_state(self.at(), || self.frame(false));
    }

    pub(super) fn push_event(&mut self, kind: EventKind) {
        self.events += 1;
        let event = Event {
            number: self.events,
            stamp: self.stamp(),
            unix_secs: self.unix_secs(),
            kind,
        };
        self.history.record_event(&event);
        // Replayed events were published before.
        if !self.journal.is_replaying() {
            self.output.push_event(&event);
        }
    }

    pub(super) fn update_summary(&mut self) {
        self.summary_updated = Instant::now();
        let configuration = &self.simulation.state.configuration;
        let summary = Summary {
            stamp: self.stamp(),
            n: configuration.n(),
            informed: configuration.weight.iter().filter(|w| **w > 0.0).count(),
            order: self.simulation.order().order,
            rate: self.rate,
            real_time_factor: self.real_time_factor(),
            is_behind: self.is_behind(),
            is_replay: false,
            is_protected: self.is_protected,
            earlier_models: self.earlier_models.clone(),
        };
        *self.summary.lock() = Some(summary);
        let is_measured = !self.simulation.measures.is_empty();
        self.metrics
            .set_measured(is_measured.then(|| self.frame(false)));
    }
}

/// Whether a command adds, executes or removes the condition with an event.
fn concerns(entry: &Entry, event: &str) -> bool {
    match entry.sender.verb {
        "reset" => true,
        "when" | "fired" => serde_json::from_str::<Value>(&entry.sender.args)
            .is_ok_and(|args| args["event"] == event || is_cancel_of_all(&args)),
        _ => false,
    }
}

fn is_cancel_of_all(args: &Value) -> bool {
    args["cancel"] == true && args["event"].is_null() && args["id"].is_null()
}
