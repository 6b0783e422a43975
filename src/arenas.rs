//! How many heaps the C library keeps apart.
//!
//! glibc has up to eight for each core, spreads threads over them, and what is freed in one of them
//! is of no use in another and seldom goes back to the system. Here threads come and go, most of
//! them asleep: their heaps would grow to many times of what is in use.

use std::num::NonZero;
use std::thread::available_parallelism;

/// Keeps as many as there are cores. To be called before the first thread is started; says whether
/// the library agrees.
#[cfg(target_env = "gnu")]
#[expect(unsafe_code, reason = "no library has this call")]
pub fn keep_few() -> bool {
    let cores = available_parallelism().map_or(1, NonZero::get);
    let count = libc::c_int::try_from(cores).unwrap_or(libc::c_int::MAX);
    // SAFETY: the call takes two numbers, and sets one of the library's own.
    unsafe { libc::mallopt(libc::M_ARENA_MAX, count) == 1 }
}

/// Other libraries keep one, or see to it themselves.
#[cfg(not(target_env = "gnu"))]
pub fn keep_few() -> bool {
    true
}
