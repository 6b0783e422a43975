//! Whether this process was suspended: by SIGSTOP, or with its machine.
//!
//! While something depends on that ([`watch`]), the thread `heartbeat` reads the clock every `INTERVAL`. If
//! more than `MAX_GAP` has passed since it was read last, the process did not run meanwhile. Another thread
//! may run before the heartbeat does after such a gap: therefore [`resumed`] reads the clock, too. The clock
//! goes on while the machine is suspended, and cannot be set. All daemons in a process share the heartbeat.

use std::thread;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use rustix::time::{ClockId, clock_gettime};
use tracing::warn;

/// The time between two readings of the clock.
const INTERVAL: Duration = Duration::from_millis(100);

/// The longest time between two readings in a process that was not suspended. Others notice the absence of a
/// daemon after 2.3 s to 3 s, the lease of its connections, and may serve its names then.
const MAX_GAP: Duration = Duration::from_secs(1);

/// How long after a suspension clients may take to connect again. They notice it when their lease of 3 s
/// ends, and retry at least every 4 s.
pub const GRACE: Duration = Duration::from_secs(10);

static HEARTBEAT: Mutex<Heartbeat> = Mutex::new(Heartbeat {
    watchers: 0,
    is_beating: false,
    clock: Clock {
        read_at: Duration::ZERO,
        resumed: None,
    },
});

struct Heartbeat {
    watchers: usize,
    /// Whether the thread runs.
    is_beating: bool,
    clock: Clock,
}

struct Clock {
    /// When it was read last, since the machine started.
    read_at: Duration,
    /// The end of the last suspension.
    resumed: Option<Instant>,
}

/// Keeps the heartbeat going until it is dropped.
#[derive(Debug)]
pub struct Watch(());

/// Detects suspensions from now on.
pub fn watch() -> Watch {
    let mut heartbeat = HEARTBEAT.lock();
    if heartbeat.watchers == 0 {
        heartbeat.clock.read_at = since_start();
    }
    heartbeat.watchers += 1;
    if !heartbeat.is_beating {
        let beating = thread::Builder::new().name("heartbeat".into()).spawn(beat);
        match beating {
            Ok(_) => heartbeat.is_beating = true,
            // Without the thread, a call more than a second after the last one reports a suspension.
            Err(error) => warn!(%error, "failed to start the heartbeat"),
        }
    }
    Watch(())
}

/// When the process resumed after it was last suspended, if it was while that was watched.
pub fn resumed() -> Option<Instant> {
    let (gap, resumed) = {
        let mut heartbeat = HEARTBEAT.lock();
        (heartbeat.read(), heartbeat.clock.resumed)
    };
    report(gap);
    resumed
}

/// When the process resumed, if that was within the last [`GRACE`].
pub fn resumed_within_grace() -> Option<Instant> {
    resumed().filter(|resumed| resumed.elapsed() < GRACE)
}

impl Drop for Watch {
    fn drop(&mut self) {
        HEARTBEAT.lock().watchers -= 1;
    }
}

fn beat() {
    loop {
        let gap = {
            let mut heartbeat = HEARTBEAT.lock();
            if heartbeat.watchers == 0 {
                heartbeat.is_beating = false;
                return;
            }
            heartbeat.read()
        };
        report(gap);
        thread::sleep(INTERVAL);
    }
}

/// Logs a suspension. Not while the heartbeat is locked, since the log may block.
fn report(gap: Option<Duration>) {
    if let Some(gap) = gap {
        warn!(secs = gap.as_secs_f64(), "the daemon was suspended");
    }
}

impl Heartbeat {
    fn read(&mut self) -> Option<Duration> {
        match self.watchers {
            0 => None,
            _ => self.clock.read(Instant::now(), since_start()),
        }
    }
}

impl Clock {
    /// Reads the clock, and returns for how long the process was suspended, if it was.
    fn read(&mut self, now: Instant, since_start: Duration) -> Option<Duration> {
        let gap = since_start.saturating_sub(self.read_at);
        self.read_at = since_start;
        if gap <= MAX_GAP {
            return None;
        }
        self.resumed = Some(now);
        Some(gap)
    }
}

/// The time since the machine started.
fn since_start() -> Duration {
    let time = clock_gettime(ClockId::Boottime);
    // It is never negative.
    Duration::try_from(time).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_above_a_second_is_a_suspension_that_ends_when_the_clock_is_read() {
        let (began, start) = (Instant::now(), Duration::from_secs(500));
        let mut clock = Clock {
            read_at: start,
            resumed: None,
        };
        let mut read = |millis: u64| {
            let passed = Duration::from_millis(millis);
            clock.read(began + passed, start + passed);
            clock.resumed.map(|at| (at - began).as_millis())
        };
        assert_eq!(read(100), None);
        assert_eq!(read(1100), None);
        assert_eq!(read(2101), Some(2101));
        assert_eq!(read(2201), Some(2101));
        assert_eq!(read(9000), Some(9000));
    }
}
