//! A swarm from a checkpoint, and its journal told again from there.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::command::{Command, When};
use crate::swarm::controllers::Controllers;
use crate::swarm::crash;
use crate::swarm::error::WriteFault;
use crate::swarm::frame::{EventKind, Place};
use crate::swarm::handle::{CommandMessage, Handle};
use crate::swarm::history::Entry;
use crate::swarm::journal::{Journal, JournalWriter, Line, NoWriter, Record};
use crate::swarm::outcome::ReplyTo;
use crate::swarm::pace::Pace;
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::sender::Sender;
use crate::swarm::worker::{End, Pending, Worker};
use jostle_physics::simulation::ReserveMemory;
use jostle_physics::simulation::Simulation;

/// Events told between a checkpoint and a crash are told under the same numbers again only in
/// part. Numbers go on from the next multiple of this, so that none is given twice.
const EVENTS_LOST: u64 = 1 << 20;

/// Niceness of a thread that only replays: lower priority than the hosted swarms.
const REPLAY_NICENESS: i32 = 15;

/// Makes the place that the answer to a command goes to.
pub type ReplyFor = Box<dyn Fn(&Arc<Sender>) -> ReplyTo + Send>;

/// A line of the journal; commands with what they order.
pub type Told = (Line, Option<Command>);

/// What is to be told again of a swarm.
pub struct ReplaySource {
    /// Where to begin.
    pub checkpoint: Checkpoint,
    /// The lines since, in order, read as they are told; or why they end.
    pub lines: Box<dyn Iterator<Item = Result<Told, String>> + Send>,
    /// What must be known of all those lines before the first is told.
    pub index: JournalIndex,
    /// Why the lines after these cannot be told, if there are such.
    pub damage: Option<String>,
    /// The commands that were applied before the checkpoint, as far back as they are shown.
    pub entries: Vec<Applied>,
    /// Where the answer to a command goes that may have missed its sender.
    pub recall: ReplyFor,
    /// Where it ends.
    pub to: To,
}

impl ReplaySource {
    /// Replays it outside the registry, for verification and copies. Returns the final state and
    /// what the replay found.
    pub fn replay(self) -> (Checkpoint, Replay) {
        let _ = rustix::process::setpriority_process(None, REPLAY_NICENESS);
        let handle = Handle::alone(self.checkpoint.simulation.spec.clone());
        let always: ReserveMemory = Box::new(|_| Ok(()));
        let (worker, _) =
            Worker::from_past(self, &handle, Duration::ZERO, (Arc::new(NoWriter), always));
        (worker.checkpoint(), worker.into_replay())
    }
}

/// A command that was applied.
pub struct Applied {
    /// The epoch.
    pub epoch: u64,
    /// The step.
    pub step: u64,
    /// Its number.
    pub seq: u64,
    /// The wall-clock time, in seconds since 1970, if known.
    pub unix_secs: Option<f64>,
    /// The command and who sent it.
    pub sender: Arc<Sender>,
}

/// Where telling again ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum To {
    /// Where the last command was carried out; what was begun then is still under way.
    LastInput,
    /// Where the last hash was written down.
    LastHash,
    /// At this epoch and step, after the commands that were given there.
    Place(u64, u64),
    /// On arriving at this step of the present run, before the commands that were given there.
    Step(u64),
}

/// What must be known of lines before the first of them is told.
#[derive(Default)]
pub struct JournalIndex {
    /// Lines whose commands were refused when they were first carried out.
    refused: BTreeSet<u64>,
    /// Lines of commands whose outcome is on a later line, with the wall-clock time of the outcome.
    settled: BTreeMap<u64, Option<f64>>,
    /// The hashes that steps had when they were first taken.
    hashes: BTreeMap<(u64, u64), [u8; 32]>,
    /// Where the last of them was written.
    last_hash: Option<(u64, u64)>,
    /// The line of the last reset.
    last_reset: u64,
    /// The last line.
    last: Option<u64>,
}

impl JournalIndex {
    /// Takes in the next line.
    pub fn learn(&mut self, (line, order): &Told) {
        self.last = Some(line.number);
        if matches!(order, Some(Command::Reset(_))) {
            self.last_reset = line.number;
        }
        match line.record {
            Record::Became {
                input,
                seq,
                unix_secs,
            } => {
                self.settled.insert(input, unix_secs);
                if seq.is_none() {
                    self.refused.insert(input);
                }
            }
            Record::Hash(hash) => {
                let at = (line.epoch, line.step);
                self.hashes.insert(at, hash);
                self.last_hash = Some(at);
            }
            _ => {}
        }
    }

    /// The last line, if there is any.
    pub fn last(&self) -> Option<u64> {
        self.last
    }
}

impl<'a> FromIterator<&'a Told> for JournalIndex {
    fn from_iter<I: IntoIterator<Item = &'a Told>>(lines: I) -> Self {
        let mut index = JournalIndex::default();
        lines.into_iter().for_each(|line| index.learn(line));
        index
    }
}

/// What is known of the past while it is told again.
#[derive(Default)]
pub struct Replay {
    refused: BTreeSet<u64>,
    /// When the command on each line was applied, by the wall clock.
    unix_secs: BTreeMap<u64, f64>,
    hashes: BTreeMap<(u64, u64), [u8; 32]>,
    /// How many hashes were found to be the same.
    pub same: u64,
    /// The first epoch and step whose hash was found to be another.
    pub differs_at: Option<(u64, u64)>,
    /// Why it could not be told to its end.
    pub broken_off: Option<String>,
}

impl Replay {
    /// Whether the command on this line was refused.
    pub fn was_refused(&self, input: u64) -> bool {
        self.refused.contains(&input)
    }

    /// When the command on this line was applied, by the wall clock, in seconds since 1970.
    pub fn unix_secs_of(&self, input: u64) -> Option<f64> {
        self.unix_secs.get(&input).copied()
    }

    /// Whether a step has the hash that it had, if that is known.
    pub fn is_as_it_was(&mut self, at: (u64, u64), hash: [u8; 32]) -> Option<bool> {
        let is_same = *self.hashes.get(&at)? == hash;
        self.same += u64::from(is_same);
        if !is_same {
            self.differs_at.get_or_insert(at);
        }
        Some(is_same)
    }

    fn forget(&mut self) {
        self.refused.clear();
        self.unix_secs.clear();
        self.hashes.clear();
    }
}

impl Worker {
    /// A worker around a swarm as it was at a checkpoint, told again from there.
    ///
    /// `admit` lets it grow meanwhile: what it was, it was let be. Returns how it ended, if the
    /// journal says that it did.
    pub fn from_past(
        past: ReplaySource,
        handle: &Handle,
        shortest_between_frames: Duration,
        (writer, admit): (Arc<dyn JournalWriter>, ReserveMemory),
    ) -> (Self, Option<End>) {
        let ReplaySource {
            checkpoint,
            lines,
            index,
            damage,
            entries,
            recall,
            to,
        } = past;
        for entry in entries {
            handle.history.recall(Entry {
                place: Place {
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
        let is_last = checkpoint.is_last && index.last.is_none();
        let pending = checkpoint.pending.clone();
        let joined = checkpoint.controllers.clone();
        let mut worker =
            Worker::from_kept(checkpoint, handle, shortest_between_frames, (writer, admit));
        // When it was created is not known any more.
        worker.applied_at(None, Worker::begin_copy);
        worker.journal.replay();
        worker.pending = pending.map(|(from, sender)| Pending {
            answer: recall(&sender),
            from,
            sender,
        });
        worker.controllers = Controllers::recall(joined, &recall);
        let end = worker.retell(lines, index, damage, &recall, to);
        if !is_last {
            worker.lose_events();
        }
        (worker, end)
    }

    /// Numbers events on from where none was numbered before.
    fn lose_events(&mut self) {
        self.events = (self.events / EVENTS_LOST + 1) * EVENTS_LOST;
    }

    /// A worker around a swarm as it was at a checkpoint.
    pub fn from_copy(
        checkpoint: Checkpoint,
        handle: &Handle,
        shortest_between_frames: Duration,
        (writer, admit): (Arc<dyn JournalWriter>, ReserveMemory),
    ) -> Self {
        let mut worker =
            Worker::from_kept(checkpoint, handle, shortest_between_frames, (writer, admit));
        worker.begin_copy();
        worker
    }

    fn begin_copy(&mut self) {
        if self.events == 0 {
            self.tell(EventKind::Created);
        }
        self.renew_summary();
    }

    fn from_kept(
        checkpoint: Checkpoint,
        handle: &Handle,
        shortest_between_frames: Duration,
        (writer, admit): (Arc<dyn JournalWriter>, ReserveMemory),
    ) -> Self {
        let simulation = Simulation::from_checkpoint(&checkpoint.simulation, admit);
        let mut worker = Worker::around(
            simulation,
            handle,
            shortest_between_frames,
            Journal::new(writer, checkpoint.lines, checkpoint.simulation.state.step),
        );
        worker.phase = checkpoint.phase;
        worker.rate = checkpoint.rate;
        worker.events = checkpoint.events;
        for (at_step, scheduled) in checkpoint.scheduled {
            // They fitted when they were put off.
            let _ = worker.schedule.add(at_step, scheduled);
        }
        worker.set_pace();
        worker
    }

    /// Begins a new epoch after what was told again, and makes it safe.
    ///
    /// # Errors
    ///
    /// [`WriteFault`]; the swarm goes on all the same.
    pub fn resume(&mut self, admit: ReserveMemory) -> Result<(), WriteFault> {
        self.simulation.set_reserve(admit);
        let (before, epoch) = (self.at(), self.simulation.epoch + 1);
        self.simulation.epoch = epoch;
        self.set_pace();
        let kept = self.journal.commit(before, vec![Record::Resumed(epoch)]);
        crash::point("swarm-resumed");
        if kept.is_err() {
            // What follows is written in this epoch: it comes before that, whenever it can.
            self.journal.append(before, Record::Resumed(epoch), None);
        }
        self.tell(EventKind::Phase);
        self.keep();
        self.renew_summary();
        self.go_on();
        kept.map(drop)
    }

    fn set_pace(&mut self) {
        let rate = match self.phase {
            Phase::Stepping { .. } => None,
            _ => self.rate,
        };
        let dt = self.simulation.state.parameters.dt;
        self.pace = Pace::new(rate, dt, Instant::now());
    }

    fn retell(
        &mut self,
        lines: impl Iterator<Item = Result<Told, String>>,
        index: JournalIndex,
        damage: Option<String>,
        recall: &dyn Fn(&Arc<Sender>) -> ReplyTo,
        to: To,
    ) -> Option<End> {
        self.journal
            .set_settled(index.settled.keys().copied().collect());
        let applied = index.settled.into_iter();
        self.replay.unix_secs = applied
            .filter_map(|(input, unix_secs)| Some((input, unix_secs?)))
            .collect();
        self.replay.refused = index.refused;
        self.replay.hashes = index.hashes;
        let mut last = self.journal.lines();
        let mut end = None;
        for line in lines {
            let (line, order) = match line {
                Ok(line) => line,
                Err(problem) => {
                    self.fault(problem.clone());
                    self.replay.broken_off = Some(problem);
                    break;
                }
            };
            let is_of_the_last_run = line.number > index.last_reset;
            if matches!(to, To::Step(step) if is_of_the_last_run && line.step >= step) {
                break;
            }
            crash::point("swarm-retold");
            last = line.number;
            match (line.record, order) {
                (
                    Record::Input {
                        at_step,
                        sender,
                        unix_secs,
                        ..
                    },
                    Some(order),
                ) => {
                    end = self.advance(line.epoch, line.step);
                    if end.is_some() || matches!(self.phase, Phase::Faulted(_)) && !is_cure(&order)
                    {
                        continue;
                    }
                    let input = match order {
                        ref order if order.is_group_committed() && at_step.is_none() => 0,
                        _ => line.number,
                    };
                    let command = CommandMessage {
                        answer: recall(&sender),
                        order,
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
                    // As it was told when the daemon came back then.
                    self.lose_events();
                    self.tell(EventKind::Phase);
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
            // What was done then may not be written down yet: whoever asked sees how far it came.
            (To::Step(step), _) if end.is_none() => end = self.step_on(self.at().0, step),
            (To::Place(epoch, step), _) if end.is_none() => end = self.step_on(epoch, step),
            (To::LastHash, Some((epoch, step))) if end.is_none() && self.at() < (epoch, step) => {
                end = self.advance(epoch, step);
            }
            _ => {}
        }
        self.replay.forget();
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

    /// Takes the steps that were taken until `step` of `epoch`, as far as the swarm moves.
    fn step_on(&mut self, epoch: u64, step: u64) -> Option<End> {
        while self.phase.is_moving() && self.at() < (epoch, step) {
            if let Some(end) = self.step() {
                return Some(end);
            }
        }
        None
    }

    /// Takes the steps that were taken until `step` of `epoch`, which the journal says were.
    fn advance(&mut self, epoch: u64, step: u64) -> Option<End> {
        if let Some(end) = self.step_on(epoch, step) {
            return Some(end);
        }
        if self.at() != (epoch, step) && !matches!(self.phase, Phase::Faulted(_)) {
            let (epoch_now, step_now) = self.at();
            self.fault(format!(
                "the journal goes on at step {step} of epoch {epoch}, which cannot be reached from \
                 step {step_now} of epoch {epoch_now}"
            ));
        }
        None
    }
}

/// Whether an order may follow a fault.
fn is_cure(order: &Command) -> bool {
    matches!(order, Command::Reset(_) | Command::Delete)
}
