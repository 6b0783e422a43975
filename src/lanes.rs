//! Lanes: the threads that execute work of clients that may take long. Each kind of work has a lane of
//! its own, so that it waits for no other kind.
//!
//! Within a lane clients take turns: the next task is one of the client whose last task was taken
//! longest ago. A task is dropped once it has a reply or its client is known to wait no longer.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use fail::fail_point;
use parking_lot::{Condvar, Mutex};
use tracing::error;

/// The clients whose last turns are remembered.
const MAX_TURNS: usize = 4096;

/// A kind of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// Commands on experiments.
    Experiments,
    /// Commands on recordings.
    Recordings,
    /// Reads of the files of experiments and recordings.
    Files,
    /// Evaluation of measures.
    Measures,
    /// Exports of the commands of swarms.
    Exports,
    /// Replays of journals, for `verify` and `fork`.
    Replays,
}

/// What a lane may use.
struct Limits {
    threads: usize,
    /// Queued tasks of each rank; further ones are rejected.
    queued: usize,
    /// Of its threads; the swarms have 0.
    niceness: i32,
    /// The longest task, or time between two steps of one, of a healthy daemon.
    longest: Duration,
    /// How long tasks are queued while clients send no more than it executes.
    waiting: Duration,
}

impl Lane {
    /// All lanes, in the order in which metrics list them.
    pub const ALL: [Lane; 6] = [
        Lane::Experiments,
        Lane::Recordings,
        Lane::Files,
        Lane::Measures,
        Lane::Exports,
        Lane::Replays,
    ];

    /// The name of its threads, and in metrics.
    pub fn name(self) -> &'static str {
        match self {
            Lane::Experiments => "experiments",
            Lane::Recordings => "recordings",
            Lane::Files => "files",
            Lane::Measures => "measures",
            Lane::Exports => "exports",
            Lane::Replays => "replays",
        }
    }

    fn limits(self) -> Limits {
        let limits = |threads, queued, niceness| Limits {
            threads,
            queued,
            niceness,
            longest: Duration::from_secs(60),
            waiting: Duration::from_secs(10),
        };
        match self {
            Lane::Experiments | Lane::Recordings => limits(1, 256, 0),
            Lane::Files => limits(2, 256, 5),
            Lane::Measures => limits(1, 256, 10),
            Lane::Exports => limits(2, 64, 10),
            // A replay that is metered, one that is not, and a fork.
            Lane::Replays => Limits {
                // One long history may delay the next `verify`, which waits for a minute by default.
                waiting: Duration::from_secs(30),
                ..limits(3.max(cores() / 2), 32, 15)
            },
        }
    }
}

fn cores() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// Which tasks of a lane go first, and how many of them are executed at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rank {
    /// As many as there are threads.
    #[default]
    First,
    /// One at a time, if none of the first waits.
    Second,
    /// One at a time, if no other waits, within the CPU time of `Budget`.
    Metered,
}

/// A task of a client.
pub struct Task {
    turn: Arc<str>,
    rank: Rank,
    alone_on: Option<Arc<str>>,
    is_wanted: Box<dyn Fn() -> bool + Send>,
    work: Box<dyn FnOnce(Ticket) + Send>,
}

impl Task {
    /// A task that is executed even if its client is gone. `turn` is the client whose turn it takes.
    pub fn new(turn: &Arc<str>, work: impl FnOnce(Ticket) + Send + 'static) -> Self {
        Task {
            turn: turn.clone(),
            rank: Rank::First,
            alone_on: None,
            is_wanted: Box::new(|| true),
            work: Box::new(work),
        }
    }

    /// The task, to be dropped once `is_wanted` is false.
    #[must_use]
    pub fn while_wanted(self, is_wanted: impl Fn() -> bool + Send + 'static) -> Self {
        let is_wanted = Box::new(is_wanted);
        Task { is_wanted, ..self }
    }

    /// The task, of which one at a time of its rank is executed on `swarm`. It waits for none of another
    /// rank: a `verify` that lasts for hours must not delay a `fork`.
    #[must_use]
    pub fn alone_on(self, swarm: &Arc<str>, rank: Rank) -> Self {
        let alone_on = Some(swarm.clone());
        Task {
            rank,
            alone_on,
            ..self
        }
    }
}

/// A task that is being executed.
pub struct Ticket {
    is_wanted: Box<dyn Fn() -> bool + Send>,
    lane: Arc<OneLane>,
    number: u64,
    is_metered: bool,
}

impl Ticket {
    /// Whether the task is to go on. A task calls it at every step: its lane then knows that it does not
    /// hang, and one that is metered waits here for CPU time.
    pub fn goes_on(&self) -> bool {
        loop {
            if !(self.is_wanted)() {
                return false;
            }
            let mut state = self.lane.state.lock();
            if state.is_stopping {
                return false;
            }
            if let Some(running) = state.running.get_mut(&self.number) {
                running.seen = Instant::now();
            }
            if !self.is_metered {
                return true;
            }
            let wait = state.budget.spend(thread_secs());
            drop(state);
            if wait.is_zero() {
                return true;
            }
            // Short, so that it ends with its client.
            thread::sleep(wait.min(Duration::from_millis(50)));
        }
    }
}

/// The lane's queue is full.
#[derive(Debug)]
pub struct Full;

/// All lanes. Clones are the same lanes.
#[derive(Clone)]
pub struct Lanes(Arc<[Arc<OneLane>; Lane::ALL.len()]>);

struct OneLane {
    lane: Lane,
    limits: Limits,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// The oldest first.
    queue: Vec<Queued>,
    /// By number.
    running: BTreeMap<u64, Running>,
    /// When a task of each client was taken last, as a number of tasks.
    turns: BTreeMap<Arc<str>, u64>,
    /// The number of tasks that were queued so far.
    number: u64,
    /// The number of tasks that were taken so far.
    taken: u64,
    counts: Counts,
    budget: Budget,
    is_stopping: bool,
}

struct Queued {
    task: Task,
    since: Instant,
}

struct Running {
    rank: Rank,
    alone_on: Option<Arc<str>>,
    /// When it began, or called [`Ticket::goes_on`] last.
    seen: Instant,
}

/// Tasks of a lane since the daemon started.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Tasks that were executed.
    pub executed: u64,
    /// Tasks that were dropped because their clients no longer waited.
    pub dropped: u64,
    /// Tasks that were rejected because the queue was full.
    pub rejected: u64,
    /// The time for which executed tasks were queued.
    pub queued_secs: f64,
    /// The time of their execution.
    pub executed_secs: f64,
}

/// A lane at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Status {
    /// The lane.
    pub lane: Lane,
    /// Its tasks since the daemon started.
    pub counts: Counts,
    /// Tasks that are queued.
    pub queued: usize,
    /// Tasks that are being executed.
    pub running: usize,
    /// How long the oldest task has been queued.
    pub waiting: Duration,
    /// How long a task has been executed without a step, if that is longer than in a healthy daemon.
    pub stuck: Option<Duration>,
}

impl Status {
    /// Whether a task has been queued for too long.
    pub fn is_behind(&self) -> bool {
        self.waiting > self.lane.limits().waiting
    }
}

impl Lanes {
    /// Starts the threads.
    ///
    /// # Errors
    ///
    /// If a thread cannot be started.
    pub fn start() -> std::io::Result<Self> {
        let lanes = Lane::ALL.map(|lane| {
            Arc::new(OneLane {
                lane,
                limits: lane.limits(),
                state: Mutex::default(),
                changed: Condvar::new(),
            })
        });
        let lanes = Lanes(Arc::new(lanes));
        for lane in lanes.0.iter() {
            for _ in 0..lane.limits.threads {
                let lane = lane.clone();
                let thread = thread::Builder::new().name(lane.lane.name().to_owned());
                thread.spawn(move || lane.work())?;
            }
        }
        Ok(lanes)
    }

    /// Queues a task.
    ///
    /// # Errors
    ///
    /// [`Full`] if too many tasks are queued. A daemon that stops drops the task.
    pub fn submit(&self, lane: Lane, task: Task) -> Result<(), Full> {
        self.0[lane as usize].submit(task)
    }

    /// Drops what is queued, and ends the threads, because the daemon stops.
    pub fn stop(&self) {
        for lane in self.0.iter() {
            let mut state = lane.state.lock();
            state.is_stopping = true;
            let queue = std::mem::take(&mut state.queue);
            drop(state);
            lane.changed.notify_all();
            // Dropping a task may take locks.
            drop(queue);
        }
    }

    /// The present state of each lane.
    pub fn status(&self) -> [Status; Lane::ALL.len()] {
        self.0.each_ref().map(|lane| lane.status())
    }
}

impl OneLane {
    fn submit(&self, task: Task) -> Result<(), Full> {
        let mut state = self.state.lock();
        if state.is_stopping {
            drop(state);
            return Ok(());
        }
        let mut unwanted = Vec::new();
        if state.queued(task.rank) >= self.limits.queued {
            unwanted = state.sweep();
        }
        let is_full = state.queued(task.rank) >= self.limits.queued;
        if is_full {
            state.counts.rejected += 1;
        } else {
            state.queue.push(Queued {
                task,
                since: Instant::now(),
            });
        }
        drop(state);
        drop(unwanted);
        if is_full {
            return Err(Full);
        }
        self.changed.notify_one();
        Ok(())
    }

    /// Executes tasks until the daemon stops.
    fn work(self: Arc<Self>) {
        // Without permission the thread has the priority of the daemon, and works all the same.
        let _ = rustix::process::setpriority_process(None, self.limits.niceness);
        loop {
            let mut state = self.state.lock();
            let (taken, unwanted) = loop {
                if state.is_stopping {
                    return;
                }
                let unwanted = state.sweep();
                let taken = state.take();
                if taken.is_some() || !unwanted.is_empty() {
                    break (taken, unwanted);
                }
                self.changed.wait(&mut state);
            };
            drop(state);
            drop(unwanted);
            if let Some((number, task)) = taken {
                self.execute(number, task);
            }
        }
    }

    fn execute(self: &Arc<Self>, number: u64, task: Task) {
        let began = Instant::now();
        let ticket = Ticket {
            is_wanted: task.is_wanted,
            lane: self.clone(),
            number,
            is_metered: task.rank == Rank::Metered,
        };
        let work = task.work;
        let done = catch_unwind(AssertUnwindSafe(|| {
            fail_point!(&format!("lane-{}", self.lane.name()));
            work(ticket);
        }));
        if done.is_err() {
            let lane = self.lane.name();
            error!(lane, "a defect: a task panicked");
        }
        let mut state = self.state.lock();
        state.running.remove(&number);
        state.counts.executed += 1;
        state.counts.executed_secs += began.elapsed().as_secs_f64();
        drop(state);
        // A task that had to be alone may have waited for this one.
        self.changed.notify_all();
    }

    fn status(&self) -> Status {
        let mut state = self.state.lock();
        let unwanted = state.sweep();
        let ages = state.running.values().map(|it| it.seen.elapsed());
        let waiting = state.queue.iter().map(|it| it.since.elapsed());
        let status = Status {
            lane: self.lane,
            counts: state.counts,
            queued: state.queue.len(),
            running: state.running.len(),
            waiting: waiting.max().unwrap_or_default(),
            stuck: ages.max().filter(|age| *age > self.limits.longest),
        };
        drop(state);
        drop(unwanted);
        status
    }
}

impl State {
    /// Returns the number of queued tasks of a rank.
    fn queued(&self, rank: Rank) -> usize {
        self.queue.iter().filter(|it| it.task.rank == rank).count()
    }

    /// Removes the queued tasks whose clients no longer wait.
    fn sweep(&mut self) -> Vec<Queued> {
        let is_unwanted = |it: &mut Queued| !(it.task.is_wanted)();
        let unwanted: Vec<_> = self.queue.extract_if(.., is_unwanted).collect();
        self.counts.dropped += unwanted.len() as u64;
        unwanted
    }

    /// Takes the next task that may be executed now.
    fn take(&mut self) -> Option<(u64, Task)> {
        let may_run = |task: &Task| {
            let mut running = self.running.values();
            running.all(|other| {
                let is_same_swarm = task.alone_on.is_some() && task.alone_on == other.alone_on;
                let is_same_rank = task.rank == other.rank;
                !(is_same_rank && (is_same_swarm || task.rank != Rank::First))
            })
        };
        let places = self.queue.iter().enumerate();
        let places = places.filter(|(_, it)| may_run(&it.task));
        let (place, _) = places.min_by_key(|(place, it)| {
            let last = self.turns.get(&it.task.turn).copied();
            (it.task.rank, last.unwrap_or_default(), *place)
        })?;
        let Queued { task, since } = self.queue.remove(place);
        self.taken += 1;
        if self.turns.len() >= MAX_TURNS {
            self.turns.clear();
        }
        self.turns.insert(task.turn.clone(), self.taken);
        let now = Instant::now();
        self.counts.queued_secs += now.saturating_duration_since(since).as_secs_f64();
        self.number += 1;
        let running = Running {
            rank: task.rank,
            alone_on: task.alone_on.clone(),
            seen: now,
        };
        self.running.insert(self.number, running);
        Some((self.number, task))
    }
}

/// The CPU time of the metered tasks of a lane, one of which is executed at a time: a share of one core,
/// after a burst.
#[derive(Debug)]
struct Budget {
    left_secs: f64,
    at: Instant,
    /// The thread that spent last, and its CPU time then.
    thread: Option<(thread::ThreadId, f64)>,
}

impl Budget {
    /// Of one core.
    const SHARE: f64 = 0.25;
    const BURST_SECS: f64 = 5.0;

    /// Spends what the calling thread has used since it called this last; `cpu_secs` is the CPU time of
    /// the thread so far. Returns how long it has to wait.
    fn spend(&mut self, cpu_secs: f64) -> Duration {
        let (now, me) = (Instant::now(), thread::current().id());
        let earned = now.saturating_duration_since(self.at).as_secs_f64() * Self::SHARE;
        let used = match self.thread {
            Some((thread, before)) if thread == me => cpu_secs - before,
            _ => 0.0,
        };
        self.left_secs = (self.left_secs + earned).min(Self::BURST_SECS) - used;
        (self.at, self.thread) = (now, Some((me, cpu_secs)));
        Duration::from_secs_f64((-self.left_secs).max(0.0) / Self::SHARE)
    }
}

impl Default for Budget {
    fn default() -> Self {
        Budget {
            left_secs: Self::BURST_SECS,
            at: Instant::now(),
            thread: None,
        }
    }
}

/// The CPU time of the calling thread, in seconds.
fn thread_secs() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::mpsc::{Receiver, Sender, channel};

    use super::*;

    const LONG: Duration = Duration::from_secs(20);

    /// Lanes, whose threads of `lane` are all occupied until the sender is dropped.
    fn occupied(lane: Lane) -> (Lanes, Sender<()>) {
        let lanes = Lanes::start().unwrap();
        let (release, held) = channel::<()>();
        let held = Arc::new(Mutex::new(held));
        let (begun, has_begun) = channel();
        for _ in 0..lane.limits().threads {
            let (held, begun) = (held.clone(), begun.clone());
            let task = Task::new(&"other".into(), move |_| {
                begun.send(()).unwrap();
                let _ = held.lock().recv();
            });
            lanes.submit(lane, task).unwrap();
        }
        for _ in 0..lane.limits().threads {
            has_begun.recv_timeout(LONG).unwrap();
        }
        (lanes, release)
    }

    /// A task that sends its name.
    fn named(turn: &str, name: &'static str, done: &Sender<&'static str>) -> Task {
        let done = done.clone();
        Task::new(&turn.into(), move |_| {
            // A test that has seen enough is over.
            let _ = done.send(name);
        })
    }

    fn received(done: &Receiver<&'static str>, count: usize) -> Vec<&'static str> {
        (0..count)
            .map(|_| done.recv_timeout(LONG).unwrap())
            .collect()
    }

    #[test]
    fn clients_take_turns_and_one_with_many_tasks_delays_others_by_one() {
        let (lanes, release) = occupied(Lane::Measures);
        let (sender, done) = channel();
        for (turn, name) in [
            ("ada", "a1"),
            ("ada", "a2"),
            ("ada", "a3"),
            ("bob", "b1"),
            ("bob", "b2"),
            ("eve", "e1"),
        ] {
            lanes
                .submit(Lane::Measures, named(turn, name, &sender))
                .unwrap();
        }
        drop(release);
        assert_eq!(received(&done, 6), ["a1", "b1", "e1", "a2", "b2", "a3"]);
        lanes.stop();
    }

    #[test]
    fn a_lane_does_not_wait_for_another_one() {
        let (lanes, _release) = occupied(Lane::Files);
        let (sender, done) = channel();
        for _ in 0..100 {
            lanes
                .submit(Lane::Files, named("ada", "read", &sender))
                .unwrap();
        }
        lanes
            .submit(Lane::Experiments, named("bob", "cancel", &sender))
            .unwrap();
        assert_eq!(received(&done, 1), ["cancel"]);
        lanes.stop();
    }

    #[test]
    fn what_nobody_waits_for_is_dropped_and_makes_room() {
        let (lanes, release) = occupied(Lane::Replays);
        let (sender, done) = channel();
        let is_wanted = Arc::new(AtomicBool::new(true));
        let wanted = |name| {
            let is_wanted = is_wanted.clone();
            named("ada", name, &sender).while_wanted(move || is_wanted.load(Ordering::Relaxed))
        };
        for _ in 0..32 {
            lanes.submit(Lane::Replays, wanted("abandoned")).unwrap();
        }
        assert!(lanes.submit(Lane::Replays, wanted("rejected")).is_err());
        is_wanted.store(false, Ordering::Relaxed);
        let kept = || named("bob", "kept", &sender);
        (0..32).for_each(|_| lanes.submit(Lane::Replays, kept()).unwrap());
        assert!(lanes.submit(Lane::Replays, kept()).is_err());
        drop(release);
        assert_eq!(received(&done, 32), ["kept"; 32]);
        let replays = lanes.status()[Lane::Replays as usize];
        assert_eq!((replays.counts.dropped, replays.counts.rejected), (32, 2));
        lanes.stop();
    }

    #[test]
    fn one_verify_at_a_time_and_no_fork_waits_for_it() {
        let lanes = Lanes::start().unwrap();
        let (sender, done) = channel();
        let (release, held) = channel::<()>();
        let school: Arc<str> = "school".into();
        let (begun, has_begun) = channel();
        let verify = Task::new(&"ada".into(), move |_| {
            begun.send(()).unwrap();
            let _ = held.recv();
        });
        let verify = verify.alone_on(&school, Rank::Second);
        lanes.submit(Lane::Replays, verify).unwrap();
        has_begun.recv_timeout(LONG).unwrap();
        let other: Arc<str> = "other".into();
        for (swarm, rank, name) in [
            (&school, Rank::Second, "verify school"),
            (&school, Rank::First, "fork school"),
            (&other, Rank::Second, "verify other"),
            (&other, Rank::First, "fork other"),
        ] {
            let task = named(name, name, &sender).alone_on(swarm, rank);
            lanes.submit(Lane::Replays, task).unwrap();
        }
        // Forks do not wait for the first `verify`; the others do.
        let mut forks = received(&done, 2);
        forks.sort_unstable();
        assert_eq!(forks, ["fork other", "fork school"]);
        assert!(done.recv_timeout(Duration::from_millis(50)).is_err());
        drop(release);
        let mut rest = received(&done, 2);
        rest.sort_unstable();
        assert_eq!(rest, ["verify other", "verify school"]);
        lanes.stop();
    }

    #[test]
    fn a_task_that_panics_ends_alone_and_one_that_is_stopped_does_not_go_on() {
        let lanes = Lanes::start().unwrap();
        let (sender, done) = channel();
        let defect = Task::new(&"ada".into(), |_| panic!("a defect"));
        lanes.submit(Lane::Measures, defect).unwrap();
        let ends = sender.clone();
        let endless = Task::new(&"ada".into(), move |ticket| {
            ends.send("begun").unwrap();
            while ticket.goes_on() {
                thread::yield_now();
            }
            ends.send("ended").unwrap();
        });
        lanes.submit(Lane::Measures, endless).unwrap();
        assert_eq!(received(&done, 1), ["begun"]);
        let late = named("ada", "late", &sender);
        lanes.submit(Lane::Measures, late).unwrap();
        lanes.stop();
        assert_eq!(received(&done, 1), ["ended"]);
        drop(sender);
        assert!(done.recv_timeout(LONG).is_err());
    }

    #[test]
    fn a_lane_is_behind_once_a_task_has_waited_for_long() {
        for lane in Lane::ALL {
            let is_behind = |secs| {
                let status = Status {
                    lane,
                    counts: Counts::default(),
                    queued: 1,
                    running: 1,
                    waiting: Duration::from_secs(secs),
                    stuck: None,
                };
                status.is_behind()
            };
            let limit = if lane == Lane::Replays { 30 } else { 10 };
            assert!(!is_behind(limit) && is_behind(limit + 1), "{lane:?}");
        }
    }

    #[test]
    fn what_nobody_waits_for_is_not_counted_as_waiting() {
        let (lanes, _release) = occupied(Lane::Replays);
        let is_wanted = Arc::new(AtomicBool::new(true));
        let wanted = is_wanted.clone();
        let task = Task::new(&"ada".into(), |_| {});
        let task = task.while_wanted(move || wanted.load(Ordering::Relaxed));
        lanes.submit(Lane::Replays, task).unwrap();
        let replays = || lanes.status()[Lane::Replays as usize];
        assert_eq!((replays().queued, replays().counts.dropped), (1, 0));
        is_wanted.store(false, Ordering::Relaxed);
        assert_eq!((replays().queued, replays().counts.dropped), (0, 1));
        lanes.stop();
    }

    #[test]
    fn metered_work_has_its_share_of_a_core_after_a_burst() {
        let mut budget = Budget::default();
        assert_eq!(budget.spend(100.0), Duration::ZERO);
        assert_eq!(budget.spend(104.9), Duration::ZERO);
        // A second beyond the burst is earned in four.
        let wait = budget.spend(106.0).as_secs_f64();
        assert!((3.9..=4.0).contains(&wait), "{wait}");
        // Another thread begins with its own clock.
        let wait = thread::scope(|scope| scope.spawn(|| budget.spend(7.0)).join().unwrap());
        assert!(wait.as_secs_f64() <= 4.0, "{wait:?}");
    }
}
