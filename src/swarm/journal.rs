//! What a swarm writes down, so that after a crash its past can be told and its future goes on.
//!
//! A command is written down and safe before it changes anything; steps are not written at all,
//! since the same commands at the same steps lead to the same state. Only the `step` command is
//! carried out before it is safe: whoever sends thousands a second need not wait for the disk.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::WriteFault;
use crate::swarm::frame::Place;
use crate::swarm::sender::Sender;

/// Commands that may be carried out before they are safe. The next one waits for the disk, and
/// hears if it is full: what is held for later is bounded.
const MOST_AHEAD: usize = 1024;

/// One line of a journal.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Counts a swarm's lines from 1.
    pub number: u64,
    /// The epoch it was written in.
    pub epoch: u64,
    /// The step it was written at.
    pub step: u64,
    /// What it says.
    pub record: Record,
}

/// What a line says.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// A command is about to be carried out, or to be put off until a step.
    Input {
        /// The step it is to be put off until.
        at_step: Option<u64>,
        /// The command.
        sender: Arc<Sender>,
        /// Its number among the applied ones, if it has been carried out already.
        seq: Option<u64>,
        /// The wall-clock time, in seconds since 1970, if known.
        unix_secs: Option<f64>,
    },
    /// What became of the command on the line of this number.
    Became {
        /// That line's number.
        input: u64,
        /// Its number among the applied ones; none if it was refused.
        seq: Option<u64>,
        /// The wall-clock time when it was carried out or refused, in seconds since 1970, if known.
        unix_secs: Option<f64>,
    },
    /// A step failed, for this reason.
    Fault(String),
    /// The daemon restarted, and the swarm goes on in this epoch.
    Resumed(u64),
    /// The state had this hash.
    Hash([u8; 32]),
}

/// What is to be written.
#[derive(Clone, Debug)]
pub enum Written {
    /// A line of the journal.
    Line(Line),
    /// The swarm as it is, so that earlier lines need not be told again.
    Checkpoint(Box<Checkpoint>),
    /// The swarm's end: where it was, and who ended it.
    End(Place, Arc<Sender>),
}

/// Told when something is safe, or why it will not be.
pub type Done = Box<dyn FnOnce(Result<(), WriteFault>) + Send>;

/// When something is to be written.
pub enum Wanted {
    /// At once, or not at all.
    Now(Done),
    /// Within a few milliseconds, tried again for as long as it fails; told when it is safe.
    Soon(Option<Box<dyn FnOnce() + Send>>),
}

/// Writes together what belongs together, in the order of calls.
pub type Writer = Arc<dyn Fn(Vec<Written>, Wanted) + Send + Sync>;

/// A writer that says at once that all is safe, and writes nothing.
pub fn to_nowhere() -> Writer {
    Arc::new(|_, wanted| match wanted {
        Wanted::Now(done) => done(Ok(())),
        Wanted::Soon(Some(told)) => told(),
        Wanted::Soon(None) => {}
    })
}

/// One swarm's journal.
pub struct Journal {
    writer: Writer,
    lines: u64,
    safe: Arc<Mutex<Safe>>,
    /// The step that will be safe once everything noted so far is.
    noted_step: u64,
    /// Commands that were carried out and are not safe yet.
    ahead: Arc<AtomicUsize>,
    is_replaying: bool,
    /// Commands of which is written what became of them, while it is told again.
    told: BTreeSet<u64>,
    /// What became of the others, and where: a crash came before it was written.
    untold: Vec<((u64, u64), Record)>,
}

/// How far a crash takes nothing back.
struct Safe {
    step: u64,
    /// How often what was to be done was cut short: what was noted before counts no more.
    cuts: u64,
}

/// Records that are being written: how many lines there were before, and at which step.
pub struct Begun {
    before: u64,
    step: u64,
}

impl Journal {
    /// A journal of so many lines, written by `writer`, that reaches `step`.
    pub fn new(writer: Writer, lines: u64, step: u64) -> Self {
        Journal {
            writer,
            lines,
            safe: Arc::new(Mutex::new(Safe { step, cuts: 0 })),
            noted_step: step,
            ahead: Arc::default(),
            is_replaying: false,
            told: BTreeSet::new(),
            untold: Vec::new(),
        }
    }

    /// How many lines it has.
    pub fn lines(&self) -> u64 {
        self.lines
    }

    /// Whether it is being told again; nothing is written then.
    pub fn is_replaying(&self) -> bool {
        self.is_replaying
    }

    /// Begins to be told again.
    pub fn replay(&mut self) {
        self.is_replaying = true;
    }

    /// Is told of these commands what became of them.
    pub fn learn(&mut self, told: BTreeSet<u64>) {
        self.told = told;
    }

    /// Has been told again up to this line and step, and is written from here on: first what
    /// became of commands that nobody had written down.
    pub fn resume(&mut self, lines: u64, step: u64) {
        self.is_replaying = false;
        self.lines = lines;
        self.safe().step = step;
        self.noted_step = step;
        self.told.clear();
        for (at, record) in std::mem::take(&mut self.untold) {
            self.note(at, record, None);
        }
    }

    /// The last step that a crash would not take back, of a swarm that now is at `step` and has
    /// ended what it was to do.
    pub fn safe_step_of(&mut self, step: u64) -> u64 {
        if self.is_replaying {
            return step;
        }
        self.cut(step);
        self.safe().step
    }

    /// What was to be done and is cut short at this step is safe only as far as it came.
    pub fn cut(&mut self, step: u64) {
        let is_cut = self.noted_step > step;
        self.noted_step = self.noted_step.min(step);
        let mut safe = self.safe();
        safe.step = safe.step.min(step);
        safe.cuts += u64::from(is_cut);
    }

    /// Writes records of a swarm at `place` and waits until they are safe. Returns the first
    /// one's number; on a fault they have none.
    ///
    /// # Errors
    ///
    /// [`WriteFault`].
    pub fn commit(
        &mut self,
        (epoch, step): (u64, u64),
        records: Vec<Record>,
    ) -> Result<u64, WriteFault> {
        if self.is_replaying {
            return Ok(self.lines + 1);
        }
        let (lines, begun) = self.begin((epoch, step), records);
        let result = self.wait(lines);
        self.committed(begun, result)
    }

    fn begin(&mut self, (epoch, step): (u64, u64), records: Vec<Record>) -> (Vec<Written>, Begun) {
        let before = self.lines;
        let lines = records
            .into_iter()
            .map(|record| Written::Line(self.line(epoch, step, record)))
            .collect();
        (lines, Begun { before, step })
    }

    /// Takes in whether records are safe. Returns the first one's number.
    ///
    /// # Errors
    ///
    /// [`WriteFault`], as it was told.
    pub fn committed(
        &mut self,
        Begun { before, step }: Begun,
        result: Result<(), WriteFault>,
    ) -> Result<u64, WriteFault> {
        match result {
            Ok(()) => {
                let mut safe = self.safe();
                safe.step = safe.step.max(step);
                Ok(before + 1)
            }
            Err(fault) => {
                self.lines = before;
                Err(fault)
            }
        }
    }

    /// Has a record written when it suits; once it is, a crash takes back no step up to `reached`.
    pub fn note(&mut self, (epoch, step): (u64, u64), record: Record, reached: Option<u64>) -> u64 {
        if self.is_replaying {
            if matches!(&record, Record::Became { input, .. } if !self.told.contains(input)) {
                self.untold.push(((epoch, step), record));
            }
            return self.lines;
        }
        let line = Written::Line(self.line(epoch, step, record));
        let told = reached.map(|reached| self.safe_to(reached));
        (self.writer)(vec![line], Wanted::Soon(told));
        self.lines
    }

    /// Once all that has been noted is written, a crash takes back no step up to this one.
    pub fn reach(&mut self, step: u64) {
        if !self.is_replaying && step > self.noted_step {
            let told = self.safe_to(step);
            (self.writer)(Vec::new(), Wanted::Soon(Some(told)));
        }
    }

    /// Makes steps up to this one safe when it is called.
    fn safe_to(&mut self, step: u64) -> Box<dyn FnOnce() + Send> {
        self.noted_step = self.noted_step.max(step);
        let (safe, ahead) = (self.safe.clone(), self.ahead.clone());
        let cuts = self.safe().cuts;
        ahead.fetch_add(1, Ordering::Relaxed);
        Box::new(move || {
            let mut safe = safe.lock().unwrap_or_else(PoisonError::into_inner);
            if safe.cuts == cuts {
                safe.step = safe.step.max(step);
            }
            ahead.fetch_sub(1, Ordering::Relaxed);
        })
    }

    fn safe(&self) -> MutexGuard<'_, Safe> {
        self.safe.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether so much was carried out before it is safe that the next command waits until it is.
    pub fn is_far_ahead(&self) -> bool {
        self.ahead.load(Ordering::Relaxed) >= MOST_AHEAD
    }

    /// Has the swarm as it is written when it suits.
    pub fn keep(&self, checkpoint: Checkpoint) {
        if !self.is_replaying {
            let kept = vec![Written::Checkpoint(Box::new(checkpoint))];
            (self.writer)(kept, Wanted::Soon(None));
        }
    }

    /// Writes something and waits until it is safe.
    ///
    /// # Errors
    ///
    /// [`WriteFault`].
    pub fn wait(&self, written: Vec<Written>) -> Result<(), WriteFault> {
        let (done, is_done) = sync_channel(1);
        (self.writer)(
            written,
            Wanted::Now(Box::new(move |result| {
                // Whoever waited may be gone.
                let _ = done.send(result);
            })),
        );
        is_done
            .recv()
            .unwrap_or_else(|_| Err(WriteFault::Failed("the daemon is stopping".into())))
    }

    /// Is at step 0 again. What was written before is safe by now, and told.
    pub fn start_over(&mut self) {
        self.cut(0);
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
