//! What others see of an experiment while it runs, and how they stop it.
//!
//! Who steps writes where nobody else does and reads one word: no lock is taken between steps.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

const GOING: u8 = 0;
const PAUSED: u8 = 1;
const CANCELLED: u8 = 2;

/// How long an experiment has to go on before it is told how long it will take.
const SETTLED: Duration = Duration::from_millis(500);

/// How far an experiment is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    /// How many runs it has.
    pub runs: usize,
    /// How many are over, those of an earlier go included.
    pub finished: usize,
    /// How many of them ended early.
    pub faulted: usize,
    /// The share of the work that is done, the work of runs under way included.
    pub share: f64,
    /// How long this go has taken, pauses aside.
    pub elapsed_secs: f64,
    /// How long it will still take, pauses aside; none while that cannot be told.
    pub left_secs: Option<f64>,
    /// The runs under way, each with the share of its steps that is done.
    pub running: Vec<(String, f64)>,
}

/// Watches and stops one go of an experiment, from any thread.
#[derive(Debug, Default)]
pub struct Control {
    signal: AtomicU8,
    board: Mutex<Board>,
    changed: Condvar,
}

/// Steps that one thread counts; on a line of the cache of its own.
#[derive(Debug, Default)]
#[repr(align(128))]
struct Counter(AtomicU64);

#[derive(Debug, Default)]
struct Board {
    runs: usize,
    finished: usize,
    faulted: usize,
    cost: f64,
    /// What was done before this go, and what is by now.
    cost_before: f64,
    cost_finished: f64,
    running: BTreeMap<usize, UnderWay>,
    clock: Clock,
}

#[derive(Debug)]
struct UnderWay {
    name: String,
    steps: u64,
    cost: f64,
    counter: Arc<Counter>,
}

/// How long it has been going.
#[derive(Debug, Default)]
struct Clock {
    past: Duration,
    since: Option<Instant>,
}

impl Clock {
    fn stop(&mut self) {
        self.past = self.read();
        self.since = None;
    }

    fn start(&mut self) {
        self.since = self.since.or_else(|| Some(Instant::now()));
    }

    fn read(&self) -> Duration {
        self.past + self.since.map_or(Duration::ZERO, |since| since.elapsed())
    }
}

/// What one run tells of itself, and hears.
pub struct Watch<'a> {
    control: &'a Control,
    counter: Arc<Counter>,
}

impl Control {
    /// Lets an experiment go on.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Has every run stand still before its next step.
    pub fn pause(&self) {
        let mut board = self.board();
        if self.is(GOING) {
            self.signal.store(PAUSED, Ordering::Relaxed);
            board.clock.stop();
        }
    }

    /// Has every run go on.
    pub fn resume(&self) {
        let mut board = self.board();
        if self.is(PAUSED) {
            self.signal.store(GOING, Ordering::Relaxed);
            if board.runs > 0 {
                board.clock.start();
            }
            self.changed.notify_all();
        }
    }

    /// Has every run end before its next step, for good; what is finished is kept.
    pub fn cancel(&self) {
        let _board = self.board();
        self.signal.store(CANCELLED, Ordering::Relaxed);
        self.changed.notify_all();
    }

    /// Whether it is paused.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.is(PAUSED)
    }

    /// Whether it was cancelled.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.is(CANCELLED)
    }

    /// How far it is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        let board = self.board();
        let running: Vec<(&UnderWay, f64)> = board
            .running
            .values()
            .map(|run| {
                let steps = run.counter.0.load(Ordering::Relaxed);
                (run, steps as f64 / run.steps.max(1) as f64)
            })
            .collect();
        let under_way: f64 = running.iter().map(|(run, share)| run.cost * share).sum();
        let done = board.cost_finished + under_way;
        let elapsed = board.clock.read();
        let gained = done - board.cost_before;
        let left_secs = (elapsed > SETTLED && gained > 0.0)
            .then(|| elapsed.as_secs_f64() * f64::max(board.cost - done, 0.0) / gained);
        Progress {
            runs: board.runs,
            finished: board.finished,
            faulted: board.faulted,
            share: match board.cost > 0.0 {
                true => f64::min(done / board.cost, 1.0),
                false => 0.0,
            },
            elapsed_secs: elapsed.as_secs_f64(),
            left_secs,
            running: running
                .into_iter()
                .map(|(run, share)| (run.name.clone(), share))
                .collect(),
        }
    }

    /// Begins a go of so many runs, some of which are finished.
    pub(super) fn begin(&self, runs: usize, finished: usize, faulted: usize, costs: [f64; 2]) {
        let mut board = self.board();
        let [cost, cost_before] = costs;
        *board = Board {
            runs,
            finished,
            faulted,
            cost,
            cost_before,
            cost_finished: cost_before,
            ..Board::default()
        };
        if self.is(GOING) {
            board.clock.start();
        }
    }

    /// Ends the go; returns the runs that have not ended.
    pub(super) fn end(&self) -> Vec<String> {
        let mut board = self.board();
        board.clock.stop();
        let left = std::mem::take(&mut board.running).into_values();
        left.map(|run| run.name).collect()
    }

    /// A run begins.
    pub(super) fn begin_run(&self, index: usize, name: &str, steps: u64, cost: f64) -> Watch<'_> {
        let counter = Arc::new(Counter::default());
        let run = UnderWay {
            name: name.to_owned(),
            steps,
            cost,
            counter: counter.clone(),
        };
        self.board().running.insert(index, run);
        Watch {
            control: self,
            counter,
        }
    }

    /// A run is over.
    pub(super) fn end_run(&self, index: usize, is_faulted: bool) {
        let mut board = self.board();
        let run = board.running.remove(&index);
        board.cost_finished += run.map_or(0.0, |run| run.cost);
        board.finished += 1;
        board.faulted += usize::from(is_faulted);
    }

    /// A run is given up.
    pub(super) fn drop_run(&self, index: usize) {
        self.board().running.remove(&index);
    }

    fn is(&self, signal: u8) -> bool {
        self.signal.load(Ordering::Relaxed) == signal
    }

    fn board(&self) -> MutexGuard<'_, Board> {
        // What is on it is of no consequence for any run.
        self.board.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until it is no longer paused; whether it is to go on then.
    #[cold]
    fn wait(&self) -> bool {
        let board = self.board();
        let board = self.changed.wait_while(board, |_| self.is(PAUSED));
        drop(board);
        self.is(GOING)
    }
}

impl Watch<'_> {
    /// Tells how many steps were taken, and whether there is to be another.
    #[inline]
    pub fn go_on(&self, steps: u64) -> bool {
        self.counter.0.store(steps, Ordering::Relaxed);
        self.control.is(GOING) || self.control.wait()
    }
}
