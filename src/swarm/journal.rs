//! The journal of a swarm, from which it is recovered after a crash.
//!
//! A command is durable before it changes anything (write-ahead). Steps are not written: the same
//! commands at the same steps produce the same states. Only commands that are sent thousands of times
//! a second, such as `step`, are executed before they are durable (group commit).

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::WriteFault;
use crate::swarm::frame::Stamp;
use crate::swarm::schedule::Scheduled;
use crate::swarm::sender::Sender;

/// Commands that may be executed before they are durable. The next one waits for the disk, and is
/// rejected if that is full, so that the queue is bounded.
const MAX_AHEAD: usize = 1024;

/// A line of a journal.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// The number of the line in the journal of its swarm, from 1.
    pub number: u64,
    /// The epoch in which it was written.
    pub epoch: u64,
    /// The step at which it was written.
    pub step: u64,
    /// What it records.
    pub record: Record,
}

/// What a line records.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// A command is about to be executed, or scheduled for a step.
    Input {
        /// The step for which it is scheduled.
        at_step: Option<u64>,
        /// The command and its client.
        sender: Arc<Sender>,
        /// Its number among the applied commands, if it was executed before it was written.
        seq: Option<u64>,
        /// The wall-clock time, in seconds since 1970, if known.
        unix_secs: Option<f64>,
    },
    /// The outcome of a command.
    Outcome {
        /// The number of the command's line.
        input: u64,
        /// Its number among the applied commands; `None` if it was rejected.
        seq: Option<u64>,
        /// The wall-clock time of the outcome, in seconds since 1970, if known.
        unix_secs: Option<f64>,
    },
    /// A step failed, for this reason.
    Fault(String),
    /// The daemon restarted, and the swarm continues in this epoch.
    Resumed(u64),
    /// The hash of the state.
    Hash([u8; 32]),
}

/// An entry on its way to the store.
#[derive(Clone, Debug)]
pub enum Entry {
    /// A line of the journal.
    Line(Line),
    /// The whole state: earlier lines need not be replayed.
    Checkpoint(Box<Checkpoint>),
    /// The end of the swarm: where it was, and the client that deleted it.
    End(Stamp, Arc<Sender>),
}

/// Writes the entries of one swarm, in the order of calls. The entries of one call are written
/// together or not at all.
pub trait JournalWriter: Send + Sync {
    /// Writes entries, and waits until they are durable. After an error none of them was written.
    fn commit(&self, entries: Vec<Entry>) -> Result<(), WriteFault>;

    /// Queues entries. They are written within milliseconds, and retried while that fails. Once they
    /// and all earlier ones are durable, `pending` is marked durable.
    fn append(&self, entries: Vec<Entry>, pending: Option<PendingDurableStep>);
}

/// A writer that writes nothing.
pub struct NoWriter;

impl JournalWriter for NoWriter {
    fn commit(&self, _: Vec<Entry>) -> Result<(), WriteFault> {
        Ok(())
    }

    fn append(&self, _: Vec<Entry>, pending: Option<PendingDurableStep>) {
        if let Some(pending) = pending {
            pending.mark_durable();
        }
    }
}

/// The journal of one swarm.
pub struct Journal {
    writer: Arc<dyn JournalWriter>,
    lines: u64,
    progress: Arc<Mutex<Progress>>,
    /// The step that is durable once all queued entries are.
    queued_step: u64,
    /// While it is replayed: what has been read of it.
    replay: Option<Replayed>,
}

/// Called with the line that a replay has reached.
pub type OnProgress = Box<dyn Fn(u64) + Send>;

/// Called before each step of a replay; returns whether to go on.
pub type GoesOn = Box<dyn Fn() -> bool + Send>;

/// What a replay has read of a journal, and what it found.
#[derive(Default)]
pub struct Replayed {
    /// The last outcome of each command by its line: its `seq`, and the wall-clock time.
    outcomes: BTreeMap<u64, (Option<u64>, Option<f64>)>,
    /// The hashes by epoch and step, and their lines.
    hashes: BTreeMap<(u64, u64), (u64, [u8; 32])>,
    /// The commands `fired` by epoch and step.
    fired: BTreeMap<(u64, u64), Vec<Scheduled>>,
    on_progress: Option<OnProgress>,
    goes_on: Option<GoesOn>,
    /// Whether another version of the model computed the hashes: they are not compared.
    has_other_hashes: bool,
    /// Outcomes that the replay produced before it read them, each with its epoch and step.
    unsettled: Vec<((u64, u64), Record)>,
    /// How many hashes are the same.
    pub same: u64,
    /// The first epoch and step whose hash differs.
    pub differs_at: Option<(u64, u64)>,
    /// Why the journal ended before the target.
    pub problem: Option<String>,
    /// Whether it was not to go on.
    pub is_cancelled: bool,
}

impl Replayed {
    /// Whether the journal has the outcome of the command whose outcome `record` is.
    fn has_outcome(&self, record: &Record) -> bool {
        matches!(record, Record::Outcome { input, .. } if self.outcomes.contains_key(input))
    }
}

/// What a crash does not undo.
#[derive(Default)]
pub struct Progress {
    step: u64,
    /// How often a run was interrupted: steps that were queued before do not count afterwards.
    interruptions: u64,
    /// Calls of `append` with a step that is not durable yet.
    ahead: usize,
}

impl Progress {
    /// The last step that a crash does not undo.
    pub fn durable_step(&self) -> u64 {
        self.step
    }
}

/// A step that is durable once queued entries are.
pub struct PendingDurableStep {
    progress: Arc<Mutex<Progress>>,
    step: u64,
    interruptions: u64,
}

impl PendingDurableStep {
    /// The entries are durable.
    pub fn mark_durable(self) {
        let mut progress = self.progress.lock();
        if progress.interruptions == self.interruptions {
            progress.step = progress.step.max(self.step);
        }
        progress.ahead -= 1;
    }
}

impl Journal {
    /// A journal of so many lines, which reaches `step`. It keeps `progress` up to date.
    pub fn new(
        writer: Arc<dyn JournalWriter>,
        lines: u64,
        step: u64,
        progress: Arc<Mutex<Progress>>,
    ) -> Self {
        progress.lock().step = step;
        Journal {
            writer,
            lines,
            progress,
            queued_step: step,
            replay: None,
        }
    }

    /// The number of lines.
    pub fn lines(&self) -> u64 {
        self.lines
    }

    /// Whether it is being replayed; nothing is written then.
    pub fn is_replaying(&self) -> bool {
        self.replay.is_some()
    }

    /// Begins a replay. With `has_other_hashes` another version of the model computed the hashes: none is
    /// compared.
    pub fn begin_replay(
        &mut self,
        on_progress: Option<OnProgress>,
        goes_on: Option<GoesOn>,
        has_other_hashes: bool,
    ) {
        self.replay = Some(Replayed {
            on_progress,
            goes_on,
            has_other_hashes,
            ..Replayed::default()
        });
    }

    /// During a replay: reports that a line has been reached.
    pub fn report(&self, line: u64) {
        let on_progress = self.replay.as_ref().and_then(|it| it.on_progress.as_ref());
        on_progress.inspect(|it| it(line));
    }

    /// Whether a replay is to go on; true without one.
    pub fn goes_on(&mut self) -> bool {
        if let Some(replay) = &mut self.replay
            && let Some(goes_on) = &replay.goes_on
        {
            replay.is_cancelled = replay.is_cancelled || !goes_on();
            return !replay.is_cancelled;
        }
        true
    }

    /// Whether a replay was not to go on.
    pub fn is_cancelled(&self) -> bool {
        self.replay.as_ref().is_some_and(|it| it.is_cancelled)
    }

    /// Stores the outcome or the hash that a replayed line records. Returns whether it records one.
    pub fn read_ahead(&mut self, line: &Line) -> bool {
        let Some(replay) = &mut self.replay else {
            return false;
        };
        match line.record {
            Record::Outcome {
                input,
                seq,
                unix_secs,
            } => {
                replay.outcomes.insert(input, (seq, unix_secs));
            }
            Record::Hash(_) if replay.has_other_hashes => {}
            Record::Hash(hash) => {
                let place = (line.epoch, line.step);
                replay.hashes.insert(place, (line.number, hash));
            }
            _ => return false,
        }
        true
    }

    /// During a replay: what became of the command on this line, its `seq` and the wall-clock time, if
    /// that has been read.
    pub fn outcome(&self, input: u64) -> Option<(Option<u64>, Option<f64>)> {
        self.replay.as_ref()?.outcomes.get(&input).copied()
    }

    /// During a replay: stores a command `fired`, which is executed on reaching its step.
    pub fn read_fired(&mut self, at: (u64, u64), fired: Scheduled) {
        if let Some(replay) = &mut self.replay {
            replay.fired.entry(at).or_default().push(fired);
        }
    }

    /// During a replay: the commands `fired` at a step that have not been executed.
    pub fn take_fired(&mut self, at: (u64, u64)) -> Vec<Scheduled> {
        let fired = self.replay.as_mut().and_then(|it| it.fired.remove(&at));
        fired.unwrap_or_default()
    }

    /// During a replay: whether the outcomes of the commands `fired` at a step have been read.
    pub fn has_outcomes_of_fired(&self, at: (u64, u64)) -> bool {
        let fired = self.replay.as_ref().and_then(|it| it.fired.get(&at));
        fired.is_none_or(|all| all.iter().all(|it| self.outcome(it.input).is_some()))
    }

    /// During a replay: whether a step has the journaled hash; `None` if there is none.
    pub fn check_hash(&mut self, at: (u64, u64), hash: [u8; 32]) -> Option<bool> {
        let replay = self.replay.as_mut()?;
        let (line, stored) = *replay.hashes.get(&at)?;
        let is_same = stored == hash;
        replay.same += u64::from(is_same);
        if !is_same {
            replay.differs_at.get_or_insert(at);
        }
        self.report(line);
        Some(is_same)
    }

    /// During a replay: the epoch and step of the last hash that has been read.
    pub fn last_hash(&self) -> Option<(u64, u64)> {
        Some(*self.replay.as_ref()?.hashes.last_key_value()?.0)
    }

    /// Ends a replay at this line and step, and writes the outcomes that were not written.
    pub fn resume(&mut self, lines: u64, step: u64) -> Replayed {
        let mut replay = self.replay.take().unwrap_or_default();
        let unsettled = std::mem::take(&mut replay.unsettled).into_iter();
        (replay.on_progress, replay.goes_on) = (None, None);
        self.lines = lines;
        self.progress.lock().step = step;
        self.queued_step = step;
        // The outcome of a command that was to be scheduled is read after the command is applied.
        for (at, record) in unsettled.filter(|(_, record)| !replay.has_outcome(record)) {
            self.append(at, record, None);
        }
        replay
    }

    /// The last step that a crash does not undo, of a swarm that has ended its run at `step`.
    pub fn durable_step_of(&mut self, step: u64) -> u64 {
        if self.is_replaying() {
            return step;
        }
        self.interrupt(step);
        self.progress.lock().step
    }

    /// Ends a run at `step`: the steps that it was to reach beyond are not durable.
    pub fn interrupt(&mut self, step: u64) {
        let is_interrupted = self.queued_step > step;
        self.queued_step = self.queued_step.min(step);
        let mut progress = self.progress.lock();
        progress.step = progress.step.min(step);
        progress.interruptions += u64::from(is_interrupted);
    }

    /// Writes records at an epoch and step, and waits until they are durable. Returns the number of
    /// the first one. After an error none was written.
    pub fn commit(
        &mut self,
        (epoch, step): (u64, u64),
        records: Vec<Record>,
    ) -> Result<u64, WriteFault> {
        let before = self.lines;
        if self.is_replaying() {
            return Ok(before + 1);
        }
        let lines = records
            .into_iter()
            .map(|record| self.line(epoch, step, record));
        let lines = lines.map(Entry::Line).collect();
        if let Err(fault) = self.writer.commit(lines) {
            self.lines = before;
            return Err(fault);
        }
        let mut progress = self.progress.lock();
        progress.step = progress.step.max(step);
        Ok(before + 1)
    }

    /// Queues a record. Once it is durable, a crash undoes no step up to
    /// `durable_step`. Returns its number.
    pub fn append(
        &mut self,
        (epoch, step): (u64, u64),
        record: Record,
        durable_step: Option<u64>,
    ) -> u64 {
        if let Some(replay) = &mut self.replay {
            if matches!(record, Record::Outcome { .. }) && !replay.has_outcome(&record) {
                replay.unsettled.push(((epoch, step), record));
            }
            return self.lines;
        }
        let line = Entry::Line(self.line(epoch, step, record));
        let pending = durable_step.map(|step| self.pending_durable_step(step));
        self.writer.append(vec![line], pending);
        self.lines
    }

    /// Queues records, at least one, which are written together or not at all. Once they are durable,
    /// a crash undoes no step up to `durable_step`. Returns the number of the first one.
    pub fn append_all(
        &mut self,
        (epoch, step): (u64, u64),
        records: Vec<Record>,
        durable_step: u64,
    ) -> u64 {
        let first = self.lines + 1;
        if self.is_replaying() {
            return first;
        }
        let lines = records
            .into_iter()
            .map(|record| Entry::Line(self.line(epoch, step, record)));
        let lines = lines.collect();
        let pending = self.pending_durable_step(durable_step);
        self.writer.append(lines, Some(pending));
        first
    }

    /// Once all queued records are durable, a crash undoes no step up to this one.
    pub fn append_step(&mut self, step: u64) {
        if !self.is_replaying() && step > self.queued_step {
            let pending = self.pending_durable_step(step);
            self.writer.append(Vec::new(), Some(pending));
        }
    }

    fn pending_durable_step(&mut self, step: u64) -> PendingDurableStep {
        self.queued_step = self.queued_step.max(step);
        let mut progress = self.progress.lock();
        progress.ahead += 1;
        PendingDurableStep {
            progress: self.progress.clone(),
            step,
            interruptions: progress.interruptions,
        }
    }

    /// Whether so many commands were executed before they are durable that the next one must wait.
    pub fn is_far_ahead(&self) -> bool {
        self.progress.lock().ahead >= MAX_AHEAD
    }

    /// Queues a checkpoint.
    pub fn append_checkpoint(&mut self, checkpoint: Checkpoint) {
        if !self.is_replaying() {
            let step = checkpoint.simulation.state.step;
            let pending = checkpoint.is_last.then(|| self.pending_durable_step(step));
            let entry = Entry::Checkpoint(Box::new(checkpoint));
            self.writer.append(vec![entry], pending);
        }
    }

    /// Writes the end of the swarm, and waits until it is durable.
    pub fn end(&self, stamp: Stamp, sender: Arc<Sender>) -> Result<(), WriteFault> {
        self.writer.commit(vec![Entry::End(stamp, sender)])
    }

    fn line(&mut self, epoch: u64, step: u64, record: Record) -> Line {
        self.lines += 1;
        Line {
            number: self.lines,
            epoch,
            step,
            record,
        }
    }
}
