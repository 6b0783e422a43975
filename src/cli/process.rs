//! What is settled for the whole process before its first thread.

use std::env;
use std::num::NonZero;
use std::thread::available_parallelism;

/// Where zenoh reads how its threads are shared out.
const RUNTIMES: &str = "ZENOH_RUNTIME";

/// The threads that read from the bus also let clients in and watch every socket, and do what
/// routing leaves for later. With threads apart for these, as zenoh has them, a query wakes two more
/// before it is read, each of which takes longer than a step. What is sent leaves from a thread
/// apart still: whoever reads may have to wait for it.
const FEWER: &str = "(acc: (handover: rx), net: (handover: rx))";

/// Settles it, once, before the first thread is started. What could not be settled costs memory, and
/// nothing else.
pub fn settle() {
    let _ = keep_few_heaps();
    share_threads();
}

/// What is free at a heap's end goes back to the system from this size on, in bytes. Left alone,
/// glibc raises it to twice the largest thing that ever was freed.
#[cfg(target_env = "gnu")]
const MOST_FREE: libc::c_int = 256 * 1024;

/// What is as large as this lies apart from the heaps, in bytes: the columns of 130,000 individuals.
#[cfg(target_env = "gnu")]
const LARGE: libc::c_int = 1024 * 1024;

/// Has the C library keep as many heaps as there are cores, and no more in them than is in use;
/// says whether it agrees.
///
/// glibc has up to eight for each core, spreads threads over them, and what is freed in one of them
/// is of no use in another and seldom goes back to the system. Here threads come and go, most of
/// them asleep: their heaps would grow to many times of what is in use.
#[cfg(target_env = "gnu")]
#[expect(unsafe_code, reason = "no library has this call")]
fn keep_few_heaps() -> bool {
    let cores = available_parallelism().map_or(1, NonZero::get);
    let count = libc::c_int::try_from(cores).unwrap_or(libc::c_int::MAX);
    let settings = [
        (libc::M_ARENA_MAX, count),
        (libc::M_TRIM_THRESHOLD, MOST_FREE),
        (libc::M_MMAP_THRESHOLD, LARGE),
    ];
    settings.into_iter().all(|(which, value)| {
        // SAFETY: the call takes two numbers, and sets one of the library's own.
        unsafe { libc::mallopt(which, value) == 1 }
    })
}

/// Other libraries keep one, or see to it themselves.
#[cfg(not(target_env = "gnu"))]
fn keep_few_heaps() -> bool {
    true
}

/// Has zenoh keep fewer threads apart, unless somebody has told it otherwise.
#[expect(unsafe_code, reason = "zenoh takes it from the environment alone")]
fn share_threads() {
    if env::var_os(RUNTIMES).is_none() {
        // SAFETY: there is no other thread yet that could read the environment meanwhile.
        unsafe { env::set_var(RUNTIMES, FEWER) };
    }
}
