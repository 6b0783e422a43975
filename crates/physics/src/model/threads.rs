//! Work that is shared among the threads of a pool that the caller passes.
//!
//! The division into parts and the order of every sum depend only on sizes. So the number and the
//! timing of threads change no bit of a result.

use std::hint::spin_loop;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::yield_now;

use rayon::ThreadPool;

/// Minimum number of individuals for which a pool is used. Waking its threads takes about 50 µs;
/// with 1000 individuals, where the direct sum takes 300 µs, two threads save nothing.
pub const SHARED_FROM: usize = 1500;

/// Number of checks of a condition before the thread yields the processor. The condition nearly
/// always holds within microseconds.
const MAX_SPINS: usize = 1000;

/// A thread pool that the caller started.
#[derive(Clone, Debug)]
pub struct Pool(Arc<ThreadPool>);

impl Pool {
    /// Wraps a pool, which the caller may use for other work too.
    #[must_use]
    pub fn new(pool: Arc<ThreadPool>) -> Self {
        Self(pool)
    }

    /// Processes `parts` in as many rounds as parts; round r processes the parts 0 to r in order.
    ///
    /// A thread takes the next round, creates a `scratch` for it, and waits before each part until
    /// the previous round has finished that part. Rounds of a part run in order, and parts of a
    /// round too, on any thread: each is `work(scratch, round, index of the part, part)`.
    pub fn rounds<P: Send, S>(
        &self,
        parts: impl Iterator<Item = P>,
        scratch: impl Fn() -> S + Sync,
        work: impl Fn(&mut S, usize, usize, &mut P) + Sync,
    ) {
        // Each part with the round that processes it next; the first is that of its own index.
        let parts: Vec<(AtomicUsize, Mutex<P>)> = (0..)
            .zip(parts)
            .map(|(own, part)| (AtomicUsize::new(own), Mutex::new(part)))
            .collect();
        let taken = AtomicUsize::new(0);
        self.0.broadcast(|_| {
            loop {
                let round = taken.fetch_add(1, Ordering::Relaxed);
                let Some(parts) = parts.get(..=round) else {
                    return;
                };
                let mut scratch = scratch();
                for (index, (turn, part)) in parts.iter().enumerate() {
                    wait_until(|| turn.load(Ordering::Acquire) == round);
                    let mut part = part.lock().expect("no round panics");
                    work(&mut scratch, round, index, &mut part);
                    turn.store(round + 1, Ordering::Release);
                }
            }
        });
    }
}

/// Runs `work`, in `pool` if one is given.
pub fn inside<R: Send>(pool: Option<&Pool>, work: impl FnOnce() -> R + Send) -> R {
    match pool {
        Some(pool) => pool.0.install(work),
        None => work(),
    }
}

/// Runs both closures: in parallel if `shared` and a thread is free, otherwise `one`, then `other`.
#[inline]
pub fn both(shared: bool, one: impl FnOnce() + Send, other: impl FnOnce() + Send) {
    if shared {
        rayon::join(one, other);
    } else {
        one();
        other();
    }
}

/// Waits until a condition `holds` that another thread establishes.
fn wait_until(holds: impl Fn() -> bool) {
    loop {
        for _ in 0..MAX_SPINS {
            if holds() {
                return;
            }
            spin_loop();
        }
        yield_now();
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use rayon::ThreadPoolBuilder;

    use super::*;

    #[test]
    fn rounds_of_a_part_and_parts_of_a_round_are_in_order() {
        for threads in [1, 2, 4] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build();
            let pool = Pool::new(Arc::new(pool.unwrap()));
            for count in [0, 1, 2, 30] {
                let mut parts = vec![Vec::new(); count];
                let work = |seen: &mut usize, round, index, part: &mut &mut Vec<usize>| {
                    assert_eq!(*seen, index);
                    *seen += 1;
                    part.push(round);
                };
                pool.rounds(parts.iter_mut(), || 0, work);
                for (own, part) in parts.iter().enumerate() {
                    assert_eq!(*part, (own..count).collect::<Vec<_>>());
                }
            }
        }
    }
}
