//! The replay of a journal: a fold of its lines over a checkpoint. Recovery, verify and fork call it,
//! and differ in where it begins and ends ([`ReplayTarget`]).
//!
//! `Fold::read` reads each line once and in order. Lines with outcomes and hashes change nothing: the
//! journal of the worker notes them. The other lines record a command, a fault or a restart.
//! `Fold::apply` steps to the place of such a line and applies it, by the code that a running swarm
//! uses. Commands that are executed on the way there were journaled before that line, so their outcomes
//! and the hashes have been noted. Only the outcome of a command that is executed at once follows its
//! own line, so that line waits until the outcome has been read: a command that was rejected for a
//! reason that a replay cannot reproduce must not be applied.
//!
//! Outcomes and hashes may follow the last such line. Recovery does not step to them: the swarm takes
//! those steps again, in its next epoch.

use std::collections::VecDeque;
use std::ops::ControlFlow::{self, Break, Continue};
use std::sync::Arc;
use std::time::Duration;

use jostle_physics::simulation::ReserveMemory;

use crate::failpoint;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::command::{Command, When};
use crate::swarm::frame::EventKind;
use crate::swarm::handle::{CommandMessage, Handle, ReplyTo};
use crate::swarm::history::Entry;
use crate::swarm::journal::{GoesOn, JournalWriter, Line, NoWriter, OnProgress, Record, Replayed};
use crate::swarm::phase::{Phase, PhaseError};
use crate::swarm::schedule::Scheduled;
use crate::swarm::sender::Sender;
use crate::swarm::worker::{End, Worker};

/// A replay does not reproduce all events that were published between the checkpoint and the crash.
/// Event numbers therefore skip to the next multiple of this, so that no number is reused.
const EVENT_NUMBER_BLOCK: u64 = 1 << 20;

/// Maximum number of lines that wait for an outcome. A batch of commands is shorter, so an outcome that
/// does not follow by then was not written, because of a full disk or a crash.
const MAX_WAITING: usize = 1024;

/// Makes the callback that receives the reply to a replayed command.
pub type ReplyFor = Box<dyn Fn(&Arc<Sender>) -> ReplyTo + Send>;

pub type ReplayEntry = (Line, Option<Command>);

/// A checkpoint and the journal to replay from it.
pub struct ReplaySource {
    pub checkpoint: Checkpoint,
    /// The lines after the checkpoint, in order, or why they end.
    pub lines: Box<dyn Iterator<Item = Result<ReplayEntry, String>> + Send>,
    /// Commands that were applied before the checkpoint, for the history.
    pub entries: Vec<Entry>,
    /// Makes the receivers of the replies, some of which were not sent before the crash.
    pub reply_for: ReplyFor,
    pub to: ReplayTarget,
    /// Called with each line that is reached.
    pub on_progress: Option<OnProgress>,
    /// Called before each step.
    pub goes_on: Option<GoesOn>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplayTarget {
    /// Where the last command was executed; steps that it began are pending.
    LastInput,
    LastHash,
    /// At this epoch and step, after the commands that were executed there.
    At(u64, u64),
    /// On reaching this step after this line, before the commands that were executed there.
    Step(u64, u64),
}

impl ReplaySource {
    /// Replays it outside the registry, for verification and forks. Returns the final state and what
    /// the replay found.
    pub fn replay(self) -> (Checkpoint, Replayed) {
        let handle = Handle::alone(self.checkpoint.simulation.spec.clone());
        let (worker, replayed, _) = self.fold(&handle, Duration::ZERO, Arc::new(NoWriter));
        (worker.checkpoint(), replayed)
    }

    /// Replays it. Returns the end of the swarm too, if the journal contains it.
    pub fn fold(
        self,
        handle: &Handle,
        min_frame_interval: Duration,
        writer: Arc<dyn JournalWriter>,
    ) -> (Worker, Replayed, Option<End>) {
        for entry in self.entries {
            handle.history.record_command(entry);
        }
        let (first, is_last) = (self.checkpoint.lines, self.checkpoint.is_last);
        // The swarm fitted before.
        let reserve: ReserveMemory = Box::new(|_| Ok(()));
        let writer = (writer, reserve);
        let (checkpoint, reply_for) = (self.checkpoint, &self.reply_for);
        let mut worker = Worker::restore(checkpoint, handle, min_frame_interval, writer, reply_for);
        worker.publish_created(handle.record.creation.clone());
        let is_taken_over = worker.taken_over.is_some();
        let journal = &mut worker.journal;
        journal.begin_replay(self.on_progress, self.goes_on, is_taken_over);
        let mut fold = Fold {
            worker,
            reply_for: self.reply_for,
            to: self.to,
            waiting: VecDeque::new(),
        };
        let (mut last, mut problem) = (first, None);
        let mut lines = self
            .lines
            .map_while(|line| line.map_err(|it| problem = Some(it)).ok());
        let mut stop = lines.try_for_each(|entry| {
            failpoint::kill("swarm-replayed");
            if fold.worker.journal.is_cancelled() {
                return Break(None);
            }
            last = entry.0.number;
            fold.read(entry)
        });
        drop(lines);
        if stop.is_continue() {
            stop = fold.apply_waiting(0);
        }
        let mut worker = fold.worker;
        if let Some(problem) = &problem {
            worker.fault(problem.clone());
        }
        let end = match (stop, fold.to, worker.journal.last_hash()) {
            (Break(Some(end)), ..) => Some(end),
            // The journal on disk may end before the target: the caller checks the step reached.
            (_, ReplayTarget::Step(step, _), _) => worker.step_on(worker.at().0, step),
            (_, ReplayTarget::At(epoch, step), _) => worker.step_on(epoch, step),
            (_, ReplayTarget::LastHash, Some((epoch, step))) if worker.at() < (epoch, step) => {
                worker.advance(epoch, step)
            }
            _ => None,
        };
        let reached = match worker.phase {
            Phase::Stepping { until } => until,
            _ => worker.simulation.state.step,
        };
        let mut replayed = worker.journal.resume(last, reached);
        replayed.problem = problem;
        if !is_last || last > first {
            worker.skip_event_numbers();
        }
        (worker, replayed, end)
    }
}

struct Fold {
    worker: Worker,
    reply_for: ReplyFor,
    to: ReplayTarget,
    /// Lines that have been read and not applied.
    waiting: VecDeque<ReplayEntry>,
}

impl Fold {
    /// Reads the next line, and applies those whose outcomes have been read. Breaks at the target, or
    /// with the end of the swarm.
    fn read(&mut self, entry: ReplayEntry) -> ControlFlow<Option<End>> {
        if self.read_fired(&entry) {
            // Other conditions may hold at the same step: their lines are next.
            self.waiting.push_back(entry);
            return Continue(());
        }
        if !self.worker.journal.read_ahead(&entry.0) {
            self.waiting.push_back(entry);
        }
        self.apply_waiting(MAX_WAITING)
    }

    /// Notes a command `fired`, which the step that reaches its place executes. Returns whether it is one.
    fn read_fired(&mut self, (line, command): &ReplayEntry) -> bool {
        let (Record::Input { sender, .. }, Some(command @ Command::Fired(_))) =
            (&line.record, command)
        else {
            return false;
        };
        let fired = Scheduled {
            input: line.number,
            command: command.clone(),
            sender: sender.clone(),
        };
        let at = (line.epoch, line.step);
        self.worker.journal.read_fired(at, fired);
        true
    }

    /// Applies lines, until one waits for its outcome and no more than `limit` do.
    fn apply_waiting(&mut self, limit: usize) -> ControlFlow<Option<End>> {
        while let Some(entry) = self.waiting.pop_front() {
            let at = (entry.0.epoch, entry.0.step);
            let waits = match entry.0.record {
                _ if matches!(entry.1, Some(Command::Fired(_))) => {
                    !self.worker.journal.has_outcomes_of_fired(at)
                }
                // One that is scheduled has no outcome yet, and one with a `seq` was executed before it
                // was written.
                Record::Input { at_step, seq, .. } => at_step.is_none() && seq.is_none(),
                _ => false,
            };
            let has_outcome = || self.worker.journal.outcome(entry.0.number).is_some();
            let is_fired = matches!(entry.1, Some(Command::Fired(_)));
            if waits && self.waiting.len() < limit && (is_fired || !has_outcome()) {
                self.waiting.push_front(entry);
                break;
            }
            self.apply(entry)?;
        }
        Continue(())
    }

    /// Steps to the place of a line and applies it.
    fn apply(&mut self, (line, command): ReplayEntry) -> ControlFlow<Option<End>> {
        let is_beyond = |step, after| line.number > after && line.step >= step;
        if matches!(self.to, ReplayTarget::Step(step, after) if is_beyond(step, after)) {
            return Break(None);
        }
        let worker = &mut self.worker;
        worker.journal.report(line.number);
        if let Some(end) = worker.advance(line.epoch, line.step) {
            return Break(Some(end));
        }
        let end = match (line.record, command) {
            // The step that has reached it has executed it.
            (_, Some(Command::Fired(_))) => None,
            (
                Record::Input {
                    at_step,
                    sender,
                    unix_secs,
                    ..
                },
                Some(command),
            ) if !worker.is_faulted() || command.is_allowed_when_faulted() => {
                let is_grouped = command.is_group_committed() && at_step.is_none();
                let input = if is_grouped { 0 } else { line.number };
                let applied_at = match (at_step, worker.journal.outcome(line.number)) {
                    (None, Some((_, Some(applied_at)))) => Some(applied_at),
                    _ => unix_secs,
                };
                let message = CommandMessage {
                    reply_to: (self.reply_for)(&sender),
                    command,
                    when: When::default(),
                    sender,
                    user: None,
                };
                worker.applied_at(applied_at, |it| it.command(input, at_step, message))
            }
            // The swarm has faulted, as it had not under the earlier version of the model.
            (
                Record::Input {
                    at_step,
                    sender,
                    seq,
                    ..
                },
                Some(_),
            ) if worker.taken_over.is_some() => {
                let outcome = worker.journal.outcome(line.number);
                let applied = seq.or_else(|| outcome.and_then(|(applied, _)| applied));
                if applied.is_some() || at_step.is_some() {
                    worker.report_refused(sender, applied, PhaseError::Faulted.into());
                }
                None
            }
            (Record::Resumed(epoch), _) => {
                worker.simulation.epoch = epoch;
                // The same event as at that restart.
                worker.skip_event_numbers();
                worker.push_event(EventKind::Phase);
                None
            }
            (Record::Fault(reason), _) if !worker.is_faulted() => {
                worker.fault(reason);
                None
            }
            _ => None,
        };
        end.map_or(Continue(()), |end| Break(Some(end)))
    }
}

impl Worker {
    fn skip_event_numbers(&mut self) {
        self.events = (self.events / EVENT_NUMBER_BLOCK + 1) * EVENT_NUMBER_BLOCK;
    }

    /// Steps until `step` of `epoch`, or until the swarm stops moving.
    fn step_on(&mut self, epoch: u64, step: u64) -> Option<End> {
        while self.phase.is_moving() && self.at() < (epoch, step) && self.journal.goes_on() {
            if let Some(end) = self.step() {
                return Some(end);
            }
        }
        None
    }

    /// Steps until `step` of `epoch`, which the journal has reached; faults if it cannot be reached.
    fn advance(&mut self, epoch: u64, step: u64) -> Option<End> {
        if let Some(end) = self.step_on(epoch, step) {
            return Some(end);
        }
        if self.at() != (epoch, step) && !self.is_faulted() && !self.journal.is_cancelled() {
            let (epoch_now, step_now) = self.at();
            self.fault(format!(
                "the journal continues at step {step} of epoch {epoch}, which cannot be reached from \
                 step {step_now} of epoch {epoch_now}"
            ));
        }
        None
    }
}
