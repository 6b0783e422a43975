//! Recovers a swarm from a checkpoint by replaying its journal.

use std::sync::Arc;
use std::time::{Duration, Instant};

use jostle_physics::simulation::{ReserveMemory, Simulation};

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::command::{Command, When};
use crate::swarm::controllers::Controllers;
use crate::swarm::error::WriteFault;
use crate::swarm::failpoint;
use crate::swarm::frame::{EventKind, Stamp};
use crate::swarm::handle::{CommandMessage, Handle};
use crate::swarm::history::Entry;
use crate::swarm::journal::{Journal, JournalWriter, NoWriter, Record};
use crate::swarm::outcome::ReplyTo;
use crate::swarm::pace::Pace;
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::sender::Sender;
use crate::swarm::worker::journal_index::{JournalIndex, ReplayEntry, ReplayState};
use crate::swarm::worker::{End, Pending, Worker};

/// A replay does not reproduce all events that were published between the checkpoint and the crash.
/// Event numbers therefore skip to the next multiple of this, so that no number is reused.
const EVENT_NUMBER_BLOCK: u64 = 1 << 20;

/// Niceness of a thread that only replays: lower priority than the hosted swarms.
const REPLAY_NICENESS: i32 = 15;

/// Makes the callback that receives the reply to a replayed command.
pub type ReplyFor = Box<dyn Fn(&Arc<Sender>) -> ReplyTo + Send>;

/// A checkpoint and the journal to replay from it.
pub struct ReplaySource {
    /// The first state.
    pub checkpoint: Checkpoint,
    /// The lines after the checkpoint, in order, read during the replay; or why they end.
    pub lines: Box<dyn Iterator<Item = Result<ReplayEntry, String>> + Send>,
    /// The index of all those lines.
    pub index: JournalIndex,
    /// Why the lines after these cannot be replayed, if there are such.
    pub damage: Option<String>,
    /// Commands that were applied before the checkpoint, for the history.
    pub entries: Vec<Applied>,
    /// Receives the replies, some of which the client did not get before the crash.
    pub reply_for: ReplyFor,
    /// Where the replay ends.
    pub to: ReplayTarget,
}

impl ReplaySource {
    /// Replays it outside the registry, for verification and copies. Returns the final state and
    /// what the replay found.
    pub fn replay(self) -> (Checkpoint, ReplayState) {
        let _ = rustix::process::setpriority_process(None, REPLAY_NICENESS);
        let handle = Handle::alone(self.checkpoint.simulation.spec.clone());
        let always: ReserveMemory = Box::new(|_| Ok(()));
        let (worker, _) =
            Worker::from_journal(self, &handle, Duration::ZERO, (Arc::new(NoWriter), always));
        (worker.checkpoint(), worker.into_replay())
    }
}

/// A command that was applied.
pub struct Applied {
    /// The epoch.
    pub epoch: u64,
    /// The step.
    pub step: u64,
    /// Its number among the applied commands.
    pub seq: u64,
    /// The wall-clock time, in seconds since 1970, if known.
    pub unix_secs: Option<f64>,
    /// The command and who sent it.
    pub sender: Arc<Sender>,
}

/// Where a replay ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplayTarget {
    /// Where the last command was executed; steps that it began are pending.
    LastInput,
    /// At the last hash.
    LastHash,
    /// At this epoch and step, after the commands that were executed there.
    At(u64, u64),
    /// On reaching this step of the last run, before the commands that were executed there.
    Step(u64),
}

impl Worker {
    /// Recovers a worker from a checkpoint and its journal.
    ///
    /// `reserve` grants memory during the replay: the swarm fitted before. Returns the end of the swarm
    /// too, if the journal contains it.
    pub fn from_journal(
        source: ReplaySource,
        handle: &Handle,
        min_frame_interval: Duration,
        (writer, reserve): (Arc<dyn JournalWriter>, ReserveMemory),
    ) -> (Self, Option<End>) {
        let ReplaySource {
            checkpoint,
            lines,
            index,
            damage,
            entries,
            reply_for,
            to,
        } = source;
        for entry in entries {
            handle.history.record_command(Entry {
                stamp: Stamp {
                    epoch: entry.epoch,
                    step: entry.step,
                    time: entry.step as f64 * checkpoint.simulation.state.parameters.dt,
                    phase: Phase::Paused(PauseReason::Requested),
                    seq: entry.seq,
                },
                unix_secs: entry.unix_secs,
                sender: entry.sender,
            });
        }
        let is_last = checkpoint.is_last && index.last().is_none();
        let pending = checkpoint.pending.clone();
        let joined = checkpoint.controllers.clone();
        let mut worker = Worker::restore(checkpoint, handle, min_frame_interval, (writer, reserve));
        // The time of its creation is not stored.
        worker.applied_at(None, Worker::publish_created);
        worker.journal.replay();
        worker.pending = pending.map(|(from, sender)| Pending {
            reply_to: reply_for(&sender),
            from,
            sender,
        });
        worker.controllers = Controllers::restore(joined, &reply_for);
        let end = worker.replay_lines(lines, index, damage, &reply_for, to);
        if !is_last {
            worker.skip_event_numbers();
        }
        (worker, end)
    }

    /// Skips to event numbers that have not been used.
    fn skip_event_numbers(&mut self) {
        self.events = (self.events / EVENT_NUMBER_BLOCK + 1) * EVENT_NUMBER_BLOCK;
    }

    /// A worker of a new swarm that starts from a checkpoint.
    pub fn from_checkpoint(
        checkpoint: Checkpoint,
        handle: &Handle,
        min_frame_interval: Duration,
        (writer, reserve): (Arc<dyn JournalWriter>, ReserveMemory),
    ) -> Self {
        let mut worker = Worker::restore(checkpoint, handle, min_frame_interval, (writer, reserve));
        worker.publish_created();
        worker
    }

    fn publish_created(&mut self) {
        if self.events == 0 {
            self.push_event(EventKind::Created);
        }
        self.update_summary();
    }

    fn restore(
        checkpoint: Checkpoint,
        handle: &Handle,
        min_frame_interval: Duration,
        (writer, reserve): (Arc<dyn JournalWriter>, ReserveMemory),
    ) -> Self {
        let simulation = Simulation::from_checkpoint(&checkpoint.simulation, reserve);
        let mut worker = Worker::with_journal(
            simulation,
            handle,
            min_frame_interval,
            Journal::new(writer, checkpoint.lines, checkpoint.simulation.state.step),
        );
        worker.phase = checkpoint.phase;
        worker.rate = checkpoint.rate;
        worker.events = checkpoint.events;
        for (at_step, scheduled) in checkpoint.scheduled {
            // They were within the limits when they were scheduled.
            let _ = worker.schedule.add(at_step, scheduled);
        }
        worker.reset_pace();
        worker
    }

    /// Begins a new epoch after a replay, and journals it.
    ///
    /// # Errors
    ///
    /// [`WriteFault`]: the line is queued instead, and the swarm continues.
    pub fn resume(&mut self, reserve: ReserveMemory) -> Result<(), WriteFault> {
        self.simulation.set_reserve(reserve);
        let (before, epoch) = (self.at(), self.simulation.epoch + 1);
        self.simulation.epoch = epoch;
        self.reset_pace();
        let written = self.journal.commit(before, vec![Record::Resumed(epoch)]);
        failpoint::kill("swarm-resumed");
        if written.is_err() {
            // The later lines belong to this epoch, so this line is queued before them.
            self.journal.append(before, Record::Resumed(epoch), None);
        }
        self.push_event(EventKind::Phase);
        self.save_checkpoint();
        self.update_summary();
        self.update_lockstep();
        written.map(drop)
    }

    fn reset_pace(&mut self) {
        let rate = match self.phase {
            Phase::Stepping { .. } => None,
            _ => self.rate,
        };
        let dt = self.simulation.state.parameters.dt;
        self.pace = Pace::new(rate, dt, Instant::now());
    }

    fn replay_lines(
        &mut self,
        lines: impl Iterator<Item = Result<ReplayEntry, String>>,
        index: JournalIndex,
        damage: Option<String>,
        reply_for: &dyn Fn(&Arc<Sender>) -> ReplyTo,
        to: ReplayTarget,
    ) -> Option<End> {
        self.journal
            .set_settled(index.settled.keys().copied().collect());
        let applied = index.settled.into_iter();
        self.replay.unix_secs = applied
            .filter_map(|(input, unix_secs)| Some((input, unix_secs?)))
            .collect();
        self.replay.rejected = index.rejected;
        self.replay.hashes = index.hashes;
        let mut last = self.journal.lines();
        let mut end = None;
        for line in lines {
            let (line, command) = match line {
                Ok(line) => line,
                Err(problem) => {
                    self.fault(problem.clone());
                    self.replay.aborted = Some(problem);
                    break;
                }
            };
            let is_of_last_run = line.number > index.last_reset;
            if matches!(to, ReplayTarget::Step(step) if is_of_last_run && line.step >= step) {
                break;
            }
            failpoint::kill("swarm-replayed");
            last = line.number;
            match (line.record, command) {
                (
                    Record::Input {
                        at_step,
                        sender,
                        unix_secs,
                        ..
                    },
                    Some(command),
                ) => {
                    end = self.advance(line.epoch, line.step);
                    if end.is_some()
                        || matches!(self.phase, Phase::Faulted(_))
                            && !is_allowed_after_fault(&command)
                    {
                        continue;
                    }
                    let input = match command {
                        ref command if command.is_group_committed() && at_step.is_none() => 0,
                        _ => line.number,
                    };
                    let command = CommandMessage {
                        reply_to: reply_for(&sender),
                        command,
                        when: When::default(),
                        sender,
                    };
                    let applied_at = match at_step {
                        Some(_) => unix_secs,
                        None => self.replay.unix_secs_of(line.number).or(unix_secs),
                    };
                    end = self.applied_at(applied_at, |it| it.command(input, at_step, command));
                }
                (Record::Resumed(epoch), _) => {
                    end = self.advance(line.epoch, line.step);
                    self.simulation.epoch = epoch;
                    // The same event as at that restart.
                    self.skip_event_numbers();
                    self.push_event(EventKind::Phase);
                }
                (Record::Fault(reason), _) if !matches!(self.phase, Phase::Faulted(_)) => {
                    end = self.advance(line.epoch, line.step);
                    if !matches!(self.phase, Phase::Faulted(_)) {
                        self.fault(reason);
                    }
                }
                _ => {}
            }
            if end.is_some() {
                break;
            }
        }
        match (to, index.last_hash) {
            // The journal on disk may end before the target: the caller checks the step reached.
            (ReplayTarget::Step(step), _) if end.is_none() => end = self.step_on(self.at().0, step),
            (ReplayTarget::At(epoch, step), _) if end.is_none() => end = self.step_on(epoch, step),
            (ReplayTarget::LastHash, Some((epoch, step)))
                if end.is_none() && self.at() < (epoch, step) =>
            {
                end = self.advance(epoch, step);
            }
            _ => {}
        }
        self.replay.clear();
        if let Some(damage) = damage {
            self.fault(damage);
        }
        let reached = match self.phase {
            Phase::Stepping { until } => until,
            _ => self.simulation.state.step,
        };
        self.journal.resume(last, reached);
        end
    }

    /// Steps until `step` of `epoch`, or until the swarm stops moving.
    fn step_on(&mut self, epoch: u64, step: u64) -> Option<End> {
        while self.phase.is_moving() && self.at() < (epoch, step) {
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
        if self.at() != (epoch, step) && !matches!(self.phase, Phase::Faulted(_)) {
            let (epoch_now, step_now) = self.at();
            self.fault(format!(
                "the journal continues at step {step} of epoch {epoch}, which cannot be reached from \
                 step {step_now} of epoch {epoch_now}"
            ));
        }
        None
    }
}

/// Whether a faulted swarm accepts a command.
fn is_allowed_after_fault(command: &Command) -> bool {
    matches!(command, Command::Reset(_) | Command::Delete)
}
