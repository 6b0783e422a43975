//! Failpoints at which a test kills the process.

use fail::fail_point;
use rustix::process::{Signal, getpid, kill_process};

/// Sends SIGKILL to this process if the failpoint `name` is set to `return`.
pub(crate) fn kill(name: &'static str) {
    fail_point!(name, |_| {
        let _ = kill_process(getpid(), Signal::KILL);
    });
}
