//! Finds finished runs whose files are missing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use super::error::FolderError;
use super::list::{Entry, read_runs};
use super::series::raw_file;
use super::{FinishedRuns, Folder};
use crate::plan::Plan;
use crate::series::SeriesKind;
use crate::subset::Subset;
use crate::trajectory::trajectory_file;

/// The finished runs of a folder of which files are missing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MissingFiles {
    /// The number of finished runs whose files exist.
    pub finished: usize,
    /// The runs that lack files.
    pub runs: Subset,
    /// The runs that the list does not have.
    pub unlisted: Subset,
    /// The version of the model that executed them.
    pub model_version: u32,
}

impl MissingFiles {
    /// Returns whether the list has runs, with their files or without.
    #[must_use]
    pub fn has_runs(&self) -> bool {
        self.finished > 0 || !self.runs.indices().is_empty()
    }

    /// Returns those of an experiment all of whose runs were finished: what the list does not have was
    /// there, too.
    #[must_use]
    pub fn of_finished(self) -> Self {
        let (runs, unlisted) = (self.runs.indices(), self.unlisted.indices());
        Self {
            runs: Subset::of([runs, unlisted].concat()),
            unlisted: Subset::of(Vec::new()),
            ..self
        }
    }
}

impl Folder {
    /// Finds the finished runs of a folder of which files are missing. Does not lock the folder.
    ///
    /// # Errors
    ///
    /// [`FolderError`].
    pub fn missing_files(path: &Path, plan: &Plan) -> Result<MissingFiles, FolderError> {
        let list = read_runs(path, plan)?;
        let lacking = lacking(path, plan, &list.finished);
        let runs = 0..plan.runs().len();
        let unlisted = runs.filter(|index| !list.finished.contains_key(index));
        Ok(MissingFiles {
            unlisted: Subset::of(unlisted.collect()),
            finished: list.finished.len() - lacking.len(),
            runs: Subset::of(lacking.into_iter().collect()),
            model_version: list.model_version,
        })
    }

    /// Returns whether a finished run lacks files, by its index in the plan.
    #[must_use]
    pub fn lacks_files(path: &Path, plan: &Plan, finished: &FinishedRuns, index: usize) -> bool {
        let entry = finished.entries.get(&index).cloned();
        let of_run = entry.into_iter().map(|entry| (index, entry)).collect();
        !lacking(path, plan, &of_run).is_empty()
    }
}

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
