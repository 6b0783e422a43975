//! Configuration of the process: allocator, zenoh's threads, file descriptors.

use std::env;
use std::num::NonZero;
use std::thread::available_parallelism;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tracing::warn;

/// The environment variable from which zenoh reads the configuration of its threads.
const RUNTIMES: &str = "ZENOH_RUNTIME";

/// zenoh's RX threads also accept connections, poll sockets and run deferred routing tasks. With
/// zenoh's default, a query wakes two more threads before it is read, and each wake-up takes longer
/// than a step. The TX thread stays separate, since RX threads may block on sending.
const SHARED_THREADS: &str = "(acc: (handover: rx), net: (handover: rx))";

/// Descriptors of the store, recordings, HTTP connections and wakers, beside one for each client.
const RESERVED_FILES: u64 = 500;

/// Configures the allocator and zenoh's threads. Called before the first thread is started.
pub fn configure_process() {
    // A rejected setting costs memory only.
    let _ = limit_arenas();
    share_threads();
}

/// Raises the limit on open files to the hard limit: each client takes one, and the soft limit is
/// often 1024.
pub fn raise_file_limit(max_clients: usize) {
    let limit = getrlimit(Resource::Nofile);
    let raised = Rlimit {
        current: limit.maximum,
        ..limit
    };
    if let Err(error) = setrlimit(Resource::Nofile, raised) {
        warn!(%error, "failed to raise the limit on open files");
    }
    let limit = getrlimit(Resource::Nofile).current;
    if limit.is_some_and(|files| files < max_clients as u64 + RESERVED_FILES) {
        warn!(
            limit,
            max_clients,
            "the limit on open files is too low: raise `ulimit -n`, or lower max_clients"
        );
    }
}

/// Free memory at the end of an arena is returned to the system from this size on, in bytes. By
/// default glibc raises this limit to twice the largest block freed so far.
#[cfg(target_env = "gnu")]
const TRIM_THRESHOLD: libc::c_int = 256 * 1024;

/// Blocks from this size on are mapped outside the arenas, in bytes: the columns of 130,000
/// individuals.
#[cfg(target_env = "gnu")]
const MMAP_THRESHOLD: libc::c_int = 1024 * 1024;

/// Limits the allocator to one arena per core; returns whether it accepts the settings.
///
/// By default glibc creates up to eight arenas per core. Memory freed in one arena is not reused by
/// others, and with many short-lived threads the arenas grow to several times the memory in use.
#[cfg(target_env = "gnu")]
#[expect(unsafe_code, reason = "no library has this call")]
fn limit_arenas() -> bool {
    let cores = available_parallelism().map_or(1, NonZero::get);
    let count = libc::c_int::try_from(cores).unwrap_or(libc::c_int::MAX);
    let settings = [
        (libc::M_ARENA_MAX, count),
        (libc::M_TRIM_THRESHOLD, TRIM_THRESHOLD),
        (libc::M_MMAP_THRESHOLD, MMAP_THRESHOLD),
    ];
    settings.into_iter().all(|(which, value)| {
        // SAFETY: the call takes two numbers and sets a parameter of the allocator.
        unsafe { libc::mallopt(which, value) == 1 }
    })
}

/// Other C libraries have no such parameters.
#[cfg(not(target_env = "gnu"))]
fn limit_arenas() -> bool {
    true
}

/// Sets [`SHARED_THREADS`], unless the variable is set.
#[expect(
    unsafe_code,
    reason = "zenoh reads this setting from the environment only"
)]
fn share_threads() {
    if env::var_os(RUNTIMES).is_none() {
        // SAFETY: no other thread is running that could read the environment.
        unsafe { env::set_var(RUNTIMES, SHARED_THREADS) };
    }
}
