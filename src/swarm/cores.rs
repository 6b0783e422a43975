//! The cores, shared among swarms that have more to compute than there is time for.
//!
//! Of those that are behind a few compute at once; the others sleep until they are called, whoever
//! has computed least first. So shares do not depend on how the system orders many threads that all
//! want to run, and whoever asks one of them for something wakes a sleeping thread instead of
//! waiting for all. A swarm that keeps to its rate needs no leave, until it has computed more than
//! those who wait.
//!
//! The order is that of start-time fair queueing: who has nothing to do saves nothing up, and what is
//! computed while nobody waits is not held against anybody.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};

/// How long a swarm computes before another has its turn.
const TURN: Duration = Duration::from_millis(2);

/// Swarms that compute at once, for each core: while one is woken, another is at work.
const PER_CORE: usize = 2;

/// The cores of one daemon.
pub struct Cores {
    turns: Mutex<Turns>,
    /// How long the first of those that wait has computed, in nanoseconds, to be read without
    /// waiting for anybody; [`NOBODY`] if none does.
    first_waiting: AtomicU64,
}

const NOBODY: u64 = u64::MAX;

struct Turns {
    free: usize,
    /// Those that sleep until it is their turn, by how long they have computed and when they asked.
    waiting: BTreeMap<(Duration, u64), Arc<Called>>,
    /// How long the one that was called last had computed, or whoever did while nobody waited.
    reached: Duration,
    asked: u64,
}

/// Whether it is a swarm's turn, and how to wake it.
struct Called {
    is_called: AtomicBool,
    wake: Box<dyn Fn() + Send + Sync>,
}

/// One swarm's place among the others. It takes no core until it asks, and dropped it leaves.
pub struct Seat {
    cores: Arc<Cores>,
    /// The number of its place among those waiting.
    asked: u64,
    called: Arc<Called>,
    has: Has,
    /// Processor time it has taken while others waited.
    computed: Duration,
    /// The processor time of its thread when that was last added to.
    counted: Option<Duration>,
}

/// What a swarm has.
enum Has {
    Nothing,
    /// It is among those waiting, or was called since.
    AskedFor,
    /// A core, since then.
    Core(Instant),
}

impl Cores {
    /// So many cores.
    pub fn new(count: usize) -> Self {
        Cores::for_turns(PER_CORE * count.max(1))
    }

    fn for_turns(free: usize) -> Self {
        Cores {
            turns: Mutex::new(Turns {
                free,
                waiting: BTreeMap::new(),
                reached: Duration::ZERO,
                asked: 0,
            }),
            first_waiting: AtomicU64::new(NOBODY),
        }
    }

    /// A place for a swarm, whose thread `wake` wakes when it is its turn.
    pub fn seat(self: &Arc<Self>, wake: impl Fn() + Send + Sync + 'static) -> Seat {
        Seat {
            cores: self.clone(),
            asked: 0,
            called: Arc::new(Called {
                is_called: AtomicBool::new(false),
                wake: Box::new(wake),
            }),
            has: Has::Nothing,
            computed: Duration::ZERO,
            counted: None,
        }
    }

    fn lock(&self) -> MutexGuard<'_, Turns> {
        // Nothing under the lock can panic halfway.
        self.turns.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes who is first, and wakes who was called.
    fn unlock(&self, turns: MutexGuard<'_, Turns>, next: Option<Arc<Called>>) {
        let first = turns.waiting.first_key_value();
        let first = first.map_or(NOBODY, |((computed, _), _)| nanos(*computed));
        self.first_waiting.store(first, Ordering::Relaxed);
        drop(turns);
        if let Some(called) = next {
            (called.wake)();
        }
    }
}

impl Turns {
    /// Calls the one that has computed least, which is then to be woken; without one a core is
    /// free.
    fn pass_on(&mut self) -> Option<Arc<Called>> {
        let Some(((computed, _), called)) = self.waiting.pop_first() else {
            self.free += 1;
            return None;
        };
        self.reached = self.reached.max(computed);
        called.is_called.store(true, Ordering::Release);
        Some(called)
    }

    /// Nobody is held back by what was computed while nobody waited.
    fn note(&mut self, computed: Duration) {
        if self.waiting.is_empty() {
            self.reached = self.reached.max(computed);
        }
    }
}

impl Seat {
    /// Whether the swarm may compute now. If not it is called when it may, and asks again.
    pub fn may_compute(&mut self, now: Instant, is_behind: bool) -> bool {
        match self.has {
            Has::Core(since) if now.saturating_duration_since(since) < TURN => true,
            Has::Core(_) => self.let_others(now),
            Has::AskedFor => {
                let is_called = self.called.is_called.swap(false, Ordering::AcqRel);
                if is_called {
                    self.has = Has::Core(now);
                    self.counted = Some(thread_time());
                }
                is_called
            }
            Has::Nothing => (!is_behind && self.needs_no_leave()) || self.ask(now),
        }
    }

    /// Whether nobody waits for a core: what takes a moment needs none.
    pub fn is_needless(&self) -> bool {
        self.cores.first_waiting.load(Ordering::Relaxed) == NOBODY
    }

    /// Needs no core for now.
    pub fn leave(&mut self) {
        match std::mem::replace(&mut self.has, Has::Nothing) {
            Has::Nothing => {}
            Has::Core(_) => {
                self.count();
                let mut turns = self.cores.lock();
                turns.note(self.computed);
                let next = turns.pass_on();
                self.cores.unlock(turns, next);
            }
            Has::AskedFor => {
                let mut turns = self.cores.lock();
                let was_waiting = turns.waiting.remove(&(self.computed, self.asked));
                // Who no longer waits was called, and has a core it does not need.
                let next = was_waiting.is_none().then(|| {
                    self.called.is_called.store(false, Ordering::Release);
                    turns.pass_on()
                });
                self.cores.unlock(turns, next.flatten());
            }
        }
    }

    /// Whether nobody waits, or whoever does has computed more.
    fn needs_no_leave(&mut self) -> bool {
        let first = self.cores.first_waiting.load(Ordering::Relaxed);
        if first == NOBODY {
            self.counted = None;
            return true;
        }
        let first = Duration::from_nanos(first);
        self.computed = self.computed.max(first.saturating_sub(TURN));
        self.count();
        self.computed < first
    }

    /// Takes a core that is free, or waits for one.
    fn ask(&mut self, now: Instant) -> bool {
        let cores = self.cores.clone();
        let mut turns = cores.lock();
        // What it did not compute while others did is not made good later.
        self.computed = self.computed.max(turns.reached);
        let is_free = turns.free > 0;
        if is_free {
            turns.free -= 1;
            self.has = Has::Core(now);
            self.counted = Some(thread_time());
        } else {
            self.queue(&mut turns);
        }
        cores.unlock(turns, None);
        is_free
    }

    /// Its turn is over; unless nobody has computed less.
    fn let_others(&mut self, now: Instant) -> bool {
        self.count();
        let cores = self.cores.clone();
        let mut turns = cores.lock();
        turns.note(self.computed);
        let first = turns.waiting.first_key_value();
        if first.is_none_or(|((computed, _), _)| self.computed < *computed) {
            self.has = Has::Core(now);
            return true;
        }
        self.queue(&mut turns);
        let next = turns.pass_on();
        cores.unlock(turns, next);
        false
    }

    fn queue(&mut self, turns: &mut Turns) {
        turns.asked += 1;
        self.asked = turns.asked;
        let place = (self.computed, self.asked);
        turns.waiting.insert(place, self.called.clone());
        self.has = Has::AskedFor;
    }

    /// Adds what its thread has computed since this was last done.
    fn count(&mut self) {
        let total = thread_time();
        let before = self.counted.replace(total).unwrap_or(total);
        self.computed += total.saturating_sub(before);
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.leave();
    }
}

/// Processor time that this thread has taken.
fn thread_time() -> Duration {
    Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).unwrap_or_default()
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(NOBODY - 1)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::sync::mpsc::{Receiver, channel};
    use std::thread;

    use super::*;

    fn seat(cores: &Arc<Cores>) -> (Seat, Receiver<()>) {
        let (call, called) = channel();
        let seat = cores.seat(move || {
            let _ = call.send(());
        });
        (seat, called)
    }

    #[test]
    fn no_more_compute_than_there_are_cores_and_who_leaves_calls_the_next() {
        let cores = Arc::new(Cores::for_turns(2));
        let now = Instant::now();
        let [mut a, mut b, mut c, mut d] = [(); 4].map(|()| seat(&cores));
        assert!(a.0.may_compute(now, true) && b.0.may_compute(now, true));
        assert!(!c.0.may_compute(now, true) && !d.0.may_compute(now, true));
        assert!(a.0.may_compute(now, true), "it is still its turn");
        a.0.leave();
        c.1.try_recv().unwrap();
        assert!(c.0.may_compute(now, true) && !d.0.may_compute(now, true));
        drop(b);
        assert!(d.0.may_compute(now, true));
        d.0.leave();
        c.0.leave();
        assert!(a.0.may_compute(now, true), "cores are free again");
        assert!(d.1.try_recv().is_ok() && d.1.try_recv().is_err());
    }

    #[test]
    fn who_was_called_and_leaves_calls_the_next() {
        let cores = Arc::new(Cores::for_turns(1));
        let now = Instant::now();
        let [mut a, mut b, mut c] = [(); 3].map(|()| seat(&cores));
        assert!(
            a.0.may_compute(now, true)
                && !b.0.may_compute(now, true)
                && !c.0.may_compute(now, true)
        );
        a.0.leave();
        b.0.leave();
        assert!(c.0.may_compute(now, true), "called when b left");
        assert!(!b.0.may_compute(now, true), "an old call is none");
        b.0.leave();
        c.0.leave();
        assert!(b.0.may_compute(now, true));
    }

    #[test]
    fn a_turn_ends_when_others_wait() {
        let cores = Arc::new(Cores::for_turns(1));
        let now = Instant::now();
        let [mut a, mut b] = [(); 2].map(|()| seat(&cores));
        assert!(a.0.may_compute(now, true));
        assert!(a.0.may_compute(now + 2 * TURN, true), "nobody waits");
        assert!(!b.0.may_compute(now + 2 * TURN, true));
        assert!(a.0.may_compute(now + 5 * TURN / 2, true), "its second turn");
        let spent = Instant::now();
        while spent.elapsed() < TURN {}
        assert!(!a.0.may_compute(now + 4 * TURN, true));
        assert!(b.0.may_compute(now + 4 * TURN, true));
    }

    #[test]
    fn who_keeps_to_its_rate_needs_no_leave_until_it_has_computed_more_than_those_who_wait() {
        let cores = Arc::new(Cores::for_turns(1));
        let now = Instant::now();
        let [mut a, mut b, mut c] = [(); 3].map(|()| seat(&cores));
        assert!(a.0.may_compute(now, true));
        assert!(c.0.may_compute(now, false), "nobody waits");
        b.0.computed = 10 * TURN;
        assert!(!b.0.may_compute(now, true));
        assert!(c.0.may_compute(now, false), "it has computed less");
        assert_eq!(c.0.computed, 9 * TURN, "though not for ever");
        c.0.computed = 11 * TURN;
        assert!(!c.0.may_compute(now, false));
        a.0.leave();
        assert!(b.0.may_compute(now, true) && !c.0.may_compute(now, false));
        b.0.leave();
        assert!(c.0.may_compute(now, false));
    }

    #[test]
    fn what_was_computed_while_nobody_waited_holds_nobody_back() {
        let cores = Arc::new(Cores::for_turns(1));
        let now = Instant::now();
        let [mut a, mut b, mut c] = [(); 3].map(|()| seat(&cores));
        assert!(a.0.may_compute(now, true));
        a.0.computed = 1000 * TURN;
        a.0.leave();
        assert!(b.0.may_compute(now, true) && !a.0.may_compute(now, true));
        assert!(!c.0.may_compute(now, true));
        b.0.leave();
        assert!(a.0.may_compute(now, true), "it asked before c");
    }

    #[test]
    fn shares_are_equal_however_long_a_step_is() {
        let cores = Arc::new(Cores::for_turns(1));
        let until = Instant::now() + 200 * TURN;
        let threads = [1, 3, 30].map(|length| {
            let (mut seat, called) = seat(&cores);
            thread::spawn(move || {
                let before = thread_time();
                while Instant::now() < until {
                    if seat.may_compute(Instant::now(), true) {
                        let end = thread_time() + length * TURN / 3;
                        while thread_time() < end {}
                    } else {
                        let _ = called.recv_timeout(TURN);
                    }
                }
                thread_time() - before
            })
        });
        let shares = threads.map(|it| it.join().unwrap());
        let (least, most) = (shares.iter().min().unwrap(), shares.iter().max().unwrap());
        assert!(*most - *least <= 30 * TURN, "{shares:?}");
        assert!(*least > 30 * TURN, "{shares:?}");
    }
}
