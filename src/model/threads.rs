//! Work that may be shared among the threads of a pool that somebody handed over.
//!
//! Sizes alone decide what is cut into which parts, and in which order anything is summed:
//! threads decide when it is done, and no bit of it.

use std::hint::spin_loop;
use std::thread::yield_now;

use rayon::ThreadPool;

/// From how many individuals on a pool is used. Waking its threads takes some 50 µs, and where
/// the direct sum takes 300, with 1000 individuals, two threads save nothing yet.
pub const SHARED_FROM: usize = 1500;

/// Does `work`, in `pool` if there is one.
pub fn inside<R: Send>(pool: Option<&ThreadPool>, work: impl FnOnce() -> R + Send) -> R {
    match pool {
        Some(pool) => pool.install(work),
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

/// How often what is waited for is looked at before others may have the processor: it is
/// nearly always there within microseconds.
const LOOKS: usize = 1000;

/// Waits until something `is_so` that another thread is at.
pub fn wait_until(is_so: impl Fn() -> bool) {
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
