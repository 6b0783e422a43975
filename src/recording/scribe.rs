//! Writes a recording: what comes from a swarm, part by part, until it is enough.

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use fail::fail_point;
use jostle_results::recording::{About, Format, Frame, Moment, Recorder, RecordingError, Written};

use super::intake::{End, Intake, Next};
use crate::convert::{self, Payload, WordRefusal};
use crate::swarm::frame::{self, Event};

/// How long a part may be in the making: as much is lost by a crash.
const PART: Duration = Duration::from_secs(60);

/// How much a recording grows until the quota is looked at again.
const BETWEEN_QUOTA_CHECKS: u64 = 1024 * 1024;

/// What writes a recording.
pub struct Scribe {
    /// The swarm's name.
    pub swarm: String,
    /// How it is written.
    pub format: Format,
    /// Words why an order was refused.
    pub word: WordRefusal,
    /// Where it comes from.
    pub intake: Arc<Intake>,
    /// Where it goes.
    pub recorder: Recorder,
    /// The bytes from which on it ends.
    pub max_bytes: Option<u64>,
    /// Why the quota of all recordings ends it.
    pub over_quota: Box<dyn Fn() -> Option<End> + Send>,
}

impl Scribe {
    /// Writes until nothing more comes, and calls `ended_part` after each part; what came of it,
    /// and how much there is. What was taken is kept, whatever went wrong.
    pub fn write(
        mut self,
        mut ended_part: impl FnMut(Written, u64),
    ) -> (Result<End, RecordingError>, Written) {
        let followed = self.follow(&mut ended_part);
        // The swarm steps on while the last part is ended.
        self.intake.end(*followed.as_ref().unwrap_or(&End::Stopped));
        let before = self.recorder.written();
        match self.recorder.finish(&closing(&self.intake)) {
            Ok(written) => (followed, written),
            // What went wrong first is the reason.
            Err(error) => (followed.and(Err(error)), before),
        }
    }

    fn follow(&mut self, ended_part: &mut impl FnMut(Written, u64)) -> Result<End, RecordingError> {
        let (mut due, mut checked) = (None, 0);
        loop {
            let whole = self.recorder.written().parts;
            match self.intake.next(due) {
                Next::Frame(frame, taken) => self.frame(&frame, taken)?,
                Next::Event(event, taken) => self.event(*event, taken)?,
                Next::Nothing => {}
                Next::End(end) => return Ok(end),
            }
            let now = Instant::now();
            let due_at = *due.get_or_insert_with(|| now + part());
            if now >= due_at {
                self.recorder.end_part(&closing(&self.intake))?;
            }
            let (written, size) = (self.recorder.written(), self.recorder.size());
            self.intake.note(self.recorder.progress(), size);
            if let Some(max_bytes) = self.max_bytes.filter(|it| size >= *it) {
                return Ok(End::Full { max_bytes });
            }
            if size >= checked + BETWEEN_QUOTA_CHECKS {
                checked = size;
                if let Some(end) = (self.over_quota)() {
                    return Ok(end);
                }
            }
            if written.parts > whole || now >= due_at {
                due = None;
            }
            if written.parts > whole {
                ended_part(written, self.intake.progress().1);
            }
        }
    }

    fn frame(&mut self, frame: &frame::Frame, taken: SystemTime) -> Result<(), RecordingError> {
        fail_point!("recording-frame");
        // It need not have been published: states are numbered within the recording.
        let number = self.recorder.written().frames + 1;
        let state = convert::state(&self.swarm, frame, number);
        let moment = Moment {
            epoch: state.epoch,
            number,
            time: state.time,
            taken,
        };
        let published = match self.format {
            Format::Mcap => state.to_cbor(),
            Format::Parquet => Vec::new(),
        };
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
        if self.format == Format::Parquet {
            return Ok(());
        }
        let order = Payload::json(&convert::order_sample(&self.swarm, frame, number));
        self.recorder.order(&moment, &order.bytes)
    }

    fn event(&mut self, event: Event, taken: SystemTime) -> Result<(), RecordingError> {
        let moment = Moment {
            epoch: event.place.epoch,
            number: event.number,
            time: event.place.time,
            taken,
        };
        let event = Payload::json(&convert::event(&self.swarm, event, self.word));
        self.recorder.event(&moment, &event.bytes)
    }
}

/// What a part says at its end.
fn closing(intake: &Intake) -> About {
    let (_, missed) = intake.progress();
    About::from([("missed".to_owned(), missed.to_string())])
}

/// How long a part may be in the making; tests have it shorter.
fn part() -> Duration {
    fail_point!("recording-part", |millis| {
        let millis = millis.and_then(|it| it.parse().ok());
        Duration::from_millis(millis.unwrap_or_default())
    });
    PART
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    /// `recording::killed_in_the_midst` uses shorter parts and checks that a crash loses only the
    /// unfinished one.
    #[test]
    fn a_part_is_ended_after_a_minute() {
        assert_eq!(super::part(), Duration::from_secs(60));
    }
}
