//! Work that may be shared among the threads of a pool that somebody handed over.
//!
//! Sizes alone decide what is cut into which parts, and in which order anything is summed:
//! threads decide when it is done, and no bit of it.

use std::hint::spin_loop;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::yield_now;

use rayon::ThreadPool;

/// From how many individuals on a pool is used. Waking its threads takes some 50 µs, and where
/// the direct sum takes 300, with 1000 individuals, two threads save nothing yet.
pub const SHARED_FROM: usize = 1500;

/// How often what is waited for is looked at before others may have the processor: it is
/// nearly always there within microseconds.
const LOOKS: usize = 1000;

/// Threads that somebody else started.
#[derive(Clone, Debug)]
pub struct Pool(Arc<ThreadPool>);

impl Pool {
    /// Takes a pool as it is; any others may use it too.
    #[must_use]
    pub fn new(pool: Arc<ThreadPool>) -> Self {
        Self(pool)
    }

    /// Takes `parts` through as many rounds as they are, round r the parts 0 to r in their order.
    ///
    /// Every thread takes the next round with a `scratch` of its own, and waits for a part until
    /// the round before has left it. So each part sees its rounds in their order, and each
    /// round its parts, whoever does the `work(scratch, round, index of the part, part)`.
    pub fn rounds<P: Send, S>(
        &self,
        parts: impl Iterator<Item = P>,
        scratch: impl Fn() -> S + Sync,
        work: impl Fn(&mut S, usize, usize, &mut P) + Sync,
    ) {
        // A part with the round whose turn it is: the first is that of its own number.
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

/// Does `work`, in `pool` if there is one.
pub fn inside<R: Send>(pool: Option<&Pool>, work: impl FnOnce() -> R + Send) -> R {
    match pool {
        Some(pool) => pool.0.install(work),
        None => work(),
    }
}

/// Does both, where `shared` at once if a thread is free; otherwise the one, then the other.
#[inline]
pub fn both(shared: bool, one: impl FnOnce() + Send, other: impl FnOnce() + Send) {
    if shared {
        rayon::join(one, other);
    } else {
        one();
        other();
    }
}

/// Waits until something `is_so` that another thread is at.
fn wait_until(is_so: impl Fn() -> bool) {
    loop {
        for _ in 0..LOOKS {
            if is_so() {
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
    fn every_part_sees_its_rounds_in_order_and_every_round_its_parts() {
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
