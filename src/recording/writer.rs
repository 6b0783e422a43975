//! The writer of a recording: takes states and events from the queue and writes them in parts.

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use fail::fail_point;
use jostle_results::recording::{About, Frame, Moment, Recorder, RecordingError, Written};

use super::gaps::CountedTo;
use super::source::Source;
use super::status::Status;
use crate::convert::{self, Payload};
use crate::swarm::frame::{self, Event};
use crate::swarm::output::{End, Item, Passed, Subscription};

/// The maximum duration of a part: at most as much is lost by a crash.
const PART_DURATION: Duration = Duration::from_secs(60);

pub struct RecordingWriter {
    swarm: String,
    subscription: Arc<Subscription>,
    recorder: Recorder,
    /// What was counted before the first state of the subscription.
    counted: CountedTo,
    /// The states that were missed before it.
    missed: u64,
    /// What the subscription had passed when it enqueued the last written state.
    passed: Passed,
}

impl RecordingWriter {
    /// A writer of the states that a source has received since the recording had this status.
    pub fn new(recorder: Recorder, source: &Source, status: &Status) -> Self {
        let at = source.began_at();
        RecordingWriter {
            swarm: status.swarm.clone(),
            subscription: source.subscription.clone(),
            recorder,
            counted: CountedTo {
                at,
                steps_left: status.steps_left,
                lost: status.lost,
            },
            missed: status.missed,
            passed: Passed {
                at: (at.epoch, at.step),
                ..Passed::default()
            },
        }
    }

    /// Writes until the subscription has ended and its queue is empty, or a limit is reached. After
    /// each item it calls `progress` with whether a part has ended; a reason that `progress` returns ends
    /// the recording. The last part is finished after an error as well. Returns the reason, or `None`
    /// if the recording resumes.
    pub fn write(
        mut self,
        progress: impl FnMut(&Recorder, bool) -> Option<String>,
    ) -> (Result<Option<String>, RecordingError>, Written) {
        let end = self.write_parts(progress);
        // The swarm does not wait for the end of the last part.
        self.subscription.end(None);
        self.passed = self.subscription.passed();
        let (before, closing) = (self.recorder.written(), self.closing());
        match self.recorder.finish(&closing) {
            Ok(written) => (end, written),
            // The first error is the reason.
            Err(error) => (end.and(Err(error)), before),
        }
    }

    fn write_parts(
        &mut self,
        mut progress: impl FnMut(&Recorder, bool) -> Option<String>,
    ) -> Result<Option<String>, RecordingError> {
        let mut due = None;
        loop {
            let parts = self.recorder.written().parts;
            match self.subscription.next(due) {
                // The swarm took more steps than it should record, before it was known how many.
                Ok(Some(Item::Frame(_, _, passed))) if self.is_beyond(passed) => {}
                Ok(Some(Item::Frame(frame, taken, passed))) => {
                    self.frame(&frame, taken)?;
                    self.passed = passed;
                }
                Ok(Some(Item::Event(event, taken))) => self.event(*event, taken)?,
                Ok(None) => {}
                Err(End::Closed(reason)) => return Ok(reason),
                Err(End::Deleted) => return Ok(Some("its swarm was deleted".to_owned())),
                Err(End::Complete) => return Ok(Some("all its steps are recorded".to_owned())),
            }
            let now = Instant::now();
            let is_due = now >= *due.get_or_insert_with(|| now + part_duration());
            if is_due || self.recorder.is_part_full() {
                self.recorder.end_part(&self.closing())?;
            }
            let has_ended = self.recorder.written().parts > parts;
            if has_ended || is_due {
                due = None;
            }
            if let Some(reason) = progress(&self.recorder, has_ended) {
                return Ok(Some(reason));
            }
        }
    }

    fn is_beyond(&self, passed: Passed) -> bool {
        let left = self.counted.steps_left;
        left.is_some_and(|left| passed.steps > left)
    }

    /// The metadata that only the end of a part knows: what follows its last state is not counted, since
    /// it is lost if the daemon crashes.
    fn closing(&self) -> About {
        let Passed { at, dropped, steps } = self.passed;
        let left = self.counted.steps_left;
        let counted = CountedTo {
            at: at.into(),
            steps_left: left.map(|left| left.saturating_sub(steps)),
            ..self.counted
        };
        counted.describe(self.missed + dropped)
    }

    fn frame(&mut self, frame: &frame::Frame, taken: SystemTime) -> Result<(), RecordingError> {
        fail_point!("recording-frame");
        // States are numbered within the recording, since not all of them are published.
        let number = self.recorder.written().frames + 1;
        let state = convert::state(&self.swarm, frame, number);
        let moment = Moment {
            epoch: state.epoch,
            number,
            time: state.time,
            taken,
        };
        let published = state.to_cbor();
        // It is recorded, whether or not it is published.
        let attachment = convert::attachment(frame, None).to_cbor();
        self.recorder.frame(&Frame {
            swarm: &state.swarm,
            moment,
            phase: state.phase.name(),
            step: state.step,
            origin: state.origin,
            id: &state.id,
            x: &state.x,
            y: &state.y,
            alpha: &state.alpha,
            weight: &state.weight,
            direction: &state.direction,
            order: state.order.order,
            drift: state.order.drift,
            worst_gap: state.certificate.worst_gap,
            residual: state.certificate.residual,
            contacts: state.certificate.contacts,
            published: &published,
            attachment: Some(&attachment),
        })?;
        let order = Payload::json(&convert::order_sample(&self.swarm, frame, number));
        self.recorder.order(&moment, &order.bytes)
    }

    fn event(&mut self, event: Event, taken: SystemTime) -> Result<(), RecordingError> {
        let moment = Moment {
            epoch: event.stamp.epoch,
            number: event.number,
            time: event.stamp.time,
            taken,
        };
        let event = Payload::json(&convert::event(&self.swarm, event));
        self.recorder.event(&moment, &event.bytes)
    }
}

/// The maximum duration of a part; tests shorten it.
fn part_duration() -> Duration {
    fail_point!("recording-part", |millis| {
        let millis = millis.and_then(|it| it.parse().ok());
        Duration::from_millis(millis.unwrap_or_default())
    });
    PART_DURATION
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    /// `recording::a_recording_resumes` uses shorter parts and checks that a crash loses only the
    /// unfinished one.
    #[test]
    fn a_part_is_ended_after_a_minute() {
        assert_eq!(super::part_duration(), Duration::from_secs(60));
    }
}
