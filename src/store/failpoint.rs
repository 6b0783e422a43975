//! Failpoints that kill the process or make a commit fail.

use std::path::Path;

use fail::fail_point;
use rustix::process::{Signal, getpid, kill_process};

use super::error::StoreFault;

/// Kills the process with SIGKILL when the failpoint `name` is set to `return`.
pub(super) fn kill(name: &'static str) {
    fail_point!(name, |_| {
        let _ = kill_process(getpid(), Signal::KILL);
    });
}

/// The fault that a test sets for commits in `folder`. `return` sets it for every store,
/// `return(NAME)` for the store whose folder has this name, so that parallel tests do not interfere.
pub(super) fn commit_fault(folder: &Path) -> Option<StoreFault> {
    let applies = |name: Option<String>| {
        name.is_none_or(|name| folder.file_name().is_some_and(|folder| *folder == *name))
    };
    if full().is_some_and(applies) {
        return Some(StoreFault::Full);
    }
    if fsync().is_some_and(applies) {
        return Some(StoreFault::Fatal("a failpoint failed fsync".to_string()));
    }
    None
}

fn full() -> Option<Option<String>> {
    fail_point!("store-full", Some);
    None
}

fn fsync() -> Option<Option<String>> {
    fail_point!("store-fsync", Some);
    None
}
