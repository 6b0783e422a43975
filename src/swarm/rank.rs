//! How a swarm's thread ranks among those that want the cores.
//!
//! Two things are told apart: how much of the cores it is given when there are not enough, and how
//! soon it runs once it wakes. It is to yield to commands and readers, and yet its steps, which take
//! microseconds, are to begin when they are due. By its niceness alone it would wait behind whatever
//! runs, and with a thousand sessions to send to that is milliseconds.

use std::io;

/// The most that it runs before others may be asked, in nanoseconds: the least that Linux takes. Who
/// asks for less at a time comes sooner, and has no larger share; from Linux 6.12 on. Others ask for
/// some milliseconds.
const SLICE_NANOS: u64 = 100_000;

/// Ranks the calling thread by its niceness, and so that it runs soon after it wakes.
///
/// # Errors
///
/// What the system says, which may not permit it.
#[expect(unsafe_code, reason = "no library has this call")]
#[expect(clippy::cast_possible_truncation, reason = "a few bytes")]
pub fn rank(niceness: i32) -> io::Result<()> {
    let attributes = libc::sched_attr {
        size: size_of::<libc::sched_attr>() as u32,
        sched_policy: libc::SCHED_OTHER as u32,
        sched_flags: 0,
        sched_nice: niceness,
        sched_priority: 0,
        sched_runtime: SLICE_NANOS,
        sched_deadline: 0,
        sched_period: 0,
    };
    // SAFETY: the call reads as many bytes of `attributes` as its first field says, and no more; zero
    // is the calling thread, and there are no flags.
    let answer = unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0) };
    match answer {
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

    #[test]
    fn a_thread_has_the_rank_that_it_asked_for() {
        let ranked = thread::spawn(|| {
            rank(7).unwrap();
            let niceness = rustix::process::getpriority_process(None).unwrap();
            // Told only by kernels built so.
            let told = read_to_string("/proc/thread-self/sched").unwrap_or_default();
            let slice = told.lines().find(|line| line.starts_with("se.slice"));
            (niceness, slice.map(str::to_owned))
        });
        let (niceness, slice) = ranked.join().unwrap();
        assert_eq!(niceness, 7);
        println!("{slice:?}");
        if let Some(slice) = slice {
            assert!(slice.ends_with(" 100000"), "{slice}");
        }
    }
}
