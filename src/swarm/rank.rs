//! How a swarm's thread ranks among those that want the cores.
//!
//! Two things are told apart: how much of the cores it is given when there are not enough, and how
//! soon it runs once it wakes. It is to yield to commands and readers, and yet its steps, which take
//! microseconds, are to begin when they are due. By its niceness alone it would wait behind whatever
//! runs, and with a thousand sessions to send to that is milliseconds.
//!
//! So it asks for a short slice, which Linux from 6.12 on takes to mean soon. Where the daemon may
//! (as root, or with `CAP_SYS_NICE`), a swarm that keeps to a rate by short steps is also given a
//! small share of a core in advance, by a deadline (`SCHED_DEADLINE`): it then runs at once whatever
//! else does. The kernel sees to it that shares fit, and refuses what does not.

use std::io;
use std::time::{Duration, Instant};

/// How much lower than the rest of the daemon a swarm's thread ranks, so that stepping never keeps a
/// command or a reader waiting.
const NICENESS: i32 = 5;

/// The most that it runs before others may be asked, in nanoseconds: the least that Linux takes. Who
/// asks for less at a time comes sooner, and has no larger share; from Linux 6.12 on. Others ask for
/// some milliseconds.
const SLICE_NANOS: u64 = 100_000;

/// What a punctual swarm is given in advance: so much of each period, in nanoseconds. 38 of them
/// have a share on two cores.
const SHARE_NANOS: (u64, u64) = (500_000, 10_000_000);

/// The longest steps of a punctual swarm, and how many of them fit between two: all shares together
/// are so little in use that whoever has none hardly waits.
const SHORT: (Duration, u32) = (Duration::from_micros(250), 100);

/// How long a swarm that was not punctual, or had no share, does not ask for one again.
const PATIENCE: Duration = Duration::from_millis(100);

/// The rank of one swarm's thread, which alone settles it.
pub struct Rank {
    has_share: bool,
    asks_again: Option<Instant>,
    /// How long the last two steps took, the last first.
    steps: [Duration; 2],
}

impl Default for Rank {
    fn default() -> Self {
        Rank {
            has_share: false,
            asks_again: None,
            steps: [Duration::MAX; 2],
        }
    }
}

impl Rank {
    /// Notes how long a step took.
    pub fn stepped(&mut self, took: Duration) {
        self.steps = [took, self.steps[0]];
    }

    /// Has the thread rank as is right for a swarm whose steps are due so often, if they are due at
    /// all.
    pub fn settle(&mut self, period: Option<Duration>) {
        let (longest, fit) = SHORT;
        // One may have been held up by the machine.
        let step = self.steps[0].min(self.steps[1]);
        let is_punctual =
            step <= longest && period.is_some_and(|period| step.saturating_mul(fit) <= period);
        match (self.has_share, is_punctual) {
            (true, false) => self.yield_to_others(),
            (false, true) if self.asks_again.is_none_or(|at| at <= Instant::now()) => {
                self.has_share = share().is_ok();
                self.asks_again = Some(Instant::now() + PATIENCE);
            }
            _ => {}
        }
    }

    /// Gives back its share, since what comes may take long.
    pub fn yield_to_others(&mut self) {
        if self.has_share {
            let _ = soon();
            self.has_share = false;
            self.asks_again = Some(Instant::now() + PATIENCE);
        }
    }
}

/// Ranks the calling thread below the others, and so that it runs soon after it wakes.
///
/// # Errors
///
/// What the system says, which may not permit it.
pub fn soon() -> io::Result<()> {
    set(libc::SCHED_OTHER, 0, NICENESS, [SLICE_NANOS, 0, 0])
}

/// Has the calling thread run at once when it wakes, for a small share of a core; what nobody else
/// was given in advance it may use too. Threads that it starts rank as others.
fn share() -> io::Result<()> {
    let (runtime, period) = SHARE_NANOS;
    let flags = libc::SCHED_FLAG_RESET_ON_FORK | libc::SCHED_FLAG_RECLAIM;
    set(libc::SCHED_DEADLINE, flags, 0, [runtime, period, period])
}

#[expect(unsafe_code, reason = "no library has this call")]
fn set(
    policy: libc::c_int,
    flags: libc::c_int,
    niceness: i32,
    [runtime, deadline, period]: [u64; 3],
) -> io::Result<()> {
    let attributes = libc::sched_attr {
        size: u32::try_from(size_of::<libc::sched_attr>()).map_err(io::Error::other)?,
        sched_policy: policy.cast_unsigned(),
        sched_flags: u64::from(flags.cast_unsigned()),
        sched_nice: niceness,
        sched_priority: 0,
        sched_runtime: runtime,
        sched_deadline: deadline,
        sched_period: period,
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

    /// What the system tells of the calling thread. Told only by kernels built so.
    fn told(what: &str) -> Option<u64> {
        let told = read_to_string("/proc/thread-self/sched").unwrap_or_default();
        let line = told.lines().find(|line| line.starts_with(what))?;
        line.rsplit(' ').next()?.parse().ok()
    }

    #[test]
    fn a_thread_has_the_rank_that_it_asked_for() {
        let ranked = thread::spawn(|| {
            soon().unwrap();
            let niceness = rustix::process::getpriority_process(None).unwrap();
            (niceness, told("se.slice"))
        });
        let (niceness, slice) = ranked.join().unwrap();
        assert_eq!(niceness, NICENESS);
        assert!(slice.is_none_or(|it| it == SLICE_NANOS), "{slice:?}");
    }

    #[test]
    fn who_is_punctual_has_a_share_and_gives_it_back() {
        let ranked = thread::spawn(|| {
            let deadline = u64::from(libc::SCHED_DEADLINE.cast_unsigned());
            if let Err(error) = share() {
                return println!("skipped: {error}");
            }
            soon().unwrap();
            let has_share = || told("policy").is_none_or(|it| it == deadline);
            let has_none = || told("policy").is_none_or(|it| it != deadline);
            let [short, long, often] = [20, 1000, 20_000].map(Duration::from_micros);
            let mut rank = Rank::default();
            rank.settle(Some(often));
            rank.stepped(short);
            rank.settle(None);
            rank.settle(Some(50 * short));
            assert!(!rank.has_share && has_none());
            rank.settle(Some(often));
            assert!(rank.has_share && has_share());
            rank.stepped(long);
            rank.settle(Some(often));
            assert!(
                rank.has_share && has_share(),
                "one may have been held up by the machine"
            );
            rank.stepped(long);
            rank.settle(Some(often));
            assert!(!rank.has_share && has_none());
            let niceness = rustix::process::getpriority_process(None).unwrap();
            assert_eq!(niceness, NICENESS);
            rank.stepped(short);
            rank.settle(Some(often));
            assert!(!rank.has_share, "not so soon again");
            rank.asks_again = Some(Instant::now());
            rank.settle(Some(often));
            assert!(rank.has_share);
            rank.yield_to_others();
            assert!(!rank.has_share && has_none());
        });
        ranked.join().unwrap();
    }
}
