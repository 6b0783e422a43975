//! Reads the folder of a part of an experiment, to copy its runs into another folder.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use blake3::Hash;
use jostle_physics::observables::Definitions;
use jostle_results::table::series::for_each_part;
use jostle_results::table::trajectory;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;

use super::LOCK;
use super::error::{FolderError, io_error};
use super::lacking::lacking;
use super::list::{Entry, RUNS, read_runs};
use super::series::{SeriesSource, find, read, settle};
use crate::digest::Digests;
use crate::files::{EXPERIMENT, Files};
use crate::plan::Plan;
use crate::run::FinishedRun;
use crate::series::{MAX_INLINE, SeriesKind, bytes_of};
use crate::trajectory::Trajectories;

/// Read access to the folder of a part. Files are opened for each read: with many parts, open files
/// would exceed the limit of the process.
pub struct Part {
    path: PathBuf,
    model_version: u32,
    definitions: Definitions,
    finished: BTreeMap<usize, Entry>,
    lacking: BTreeSet<usize>,
}

impl Part {
    /// Returns whether a folder contains an experiment's file or results.
    pub fn is_part(folder: &Path) -> bool {
        [EXPERIMENT, RUNS]
            .iter()
            .any(|name| folder.join(name).exists())
    }

    /// Reads the experiment's files of a folder.
    ///
    /// # Errors
    ///
    /// [`FolderError`].
    pub fn files(folder: &Path) -> Result<Files, FolderError> {
        Files::stored(folder).map_err(|error| match error.source.kind() {
            io::ErrorKind::NotFound if folder.is_dir() && !folder.join(EXPERIMENT).exists() => {
                FolderError::NoResults {
                    folder: folder.to_owned(),
                }
            }
            _ => error.into(),
        })
    }

    /// Reads the folder of a part of `plan`.
    ///
    /// # Errors
    ///
    /// [`FolderError`]; also if another process writes to the folder.
    pub fn read(folder: &Path, plan: &Plan) -> Result<Self, FolderError> {
        let _lock = lock_shared(folder)?;
        let list = read_runs(folder, plan)?;
        Ok(Self {
            path: folder.to_owned(),
            model_version: list.model_version,
            definitions: list.definitions(folder)?,
            lacking: lacking(folder, plan, &list.finished),
            finished: list.finished,
        })
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns whether it has finished runs, with their files or without.
    pub fn has_runs(&self) -> bool {
        !self.finished.is_empty()
    }

    /// Returns the version of the model that executed its runs.
    pub fn model_version(&self) -> u32 {
        self.model_version
    }

    /// Returns the definitions of measures of its runs.
    pub fn definitions(&self) -> Definitions {
        self.definitions
    }

    /// Returns the indices of its finished runs in the plan, in ascending order, without those of which
    /// files are missing.
    pub fn finished(&self) -> Vec<usize> {
        let finished = self.finished.keys().copied();
        finished.filter(|it| !self.lacking.contains(it)).collect()
    }

    /// Returns the indices of its finished runs of which files are missing.
    pub fn lacking(&self) -> &BTreeSet<usize> {
        &self.lacking
    }

    /// Returns whether a run is finished and has a row.
    pub fn has_row(&self, index: usize) -> bool {
        let entry = self.finished.get(&index);
        entry.is_some_and(|entry| entry.record.row.is_some())
    }

    /// Reads the result of a finished run, as `execute_run_from` returns it with [`Digests`], and the
    /// digests of what is too long for it.
    ///
    /// # Errors
    ///
    /// [`FolderError`]; also if the run is not finished.
    pub fn result(
        &self,
        plan: &Plan,
        index: usize,
    ) -> Result<(FinishedRun, [Hash; 3]), FolderError> {
        let entry = self.entry(index)?;
        let record = entry.record.clone();
        let digests = Digests::default();
        let mut short = [None, None];
        for kind in SeriesKind::ALL {
            if !kind.is_in(plan) || record.row.is_none() {
                continue;
            }
            let source = find(&self.path, plan, index, kind, entry);
            if let SeriesSource::File(path) = &source {
                for_each_part(path, |rows| {
                    digests.add_series(kind, rows);
                    Ok(())
                })?;
                continue;
            }
            let series = read(&self.path, plan, (index, kind), &source)?;
            match bytes_of(&series) > MAX_INLINE {
                true => digests.add_series(kind, &series),
                false => short[kind as usize] = Some(series),
            }
        }
        if plan.record_every.is_some() && record.row.is_some() {
            let path = Trajectories::of(&self.path).path(index);
            trajectory::for_each_part(&path, |rows| digests.add_trajectory(rows))?;
        }
        let [order, series] = short;
        let finished = FinishedRun {
            row: record.row,
            fault: record.fault,
            order,
            series,
            touch: record.touch,
            // Here no run is executed in a folder.
            files: BTreeMap::new(),
        };
        Ok((finished, digests.finish()))
    }

    /// Returns the line of a finished run for the list of the folder `to`, and copies the files of its
    /// series there.
    ///
    /// # Errors
    ///
    /// [`FolderError`]; also if the run is not finished.
    pub fn copy(&self, plan: &Plan, index: usize, to: &Path) -> Result<Vec<u8>, FolderError> {
        settle((&self.path, to), plan, index, self.entry(index)?)
    }

    fn entry(&self, index: usize) -> Result<&Entry, FolderError> {
        self.finished.get(&index).ok_or_else(|| {
            let path = self.path.join(RUNS);
            io_error(&path, io::ErrorKind::NotFound.into())
        })
    }
}

/// Returns the folders of parts in `folders`: each of these, or its subfolders with results if it has
/// no results itself.
///
/// # Errors
///
/// [`FolderError::Io`].
pub fn parts_in(folders: &[PathBuf]) -> Result<Vec<PathBuf>, FolderError> {
    let mut parts = Vec::new();
    for folder in folders {
        let is_hidden = |it: &PathBuf| {
            let name = it.file_name().unwrap_or_default();
            name.as_encoded_bytes().starts_with(b".")
        };
        let mut inner = results_in(folder)?;
        inner.retain(|it| it == folder || !is_hidden(it));
        // A folder without any is returned, and the caller's error names it.
        if inner.is_empty() {
            inner.push(folder.clone());
        }
        parts.append(&mut inner);
    }
    parts.sort();
    Ok(parts)
}

/// Returns the folders of results in `folder`, sorted: itself, or its subfolders with results if it has no
/// results itself, also unfinished ones, whose names are hidden.
///
/// # Errors
///
/// [`FolderError::Io`].
pub fn results_in(folder: &Path) -> Result<Vec<PathBuf>, FolderError> {
    let fail = |source| io_error(folder, source);
    if has_runs(folder)? {
        return Ok(vec![folder.to_owned()]);
    }
    let mut results = Vec::new();
    for entry in fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        if has_runs(&path)? {
            results.push(path);
        }
    }
    results.sort();
    Ok(results)
}

/// Returns whether a folder contains a list of runs; an error if that cannot be read.
fn has_runs(folder: &Path) -> Result<bool, FolderError> {
    match folder.join(RUNS).try_exists() {
        Err(error) if error.kind() == io::ErrorKind::NotADirectory => Ok(false),
        exists => exists.map_err(|source| io_error(folder, source)),
    }
}

/// Takes a shared lock on a folder. Returns [`FolderError::InUse`] if another process holds the
/// exclusive lock.
fn lock_shared(folder: &Path) -> Result<Option<File>, FolderError> {
    let path = folder.join(LOCK);
    let lock = match File::open(&path) {
        Ok(lock) => lock,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(io_error(&path, source)),
    };
    match flock(&lock, FlockOperation::NonBlockingLockShared) {
        Ok(()) => Ok(Some(lock)),
        Err(Errno::WOULDBLOCK) => Err(FolderError::InUse {
            folder: folder.to_owned(),
        }),
        Err(error) => Err(io_error(&path, error.into())),
    }
}
