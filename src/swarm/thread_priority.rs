//! Scheduling attributes of a swarm's thread.
//!
//! Steps must yield to commands and readers, so swarm threads run at a lower priority (niceness).
//! With a lower priority alone a thread waits behind every running thread when it wakes, which takes
//! milliseconds while the daemon sends to a thousand sessions. A short slice makes the scheduler run
//! it soon after it wakes and does not change its share of the cores.

use std::io;

/// Added niceness of a swarm's thread, so that stepping delays no command and no reader.
const NICENESS: i32 = 5;

/// Requested slice in nanoseconds: the minimum that Linux accepts; the default is some
/// milliseconds. From Linux 6.12 on, EEVDF runs a thread with a shorter slice sooner.
const SLICE_NANOS: u64 = 100_000;

/// Gives the calling thread the niceness and the slice of a swarm's thread.
///
/// # Errors
///
/// The error of `sched_setattr`, such as a missing permission.
#[expect(unsafe_code, reason = "rustix and nix do not wrap sched_setattr")]
pub fn short_slice() -> io::Result<()> {
    let attributes = libc::sched_attr {
        size: u32::try_from(size_of::<libc::sched_attr>()).map_err(io::Error::other)?,
        sched_policy: libc::SCHED_OTHER.cast_unsigned(),
        sched_flags: 0,
        sched_nice: NICENESS,
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
    use std::thread;

    use super::*;

    /// A field of `/proc/thread-self/sched`, which only kernels with `SCHED_DEBUG` have.
    fn field(name: &str) -> Option<u64> {
        let text = read_to_string("/proc/thread-self/sched").unwrap_or_default();
        let line = text.lines().find(|line| line.starts_with(name))?;
        line.rsplit(' ').next()?.parse().ok()
    }

    #[test]
    fn a_thread_has_the_niceness_and_slice_that_it_asked_for() {
        let thread = thread::spawn(|| {
            short_slice().unwrap();
            let niceness = rustix::process::getpriority_process(None).unwrap();
            (niceness, field("se.slice"))
        });
        let (niceness, slice) = thread.join().unwrap();
        assert_eq!(niceness, NICENESS);
        assert!(slice.is_none_or(|it| it == SLICE_NANOS), "{slice:?}");
    }
}
