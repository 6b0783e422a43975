//! Named points where a test kills the process.

use fail::fail_point;
use rustix::process::{Signal, getpid, kill_process};

/// Dies here, as if by `kill -9`, when the fail point `name` is set to `return`.
pub(super) fn point(name: &'static str) {
    fail_point!(name, |_| {
        let _ = kill_process(getpid(), Signal::KILL);
    });
}
