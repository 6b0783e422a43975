//! When a swarm may compute. Its thread takes a step once three conditions hold:
//!
//! 1. The step is due: [`Pace`] keeps the rate by the monotonic clock. A swarm without a rate, or that
//!    is behind its rate, is always due.
//! 2. Its [`Share`] has a turn. Of the swarms that are behind their rate, a few compute at once;
//!    the threads of the others sleep in a queue. So shares do not depend on how the kernel orders
//!    many runnable threads, and a command to a waiting swarm wakes a sleeping thread. Users have equal
//!    numbers of turns, and take turns by the processor time that their swarms took if there are fewer
//!    turns. The waiters of a user are ordered by virtual time, the processor time that a swarm took
//!    while others of its user waited (start-time fair queueing), of which a swarm with a rate is charged
//!    a part (`PACED_WEIGHT`). The virtual time of a swarm that was idle is raised to that of the queue,
//!    so it gains nothing by it. A swarm that keeps its rate needs no turn while its virtual time is below
//!    that of its user's first waiter, and its user has taken less than the others whose swarms compute.
//!    Turns in plain FIFO order would give a swarm with long steps a larger share, since a turn ends
//!    between two steps.
//! 3. The kernel runs the thread: `set_niceness`, so that stepping delays no command, and swarms
//!    without a rate delay none with one.

mod clock;
mod pace;
mod queue;
#[cfg(test)]
mod tests;

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use parking_lot::{Mutex, MutexGuard};

use clock::thread_time;
pub use pace::{MAX_BACKLOG, Pace};
use queue::{Owner, Place, Queue, Waiter};

/// How long a swarm computes before the next one has its turn.
const TURN: Duration = Duration::from_millis(2);

/// Swarms that compute at once, for each core: while the kernel wakes one, another computes. While swarms
/// of several users compute, it is one.
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
    /// [`Queue::is_contended`], readable without the lock.
    is_contended: AtomicBool,
}

/// The share of one swarm. Dropping it gives up its turn or its place in the queue.
pub struct Share {
    scheduler: Arc<CpuScheduler>,
    owner: Owner,
    /// Its place while it waits.
    place: Place,
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

    fn with_turns(turns: usize) -> Self {
        CpuScheduler {
            queue: Mutex::new(Queue::new(turns, turns.div_ceil(TURNS_PER_CORE))),
            is_contended: AtomicBool::new(false),
        }
    }

    /// The share of a swarm, which belongs to a user or to nobody; `wake` wakes its thread.
    pub fn share(
        self: &Arc<Self>,
        owner: Option<&str>,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Share {
        let owner = owner.map(Arc::from);
        let mut queue = self.queue.lock();
        queue.account(&owner);
        self.unlock(queue, None);
        Share {
            scheduler: self.clone(),
            owner,
            place: Place::default(),
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

    /// Gives free turns to waiters, unlocks, and wakes those, and one that was called before.
    fn unlock(&self, mut queue: MutexGuard<'_, Queue>, called: Option<Arc<Waiter>>) {
        let further = queue.call();
        self.is_contended
            .store(queue.is_contended(), Ordering::Relaxed);
        drop(queue);
        for waiter in called.into_iter().chain(further) {
            (waiter.wake)();
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
                self.charge(&mut self.scheduler.clone().queue.lock());
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
        let scheduler = self.scheduler.clone();
        match std::mem::replace(&mut self.turn, Turn::None) {
            Turn::None => {}
            Turn::Running(_) => {
                let mut queue = scheduler.queue.lock();
                self.charge(&mut queue);
                queue.skip_uncontended_time(&self.owner, self.virtual_time);
                let called = queue.end_turn(&self.owner);
                scheduler.unlock(queue, called);
            }
            Turn::Waiting => {
                let mut queue = scheduler.queue.lock();
                let was_waiting = queue.remove(&self.owner, &self.place);
                // If it is not in the queue, it was called and has a turn that it does not need.
                let called = (!was_waiting).then(|| {
                    self.waiter.is_called.store(false, Ordering::Release);
                    queue.end_turn(&self.owner)
                });
                scheduler.unlock(queue, called.flatten());
            }
        }
    }

    /// Whether no swarm waits, or those that wait have taken more, and the other users, too.
    fn within_budget(&mut self) -> bool {
        let scheduler = self.scheduler.clone();
        if !scheduler.is_contended.load(Ordering::Relaxed) {
            self.charged = None;
            return true;
        }
        let mut queue = scheduler.queue.lock();
        let of_others = queue.least_taken_of_others(&self.owner);
        let account = queue.account(&self.owner);
        let first = account.first();
        if let Some(first) = first {
            self.virtual_time = self.virtual_time.max(first.saturating_sub(TURN));
        }
        if let Some(taken) = of_others {
            account.taken = account.taken.max(taken.saturating_sub(TURN));
        }
        self.charge(&mut queue);
        let taken = queue.account(&self.owner).taken;
        first.is_none_or(|first| self.virtual_time < first) && of_others.is_none_or(|it| taken < it)
    }

    /// Takes a free turn, or enters the queue.
    fn request_turn(&mut self, now: Instant) -> bool {
        let scheduler = self.scheduler.clone();
        let mut queue = scheduler.queue.lock();
        self.virtual_time = queue.raise(&self.owner, self.virtual_time);
        let is_free = queue.take_turn(&self.owner);
        match is_free {
            true => self.start_turn(now),
            false => self.enqueue(&mut queue),
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
        let scheduler = self.scheduler.clone();
        let mut queue = scheduler.queue.lock();
        self.charge(&mut queue);
        queue.skip_uncontended_time(&self.owner, self.virtual_time);
        if !queue.must_yield(&self.owner, self.virtual_time) {
            self.turn = Turn::Running(now);
            return true;
        }
        self.enqueue(&mut queue);
        let called = queue.end_turn(&self.owner);
        scheduler.unlock(queue, called);
        false
    }

    fn enqueue(&mut self, queue: &mut Queue) {
        self.place = queue.enqueue(&self.owner, self.virtual_time, self.waiter.clone());
        self.turn = Turn::Waiting;
    }

    /// Adds the processor time that its thread has taken since the last call.
    fn charge(&mut self, queue: &mut Queue) {
        let total = thread_time();
        let before = self.charged.replace(total).unwrap_or(total);
        let taken = total.saturating_sub(before);
        queue.charge(&self.owner, taken);
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
