//! Finds finished runs whose files are missing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use super::list::Entry;
use super::series::raw_file;
use crate::plan::Plan;
use crate::series::SeriesKind;
use crate::trajectory::trajectory_file;

/// Returns the finished runs of which a file is missing or has another length than its line says.
/// Lines of earlier versions have no lengths; their files must exist.
pub fn lacking(folder: &Path, plan: &Plan, finished: &BTreeMap<usize, Entry>) -> BTreeSet<usize> {
    let is_there = |path: &str, length: Option<u64>| {
        let file = fs::metadata(folder.join(path));
        file.is_ok_and(|file| file.is_file() && length.is_none_or(|it| it == file.len()))
    };
    let is_lacking = |&index: &usize| {
        let record = &finished[&index].record;
        let named = record
            .files
            .iter()
            .all(|(path, length)| is_there(path, Some(*length)));
        !named || unnamed(plan, index, &finished[&index]).any(|path| !is_there(&path, None))
    };
    finished.keys().copied().filter(is_lacking).collect()
}

/// Returns the files that a line of an earlier version does not name.
fn unnamed(plan: &Plan, index: usize, entry: &Entry) -> impl Iterator<Item = String> {
    let record = &entry.record;
    let has_row = record.row.is_some();
    let trajectory = (has_row && plan.record_every.is_some()).then(|| trajectory_file(index));
    let is_stored =
        record.order.is_some() || record.files.contains_key(&SeriesKind::Order.file(index));
    let has_raw_order = has_row && plan.order_every.is_some() && !is_stored;
    let order = has_raw_order.then(|| raw_file(index));
    let paths = trajectory.into_iter().chain(order);
    paths.filter(|path| !record.files.contains_key(path))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
