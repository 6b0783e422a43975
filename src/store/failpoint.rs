//! Failpoints that make a commit fail.

use std::path::Path;

use fail::fail_point;

use super::error::StoreFault;

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
