//! The processor time of a thread.

use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// Processor time of this thread.
pub(super) fn thread_time() -> Duration {
    #[cfg(test)]
    if let Some(time) = SIMULATED.get() {
        return time;
    }
    Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).unwrap_or_default()
}

#[cfg(test)]
thread_local! {
    static SIMULATED: std::cell::Cell<Option<Duration>> = const { std::cell::Cell::new(None) };
}

/// Sets the processor time of the simulated thread that this thread executes, if it does.
#[cfg(test)]
pub(super) fn simulate(thread_time: Option<Duration>) {
    SIMULATED.set(thread_time);
}
