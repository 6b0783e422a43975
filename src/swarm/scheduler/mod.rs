//! When a swarm may compute. Its thread takes a step once three conditions hold:
//!
//! 1. The step is due: [`Pace`] keeps the rate by the monotonic clock. A swarm without a rate, or that
//!    is behind its rate, is always due.
//! 2. Its [`Share`] has a turn. Of the swarms that are behind their rate, a few compute at once;
//!    the threads of the others sleep in a queue. So shares do not depend on how the kernel orders
//!    many runnable threads, and a command to a waiting swarm wakes a sleeping thread. The queue is
//!    ordered by virtual time, the processor time that a swarm took while others waited (start-time
//!    fair queueing), of which a swarm with a rate is charged a part (`PACED_WEIGHT`). The virtual time of a swarm that was idle is raised to that of the queue, so it
//!    gains nothing by it. A swarm that keeps its rate needs no turn while its virtual time is below
//!    that of the first in the queue. Turns in plain FIFO order would give a swarm with long steps a
//!    larger share, since a turn ends between two steps.
//! 3. The kernel runs the thread: `set_niceness`, so that stepping delays no command, and swarms
//!    without a rate delay none with one.

mod pace;

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use parking_lot::{Mutex, MutexGuard};
use rustix::time::{ClockId, clock_gettime};

pub use pace::{MAX_BACKLOG, Pace};

/// How long a swarm computes before the next one has its turn.
const TURN: Duration = Duration::from_millis(2);

/// Swarms that compute at once, for each core: while the kernel wakes one, another computes.
const TURNS_PER_CORE: usize = 2;

/// Added niceness of the thread of a swarm with a rate, so that stepping delays no command and no
/// reader.
const PACED_NICENESS: i32 = 5;

/// Added niceness of the thread of a swarm without a rate: the kernel then gives a thread of a swarm with
/// a rate twice the share of a core.
const UNPACED_NICENESS: i32 = 9;

/// The virtual time of a swarm with a rate grows so many times more slowly than that of one without.
const PACED_WEIGHT: u32 = 16;

/// Requested slice in nanoseconds: the minimum that Linux accepts; the default is some
/// milliseconds. From Linux 6.12 on, EEVDF runs a thread with a shorter slice sooner.
const SLICE_NANOS: u64 = 100_000;

/// Orders the swarms of one daemon.
pub struct CpuScheduler {
    /// No code under the lock can panic halfway.
    queue: Mutex<Queue>,
    /// Virtual time of the first waiter in nanoseconds, readable without the lock; [`NO_WAITER`] if
    /// there is none.
    first_waiter: AtomicU64,
}

const NO_WAITER: u64 = u64::MAX;

struct Queue {
    free_turns: usize,
    /// Ordered by virtual time, then by arrival.
    waiters: BTreeMap<(Duration, u64), Arc<Waiter>>,
    /// Virtual time of the queue: that of the waiter that was called last, or of a swarm that
    /// computed while none waited.
    virtual_time: Duration,
    arrivals: u64,
}

/// Wakes the thread of a swarm when it has its turn.
struct Waiter {
    is_called: AtomicBool,
    wake: Box<dyn Fn() + Send + Sync>,
}

/// The share of one swarm. Dropping it gives up its turn or its place in the queue.
pub struct Share {
    scheduler: Arc<CpuScheduler>,
    /// Its number of arrival while it waits.
    arrival: u64,
    waiter: Arc<Waiter>,
    turn: Turn,
    virtual_time: Duration,
    /// Processor time of its thread when `virtual_time` was last updated.
    charged: Option<Duration>,
    /// Whether it has a rate, and its thread the niceness of one that has.
    is_paced: bool,
}

/// How much a swarm needs a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// It has no rate.
    Unpaced,
    /// It is behind its rate.
    Behind,
    /// It keeps its rate.
    OnTime,
}

enum Turn {
    None,
    /// In the queue, or called since.
    Waiting,
    /// Computes since then.
    Running(Instant),
}

impl CpuScheduler {
    /// A scheduler for so many cores.
    pub fn new(cores: usize) -> Self {
        CpuScheduler::with_turns(TURNS_PER_CORE * cores.max(1))
    }

    fn with_turns(free_turns: usize) -> Self {
        CpuScheduler {
            queue: Mutex::new(Queue {
                free_turns,
                waiters: BTreeMap::new(),
                virtual_time: Duration::ZERO,
                arrivals: 0,
            }),
            first_waiter: AtomicU64::new(NO_WAITER),
        }
    }

    /// The share of a swarm; `wake` wakes its thread.
    pub fn share(self: &Arc<Self>, wake: impl Fn() + Send + Sync + 'static) -> Share {
        Share {
            scheduler: self.clone(),
            arrival: 0,
            waiter: Arc::new(Waiter {
                is_called: AtomicBool::new(false),
                wake: Box::new(wake),
            }),
            turn: Turn::None,
            virtual_time: Duration::ZERO,
            charged: None,
            is_paced: true,
        }
    }

    /// Publishes the first waiter, unlocks, and wakes the one that was called.
    fn unlock(&self, queue: MutexGuard<'_, Queue>, called: Option<Arc<Waiter>>) {
        let first = queue.waiters.first_key_value();
        let first = first.map_or(NO_WAITER, |((time, _), _)| nanos(*time));
        self.first_waiter.store(first, Ordering::Relaxed);
        drop(queue);
        if let Some(waiter) = called {
            (waiter.wake)();
        }
    }
}

impl Queue {
    /// Gives a turn to the first waiter, which must then be woken; without a waiter it becomes free.
    fn pass_on(&mut self) -> Option<Arc<Waiter>> {
        let Some(((time, _), waiter)) = self.waiters.pop_first() else {
            self.free_turns += 1;
            return None;
        };
        self.virtual_time = self.virtual_time.max(time);
        waiter.is_called.store(true, Ordering::Release);
        Some(waiter)
    }

    /// Does not charge what was computed while no swarm waited.
    fn skip_uncontended_time(&mut self, time: Duration) {
        if self.waiters.is_empty() {
            self.virtual_time = self.virtual_time.max(time);
        }
    }
}

impl Share {
    /// Whether the swarm may compute now. If not, its thread is woken when it may, and asks again.
    pub fn may_compute(&mut self, now: Instant, need: Need) -> bool {
        self.pace(need != Need::Unpaced);
        match self.turn {
            Turn::Running(since) if now.saturating_duration_since(since) < TURN => true,
            Turn::Running(_) => self.end_turn(now),
            Turn::Waiting => {
                let is_called = self.waiter.is_called.swap(false, Ordering::AcqRel);
                if is_called {
                    self.start_turn(now);
                }
                is_called
            }
            Turn::None => (need == Need::OnTime && self.within_budget()) || self.request_turn(now),
        }
    }

    /// Takes the weight and the niceness of a swarm with or without a rate.
    fn pace(&mut self, is_paced: bool) {
        if is_paced != self.is_paced {
            // With the weight that it had until now.
            if self.charged.is_some() {
                self.charge();
            }
            self.is_paced = is_paced;
            // Without the right to a lower niceness, the thread keeps its own.
            let _ = set_niceness(match is_paced {
                true => PACED_NICENESS,
                false => UNPACED_NICENESS,
            });
        }
    }

    /// Gives up its turn or its place in the queue.
    pub fn leave(&mut self) {
        match std::mem::replace(&mut self.turn, Turn::None) {
            Turn::None => {}
            Turn::Running(_) => {
                self.charge();
                let mut queue = self.scheduler.queue.lock();
                queue.skip_uncontended_time(self.virtual_time);
                let called = queue.pass_on();
                self.scheduler.unlock(queue, called);
            }
            Turn::Waiting => {
                let mut queue = self.scheduler.queue.lock();
                let place = (self.virtual_time, self.arrival);
                let was_waiting = queue.waiters.remove(&place).is_some();
                // If it is not in the queue, it was called and has a turn that it does not need.
                let called = (!was_waiting).then(|| {
                    self.waiter.is_called.store(false, Ordering::Release);
                    queue.pass_on()
                });
                self.scheduler.unlock(queue, called.flatten());
            }
        }
    }

    /// Whether no swarm waits, or those that wait have taken more.
    fn within_budget(&mut self) -> bool {
        let first = self.scheduler.first_waiter.load(Ordering::Relaxed);
        if first == NO_WAITER {
            self.charged = None;
            return true;
        }
        let first = Duration::from_nanos(first);
        self.virtual_time = self.virtual_time.max(first.saturating_sub(TURN));
        self.charge();
        self.virtual_time < first
    }

    /// Takes a free turn, or enters the queue.
    fn request_turn(&mut self, now: Instant) -> bool {
        let scheduler = self.scheduler.clone();
        let mut queue = scheduler.queue.lock();
        // Time that it did not use while others did is no credit.
        self.virtual_time = self.virtual_time.max(queue.virtual_time);
        let is_free = queue.free_turns > 0;
        if is_free {
            queue.free_turns -= 1;
            self.start_turn(now);
        } else {
            self.enqueue(&mut queue);
        }
        scheduler.unlock(queue, None);
        is_free
    }

    fn start_turn(&mut self, now: Instant) {
        self.turn = Turn::Running(now);
        self.charged = Some(thread_time());
    }

    /// Passes the turn on and enters the queue, or goes on if every waiter has taken more.
    fn end_turn(&mut self, now: Instant) -> bool {
        self.charge();
        let scheduler = self.scheduler.clone();
        let mut queue = scheduler.queue.lock();
        queue.skip_uncontended_time(self.virtual_time);
        let first = queue.waiters.first_key_value();
        if first.is_none_or(|((time, _), _)| self.virtual_time < *time) {
            self.turn = Turn::Running(now);
            return true;
        }
        self.enqueue(&mut queue);
        let called = queue.pass_on();
        scheduler.unlock(queue, called);
        false
    }

    fn enqueue(&mut self, queue: &mut Queue) {
        queue.arrivals += 1;
        self.arrival = queue.arrivals;
        let place = (self.virtual_time, self.arrival);
        queue.waiters.insert(place, self.waiter.clone());
        self.turn = Turn::Waiting;
    }

    /// Adds the processor time that its thread has taken since the last call.
    fn charge(&mut self) {
        let total = thread_time();
        let before = self.charged.replace(total).unwrap_or(total);
        let taken = total.saturating_sub(before);
        self.virtual_time += match self.is_paced {
            true => taken / PACED_WEIGHT,
            false => taken,
        };
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.leave();
    }
}

/// Processor time of this thread.
fn thread_time() -> Duration {
    Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).unwrap_or_default()
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(NO_WAITER - 1)
}

/// Gives the calling thread the niceness and the slice of the thread of a swarm with a rate.
pub fn lower_priority() -> io::Result<()> {
    set_niceness(PACED_NICENESS)
}

/// Gives the calling thread this niceness, and the slice of a swarm's thread. With a lower priority alone
/// a thread waits behind every running thread when it wakes, which takes milliseconds while the daemon
/// sends to a thousand sessions. A short slice makes the kernel run it soon after it wakes, and does
/// not change its share of the cores.
#[expect(unsafe_code, reason = "rustix and nix do not wrap sched_setattr")]
fn set_niceness(niceness: i32) -> io::Result<()> {
    let attributes = libc::sched_attr {
        size: u32::try_from(size_of::<libc::sched_attr>()).map_err(io::Error::other)?,
        sched_policy: libc::SCHED_OTHER.cast_unsigned(),
        sched_flags: 0,
        sched_nice: niceness,
        sched_priority: 0,
        sched_runtime: SLICE_NANOS,
        sched_deadline: 0,
        sched_period: 0,
    };
    // SAFETY: the call reads `size` bytes of `attributes`; pid 0 is the calling thread, flags are 0.
    match unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::fs::read_to_string;
    use std::sync::mpsc::{Receiver, channel};
    use std::thread;

    use super::*;

    fn share(scheduler: &Arc<CpuScheduler>) -> (Share, Receiver<()>) {
        let (call, called) = channel();
        let share = scheduler.share(move || {
            let _ = call.send(());
        });
        (share, called)
    }

    #[test]
    fn no_more_compute_than_there_are_turns_and_leaving_passes_one_on() {
        let scheduler = Arc::new(CpuScheduler::with_turns(2));
        let now = Instant::now();
        let [mut a, mut b, mut c, mut d] = [(); 4].map(|()| share(&scheduler));
        assert!(a.0.may_compute(now, Need::Behind) && b.0.may_compute(now, Need::Behind));
        assert!(!c.0.may_compute(now, Need::Behind) && !d.0.may_compute(now, Need::Behind));
        assert!(a.0.may_compute(now, Need::Behind), "its turn has not ended");
        a.0.leave();
        c.1.try_recv().unwrap();
        assert!(c.0.may_compute(now, Need::Behind) && !d.0.may_compute(now, Need::Behind));
        drop(b);
        assert!(d.0.may_compute(now, Need::Behind));
        d.0.leave();
        c.0.leave();
        assert!(a.0.may_compute(now, Need::Behind), "turns are free again");
        assert!(d.1.try_recv().is_ok() && d.1.try_recv().is_err());
    }

    #[test]
    fn leaving_after_a_call_passes_the_turn_on() {
        let scheduler = Arc::new(CpuScheduler::with_turns(1));
        let now = Instant::now();
        let [mut a, mut b, mut c] = [(); 3].map(|()| share(&scheduler));
        assert!(
            a.0.may_compute(now, Need::Behind)
                && !b.0.may_compute(now, Need::Behind)
                && !c.0.may_compute(now, Need::Behind)
        );
        a.0.leave();
        b.0.leave();
        assert!(c.0.may_compute(now, Need::Behind), "called when b left");
        assert!(
            !b.0.may_compute(now, Need::Behind),
            "the earlier call is void"
        );
        b.0.leave();
        c.0.leave();
        assert!(b.0.may_compute(now, Need::Behind));
    }

    #[test]
    fn a_turn_ends_if_others_wait() {
        let scheduler = Arc::new(CpuScheduler::with_turns(1));
        let now = Instant::now();
        let [mut a, mut b] = [(); 2].map(|()| share(&scheduler));
        assert!(a.0.may_compute(now, Need::Behind));
        assert!(
            a.0.may_compute(now + 2 * TURN, Need::Behind),
            "no swarm waits"
        );
        assert!(!b.0.may_compute(now + 2 * TURN, Need::Behind));
        assert!(
            a.0.may_compute(now + 5 * TURN / 2, Need::Behind),
            "its second turn"
        );
        let spent = Instant::now();
        while spent.elapsed() < TURN {}
        assert!(!a.0.may_compute(now + 4 * TURN, Need::Behind));
        assert!(b.0.may_compute(now + 4 * TURN, Need::Behind));
    }

    #[test]
    fn a_swarm_that_keeps_its_rate_needs_no_turn_while_it_is_within_budget() {
        let scheduler = Arc::new(CpuScheduler::with_turns(1));
        let now = Instant::now();
        let [mut a, mut b, mut c] = [(); 3].map(|()| share(&scheduler));
        assert!(a.0.may_compute(now, Need::Behind));
        assert!(c.0.may_compute(now, Need::OnTime), "no swarm waits");
        b.0.virtual_time = 10 * TURN;
        assert!(!b.0.may_compute(now, Need::Behind));
        assert!(c.0.may_compute(now, Need::OnTime), "it has taken less");
        assert_eq!(c.0.virtual_time, 9 * TURN, "at most one turn less");
        c.0.virtual_time = 11 * TURN;
        assert!(!c.0.may_compute(now, Need::OnTime));
        a.0.leave();
        assert!(b.0.may_compute(now, Need::Behind) && !c.0.may_compute(now, Need::OnTime));
        b.0.leave();
        assert!(c.0.may_compute(now, Need::OnTime));
    }

    #[test]
    fn time_taken_while_no_swarm_waited_is_not_charged() {
        let scheduler = Arc::new(CpuScheduler::with_turns(1));
        let now = Instant::now();
        let [mut a, mut b, mut c] = [(); 3].map(|()| share(&scheduler));
        assert!(a.0.may_compute(now, Need::Behind));
        a.0.virtual_time = 1000 * TURN;
        a.0.leave();
        assert!(b.0.may_compute(now, Need::Behind) && !a.0.may_compute(now, Need::Behind));
        assert!(!c.0.may_compute(now, Need::Behind));
        b.0.leave();
        assert!(a.0.may_compute(now, Need::Behind), "it asked before c");
    }

    #[test]
    fn shares_are_equal_however_long_a_step_is() {
        let scheduler = Arc::new(CpuScheduler::with_turns(1));
        let until = Instant::now() + 200 * TURN;
        let threads = [1, 3, 30].map(|length| {
            let (mut share, called) = share(&scheduler);
            thread::spawn(move || {
                let before = thread_time();
                while Instant::now() < until {
                    if share.may_compute(Instant::now(), Need::Behind) {
                        let end = thread_time() + length * TURN / 3;
                        while thread_time() < end {}
                    } else {
                        let _ = called.recv_timeout(TURN);
                    }
                }
                thread_time() - before
            })
        });
        let taken = threads.map(|it| it.join().unwrap());
        let (least, most) = (taken.iter().min().unwrap(), taken.iter().max().unwrap());
        assert!(*most - *least <= 30 * TURN, "{taken:?}");
        assert!(*least > 30 * TURN, "{taken:?}");
    }

    #[test]
    fn a_swarm_behind_its_rate_comes_before_one_without_a_rate() {
        let scheduler = Arc::new(CpuScheduler::with_turns(1));
        let until = Instant::now() + 100 * TURN;
        let threads = [Need::Behind, Need::Unpaced].map(|need| {
            let (mut share, called) = share(&scheduler);
            thread::spawn(move || {
                let before = thread_time();
                while Instant::now() < until {
                    if share.may_compute(Instant::now(), need) {
                        let end = thread_time() + TURN / 3;
                        while thread_time() < end {}
                    } else {
                        let _ = called.recv_timeout(TURN);
                    }
                }
                thread_time() - before
            })
        });
        let [behind, unpaced] = threads.map(|it| it.join().unwrap());
        assert!(behind > 5 * unpaced, "{behind:?} and {unpaced:?}");
        assert!(!unpaced.is_zero(), "none of the turns");
    }

    /// A field of `/proc/thread-self/sched`, which only kernels with `SCHED_DEBUG` have.
    fn field(name: &str) -> Option<u64> {
        let text = read_to_string("/proc/thread-self/sched").unwrap_or_default();
        let line = text.lines().find(|line| line.starts_with(name))?;
        line.rsplit(' ').next()?.parse().ok()
    }

    #[test]
    fn a_thread_has_the_niceness_and_slice_that_it_asked_for() {
        let thread = thread::spawn(|| {
            lower_priority().unwrap();
            let niceness = rustix::process::getpriority_process(None).unwrap();
            (niceness, field("se.slice"))
        });
        let (niceness, slice) = thread.join().unwrap();
        assert_eq!(niceness, PACED_NICENESS);
        assert!(slice.is_none_or(|it| it == SLICE_NANOS), "{slice:?}");
    }
}
