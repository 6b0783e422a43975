//! Named points where a test kills the process, or makes a commit fail.

use std::path::Path;

use fail::fail_point;
use rustix::process::{Signal, getpid, kill_process};

use super::error::StoreFault;

/// Dies here, as if by `kill -9`, when the fail point `name` is set to `return`.
pub(super) fn point(name: &'static str) {
    fail_point!(name, |_| {
        let _ = kill_process(getpid(), Signal::KILL);
    });
}

/// How the commit in `folder` is to fail, if a test wants it to. `return` means every store,
/// `return(NAME)` the one whose folder has this name, so that tests beside it are left alone.
pub(super) fn commit(folder: &Path) -> Option<StoreFault> {
    let is_meant = |name: Option<String>| {
        name.is_none_or(|name| folder.file_name().is_some_and(|folder| *folder == *name))
    };
    if full().is_some_and(is_meant) {
        return Some(StoreFault::Full);
    }
    if fsync().is_some_and(is_meant) {
        return Some(StoreFault::Fatal("a test made fsync fail".to_string()));
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
