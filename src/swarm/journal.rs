//! The journal of a swarm, from which it is recovered after a crash.
//!
//! A command is durable before it changes anything (write-ahead). Steps are not written: the same
//! commands at the same steps produce the same states. Only commands that are sent thousands of times
//! a second, such as `step`, are executed before they are durable (group commit).

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::WriteFault;
use crate::swarm::frame::Stamp;
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
    Became {
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
    /// Writes entries, and waits until they are durable.
    ///
    /// # Errors
    ///
    /// [`WriteFault`]: none of them was written.
    fn commit(&self, entries: Vec<Entry>) -> Result<(), WriteFault>;

    /// Queues entries. They are written within milliseconds, and retried while that fails. Once they
    /// and all earlier ones are durable, `reached` is.
    fn append(&self, entries: Vec<Entry>, reached: Option<Reached>);
}

/// A writer that writes nothing.
pub struct NoWriter;

impl JournalWriter for NoWriter {
    fn commit(&self, _: Vec<Entry>) -> Result<(), WriteFault> {
        Ok(())
    }

    fn append(&self, _: Vec<Entry>, reached: Option<Reached>) {
        if let Some(reached) = reached {
            reached.is_durable();
        }
    }
}

/// The journal of one swarm.
pub struct Journal {
    writer: Arc<dyn JournalWriter>,
    lines: u64,
    durable: Arc<Durable>,
    /// The step that is durable once all queued entries are.
    queued_step: u64,
    is_replaying: bool,
    /// While it is replayed: the commands whose outcomes it records.
    settled: BTreeSet<u64>,
    /// While it is replayed: the outcomes that a crash prevented from being written, and where.
    unsettled: Vec<((u64, u64), Record)>,
}

/// What a crash does not undo.
struct Durable {
    progress: Mutex<Progress>,
    /// Calls of `append` with a step that is not durable yet.
    ahead: AtomicUsize,
}

struct Progress {
    step: u64,
    /// How often a run was interrupted: steps that were queued before do not count afterwards.
    interruptions: u64,
}

/// A step that is durable once queued entries are.
pub struct Reached {
    durable: Arc<Durable>,
    step: u64,
    interruptions: u64,
}

impl Reached {
    /// The entries are durable.
    pub fn is_durable(self) {
        let mut progress = self.durable.progress();
        if progress.interruptions == self.interruptions {
            progress.step = progress.step.max(self.step);
        }
        self.durable.ahead.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Durable {
    fn progress(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Journal {
    /// A journal of so many lines, which reaches `step`.
    pub fn new(writer: Arc<dyn JournalWriter>, lines: u64, step: u64) -> Self {
        Journal {
            writer,
            lines,
            durable: Arc::new(Durable {
                progress: Mutex::new(Progress {
                    step,
                    interruptions: 0,
                }),
                ahead: AtomicUsize::new(0),
            }),
            queued_step: step,
            is_replaying: false,
            settled: BTreeSet::new(),
            unsettled: Vec::new(),
        }
    }

    /// The number of lines.
    pub fn lines(&self) -> u64 {
        self.lines
    }

    /// Whether it is being replayed; nothing is written then.
    pub fn is_replaying(&self) -> bool {
        self.is_replaying
    }

    /// Begins a replay.
    pub fn replay(&mut self) {
        self.is_replaying = true;
    }

    /// Sets the commands whose outcomes the journal records.
    pub fn set_settled(&mut self, settled: BTreeSet<u64>) {
        self.settled = settled;
    }

    /// Ends a replay at this line and step, and writes the outcomes that were not written.
    pub fn resume(&mut self, lines: u64, step: u64) {
        self.is_replaying = false;
        self.lines = lines;
        self.durable.progress().step = step;
        self.queued_step = step;
        self.settled.clear();
        for (at, record) in std::mem::take(&mut self.unsettled) {
            self.append(at, record, None);
        }
    }

    /// The last step that a crash does not undo, of a swarm that has ended its run at `step`.
    pub fn durable_step_of(&mut self, step: u64) -> u64 {
        if self.is_replaying {
            return step;
        }
        self.interrupt(step);
        self.durable.progress().step
    }

    /// Ends a run at `step`: the steps that it was to reach beyond are not durable.
    pub fn interrupt(&mut self, step: u64) {
        let is_interrupted = self.queued_step > step;
        self.queued_step = self.queued_step.min(step);
        let mut progress = self.durable.progress();
        progress.step = progress.step.min(step);
        progress.interruptions += u64::from(is_interrupted);
    }

    /// Writes records at an epoch and step, and waits until they are durable. Returns the number of
    /// the first one.
    ///
    /// # Errors
    ///
    /// [`WriteFault`]: none was written.
    pub fn commit(
        &mut self,
        (epoch, step): (u64, u64),
        records: Vec<Record>,
    ) -> Result<u64, WriteFault> {
        let before = self.lines;
        if self.is_replaying {
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
        let mut progress = self.durable.progress();
        progress.step = progress.step.max(step);
        Ok(before + 1)
    }

    /// Queues a record. Once it is durable, a crash undoes no step up to `reached`. Returns its number.
    pub fn append(
        &mut self,
        (epoch, step): (u64, u64),
        record: Record,
        reached: Option<u64>,
    ) -> u64 {
        if self.is_replaying {
            if matches!(&record, Record::Became { input, .. } if !self.settled.contains(input)) {
                self.unsettled.push(((epoch, step), record));
            }
            return self.lines;
        }
        let line = Entry::Line(self.line(epoch, step, record));
        let reached = reached.map(|step| self.reached(step));
        self.writer.append(vec![line], reached);
        self.lines
    }

    /// Once all queued records are durable, a crash undoes no step up to this one.
    pub fn reach(&mut self, step: u64) {
        if !self.is_replaying && step > self.queued_step {
            let reached = self.reached(step);
            self.writer.append(Vec::new(), Some(reached));
        }
    }

    fn reached(&mut self, step: u64) -> Reached {
        self.queued_step = self.queued_step.max(step);
        self.durable.ahead.fetch_add(1, Ordering::Relaxed);
        Reached {
            interruptions: self.durable.progress().interruptions,
            durable: self.durable.clone(),
            step,
        }
    }

    /// Whether so many commands were executed before they are durable that the next one must wait.
    pub fn is_far_ahead(&self) -> bool {
        self.durable.ahead.load(Ordering::Relaxed) >= MAX_AHEAD
    }

    /// Queues a checkpoint.
    pub fn keep(&self, checkpoint: Checkpoint) {
        if !self.is_replaying {
            let entry = Entry::Checkpoint(Box::new(checkpoint));
            self.writer.append(vec![entry], None);
        }
    }

    /// Writes the end of the swarm, and waits until it is durable.
    ///
    /// # Errors
    ///
    /// [`WriteFault`]: it was not written.
    pub fn end(&self, stamp: Stamp, sender: Arc<Sender>) -> Result<(), WriteFault> {
        self.writer.commit(vec![Entry::End(stamp, sender)])
    }

    /// Waits until all queued entries are durable.
    ///
    /// # Errors
    ///
    /// [`WriteFault`].
    pub fn sync(&self) -> Result<(), WriteFault> {
        self.writer.commit(Vec::new())
    }

    /// Begins at step 0 again.
    pub fn reset(&mut self) {
        self.interrupt(0);
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
