//! Resumes the recordings that were running when the daemon ended.
//!
//! A recovered swarm subscribes them before it continues. Their threads then open the files: until they
//! have, the states wait in the queues, and a swarm whose queue is full takes no step. A thread that cannot
//! write ends its subscription, which wakes the swarm.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use fail::fail_point;
use jostle_results::recording::{Recorder, RecordingError, sweep};
use tracing::info;

use super::source::Source;
use super::status::Position;
use super::{DEFECT, Origin, Phase, Recordings, Status, lost};
use crate::swarm::frame::Frame;
use crate::swarm::handle::Handle;

/// The reason of a recording whose swarm took all steps that it should record before a crash.
const OVER: &str = "its last steps were lost when the daemon ended";

impl Recordings {
    /// Subscribes the interrupted recordings of a recovered swarm, and starts their threads. Called on
    /// the thread of the swarm, before it continues and before clients can stop recordings. `resets` are
    /// the states at which the swarm was reset, oldest first.
    pub fn resume(&self, handle: &Handle, now: &Arc<Frame>, resets: &[Position]) {
        let swarm = &handle.output.name;
        let interrupted = self.interrupted().into_iter();
        for (name, status) in interrupted.filter(|(_, status)| status.swarm == *swarm) {
            let failed = status.clone();
            let resumed = catch_unwind(AssertUnwindSafe(|| {
                let source = Source::resume(handle, now, &status);
                let resets = resets.to_vec();
                self.start(&name, status, source, Origin::Interrupted { resets })
            }));
            let reason = match resumed {
                Ok(Ok(())) => continue,
                Ok(Err(error)) => error.to_string(),
                Err(_) => DEFECT.to_owned(),
            };
            self.finish(&name, failed, Phase::Failed, Some(reason));
        }
    }

    /// Ends the recordings that no swarm has resumed. `is_stored` is whether the store has a swarm of this
    /// name, which then could not be recovered.
    pub fn end_interrupted(&self, is_stored: impl Fn(&str) -> bool) {
        for (name, status) in self.interrupted() {
            let (phase, reason) = match is_stored(&status.swarm) {
                true => (
                    Phase::Failed,
                    "its swarm could not be recovered: the log of the daemon has the reason",
                ),
                false => (
                    Phase::Ended,
                    "its swarm did not exist when the daemon restarted",
                ),
            };
            self.finish(&name, status, phase, Some(reason.to_owned()));
        }
    }

    /// The recordings that were running when the daemon ended, and are to be resumed.
    fn interrupted(&self) -> Vec<(String, Status)> {
        let state = self.lock();
        let entries = state.entries.iter();
        let interrupted = entries.filter(|(_, it)| it.is_interrupted());
        interrupted
            .map(|(name, it)| (name.clone(), it.status.clone()))
            .collect()
    }

    /// Opens the files of an interrupted recording, and counts what it lacks. The error is the reason why
    /// it cannot be written, or is over.
    pub(super) fn reopen(
        &self,
        name: &str,
        source: &Source,
        resets: &[Position],
    ) -> Result<Result<(Recorder, Status), String>, RecordingError> {
        fail_point!("recording-resume");
        let folder = self.0.jobs.folder(name);
        let removed = sweep(&folder)?.len();
        let Some(mut status) = self.lock().entries.get(name).map(|it| it.status.clone()) else {
            return Ok(Err(OVER.to_owned()));
        };
        lost::complete(&folder, &status)?;
        status.every = Some(source.every);
        let is_over = status.count_lost(&folder, resets, source.began_at())?;
        let about = source.about(&status);
        let recorder = Recorder::resume(&folder, status.format, about)?;
        status.count(recorder.written());
        status.skipped = recorder.skipped();
        if let Some(entry) = self.lock().entries.get_mut(name) {
            entry.status = status.clone();
            entry.size = recorder.size();
        }
        if is_over {
            return Ok(Err(OVER.to_owned()));
        }
        if let Some(steps) = status.steps_left {
            source.subscription.limit_steps(steps);
        }
        let (part, missed) = (status.parts, status.missed);
        info!(
            recording = name,
            part, removed, missed, "resumed with a new part"
        );
        Ok(Ok((recorder, status)))
    }
}
