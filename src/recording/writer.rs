//! The writer of a recording: takes states and events from the queue and writes them in parts.

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use fail::fail_point;
use jostle_results::recording::{About, Frame, Moment, Recorder, RecordingError, Written};

use super::queue::{End, FrameQueue, Next};
use crate::convert::{self, Payload, WordRefusal};
use crate::swarm::frame::{self, Event};

/// The maximum duration of a part: at most as much is lost by a crash.
const PART_DURATION: Duration = Duration::from_secs(60);

/// The growth of a recording between two checks of the quota.
const QUOTA_CHECK_BYTES: u64 = 1024 * 1024;

/// Writes a recording.
pub struct RecordingWriter {
    /// The swarm's name.
    pub swarm: String,
    /// Converts the error of a rejected command.
    pub word: WordRefusal,
    /// The source.
    pub queue: Arc<FrameQueue>,
    /// The destination.
    pub recorder: Recorder,
    /// The size at which the recording ends.
    pub max_bytes: Option<u64>,
}

impl RecordingWriter {
    /// Writes until the queue is closed and empty, or a limit is reached. Calls `ended_part` after
    /// each part, and `over_quota` as the recording grows. Finishes the last part after an error as
    /// well.
    pub fn write(
        mut self,
        ended_part: impl FnMut(Written, u64),
        over_quota: impl Fn() -> Option<End>,
    ) -> (Result<End, RecordingError>, Written) {
        let end = self.write_parts(ended_part, over_quota);
        // The swarm does not wait for the end of the last part.
        self.queue.end(*end.as_ref().unwrap_or(&End::Stopped));
        let before = self.recorder.written();
        match self.recorder.finish(&closing(&self.queue)) {
            Ok(written) => (end, written),
            // The first error is the reason.
            Err(error) => (end.and(Err(error)), before),
        }
    }

    fn write_parts(
        &mut self,
        mut ended_part: impl FnMut(Written, u64),
        over_quota: impl Fn() -> Option<End>,
    ) -> Result<End, RecordingError> {
        let (mut due, mut checked) = (None, 0);
        loop {
            let whole = self.recorder.written().parts;
            match self.queue.next(due) {
                Next::Frame(frame, taken) => self.frame(&frame, taken)?,
                Next::Event(event, taken) => self.event(*event, taken)?,
                Next::Timeout => {}
                Next::End(end) => return Ok(end),
            }
            let now = Instant::now();
            let due_at = *due.get_or_insert_with(|| now + part_duration());
            if now >= due_at {
                self.recorder.end_part(&closing(&self.queue))?;
            }
            let (written, size) = (self.recorder.written(), self.recorder.size());
            self.queue.set_progress(self.recorder.progress(), size);
            if let Some(max_bytes) = self.max_bytes.filter(|it| size >= *it) {
                return Ok(End::Full { max_bytes });
            }
            if size >= checked + QUOTA_CHECK_BYTES {
                checked = size;
                if let Some(end) = over_quota() {
                    return Ok(end);
                }
            }
            if written.parts > whole || now >= due_at {
                due = None;
            }
            if written.parts > whole {
                ended_part(written, self.queue.progress().1);
            }
        }
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
        let event = Payload::json(&convert::event(&self.swarm, event, self.word));
        self.recorder.event(&moment, &event.bytes)
    }
}

/// The metadata at the end of a part.
fn closing(queue: &FrameQueue) -> About {
    let (_, missed) = queue.progress();
    About::from([("missed".to_owned(), missed.to_string())])
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

    /// `recording::killed_in_the_midst` uses shorter parts and checks that a crash loses only the
    /// unfinished one.
    #[test]
    fn a_part_is_ended_after_a_minute() {
        assert_eq!(super::part_duration(), Duration::from_secs(60));
    }
}
