//! One step of a swarm, and what follows it: hashes, faults and checkpoints.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant, SystemTime};

use fail::fail_point;
use tracing::warn;

use crate::failpoint;
use crate::swarm::controllers::Input;
use crate::swarm::error::SwarmError;
use crate::swarm::fault::Fault;
use crate::swarm::frame::EventKind;
use crate::swarm::journal::Record;
use crate::swarm::phase::{PauseReason, Phase, PhaseInput};
use crate::swarm::scheduler::MAX_BACKLOG;
use crate::swarm::worker::{End, SinceCheckpoint, Worker};

/// How often the summary of a moving swarm is updated.
const SUMMARY_INTERVAL: Duration = Duration::from_millis(100);

/// Steps between two hashes in the journal.
const HASH_INTERVAL: u64 = 500;

impl Worker {
    /// Takes one step, and executes the commands that are scheduled for the step it reaches.
    pub(super) fn step(&mut self) -> Option<End> {
        self.apply_puts();
        self.watches.record(&self.simulation.state);
        self.waits.record(&self.simulation.state);
        let began = Instant::now();
        let late = self.pace.late_by(began);
        let simulation = &mut self.simulation;
        let stepped = catch_unwind(AssertUnwindSafe(|| {
            fail_point!("step");
            simulation.step()
        }));
        let now = Instant::now();
        match stepped {
            Ok(Ok(report)) => {
                self.pace.stepped(now);
                let took = now.saturating_duration_since(began);
                self.since_checkpoint.steps += 1;
                self.since_checkpoint.work += took;
                // Replayed steps were counted when they were first taken.
                if !self.journal.is_replaying() {
                    self.metrics.stepped(took, late, &report);
                    self.stepped = Some((self.at(), SystemTime::now()));
                }
                if !self.hash_step() {
                    return None;
                }
                if !report.lapsed.is_empty() {
                    self.push_event(EventKind::Lapsed(report.lapsed));
                }
            }
            Ok(Err(error)) => {
                self.fault(error.to_string());
                return None;
            }
            Err(_) => {
                self.fault("a defect: the step panicked".into());
                return None;
            }
        }
        let step = self.simulation.state.step;
        if self.phase.until().is_some_and(|until| step >= until) {
            if matches!(self.phase, Phase::Stepping { .. }) {
                self.phase = Phase::Paused(PauseReason::Finished);
            } else {
                self.apply_phase_input(PhaseInput::Reached(step));
            }
            self.record_state();
            self.push_frame();
            self.update_summary();
            if let Some(end) = self.execute_watches().or_else(|| self.execute_due()) {
                return Some(end);
            }
            // A scheduled `step` has replied to the pending one already.
            if !matches!(self.phase, Phase::Stepping { .. }) {
                self.reply_to_pending(&self.phase.clone());
            }
            self.notify_controllers(Input::Reached);
        } else {
            self.record_state();
            if step.is_multiple_of(self.simulation.publish_every) && now >= self.frame_due {
                // The next frame is due relative to the last due time, so that frames of a swarm that
                // catches up are published too.
                let grace = self.min_frame_interval.max(MAX_BACKLOG);
                let grace = now.checked_sub(grace).unwrap_or(now);
                self.frame_due = self.frame_due.max(grace) + self.min_frame_interval;
                self.push_frame();
            }
            if now.saturating_duration_since(self.summary_updated) >= SUMMARY_INTERVAL {
                self.update_summary();
            }
            if let Some(end) = self.execute_watches().or_else(|| self.execute_due()) {
                return Some(end);
            }
        }
        self.reply_to_waiters();
        self.sweep_waits(now);
        self.checkpoint_if_due(now);
        None
    }

    /// Journals the hash of every `HASH_INTERVAL`-th step. During a replay, compares it instead, and
    /// faults and returns false if it differs.
    fn hash_step(&mut self) -> bool {
        let at = self.at();
        if !at.1.is_multiple_of(HASH_INTERVAL) {
            return true;
        }
        let hash = self.simulation.state.hash();
        match self.journal.check_hash(at, hash) {
            Some(false) => {
                let step = at.1;
                self.fault(format!(
                    "replayed from the journal, step {step} has another hash than before: the journal \
                     or this build of the daemon is not the one that computed it"
                ));
                false
            }
            _ => {
                self.journal.append(at, Record::Hash(hash), None);
                true
            }
        }
    }

    /// Enters the phase `faulted`, which keeps the last good state.
    pub(super) fn fault(&mut self, reason: String) {
        // A replay outside the registry has no name, and its faults are not logged.
        if !self.output.name.is_empty() {
            warn!(swarm = self.output.name, reason, "faulted");
        }
        self.metrics.faulted();
        self.fault = Some(Fault::of(&self.simulation, &reason));
        self.phase = Phase::Faulted(reason.clone());
        let at = self.at();
        self.journal.append(at, Record::Fault(reason.clone()), None);
        self.push_event(EventKind::Fault(reason.clone()));
        self.push_frame();
        self.update_summary();
        let faulted = SwarmError::Faulted(reason);
        if let Some(pending) = self.pending.take() {
            self.reject(pending.reply_to, faulted.clone());
        }
        self.notify_controllers(Input::Faulted(faulted));
        self.reply_to_waiters();
        let waits = self.waits.take_all();
        self.end_waits(waits);
    }

    pub(super) fn checkpoint_if_due(&mut self, now: Instant) {
        if self.since_checkpoint.is_due(now) {
            self.save_checkpoint();
        }
    }

    pub(super) fn save_checkpoint(&mut self) {
        if !self.journal.is_replaying() {
            let checkpoint = self.checkpoint();
            self.journal.append_checkpoint(checkpoint);
            failpoint::kill("swarm-checkpointed");
            self.since_checkpoint = SinceCheckpoint::new();
        }
    }
}
