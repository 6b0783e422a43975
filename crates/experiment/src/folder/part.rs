//! Reads the folder of a part of an experiment, to copy its runs into another folder.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use jostle_physics::model::MODEL_VERSION;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;

use super::LOCK;
use super::error::{FolderError, io_error};
use super::lacking::lacking;
use super::list::{
    Entry, Line, RUNS, parse_runs, read_line, read_or_empty, read_order, read_series, to_line,
};
use crate::files::{EXPERIMENT, Files};
use crate::plan::Plan;
use crate::run::FinishedRun;

/// Read access to the folder of a part. Files are opened for each read: with many parts, open files
/// would exceed the limit of the process.
pub struct Part {
    path: PathBuf,
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
        let list = parse_runs(folder, plan, &read_or_empty(&folder.join(RUNS))?)?;
        if list.model_version != MODEL_VERSION {
            return Err(FolderError::OtherModel {
                folder: folder.to_owned(),
                theirs: list.model_version,
            });
        }
        Ok(Self {
            path: folder.to_owned(),
            lacking: lacking(folder, plan, &list.finished),
            finished: list.finished,
        })
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
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

    /// Reads the result of a finished run, as `execute_run` returns it.
    ///
    /// # Errors
    ///
    /// [`FolderError`]; also if the run is not finished.
    pub fn result(&self, plan: &Plan, index: usize) -> Result<FinishedRun, FolderError> {
        let line = self.line(plan, index)?;
        let record = self.finished[&index].record.clone();
        let has_row = record.row.is_some();
        let has_order = plan.order_every.is_some() && has_row;
        let order = has_order.then(|| read_order(&self.path, plan, index, &line));
        let has_series = plan.columns.series_every.is_some() && has_row;
        let series = has_series.then(|| read_series(&self.path, plan, index, &line));
        Ok(FinishedRun {
            row: record.row,
            fault: record.fault,
            order: order.transpose()?,
            series: series.transpose()?,
            touch: record.touch,
            files: record.files,
        })
    }

    /// Reads the line of a finished run, with its time series. Earlier versions stored the order
    /// over time in a separate file.
    ///
    /// # Errors
    ///
    /// [`FolderError`]; also if the run is not finished.
    pub fn line(&self, plan: &Plan, index: usize) -> Result<Vec<u8>, FolderError> {
        let Some(entry) = self.finished.get(&index) else {
            let path = self.path.join(RUNS);
            return Err(io_error(&path, io::ErrorKind::NotFound.into()));
        };
        let line = read_line(&self.path, &entry.line)?;
        if plan.order_every.is_none() || entry.record.row.is_none() || entry.record.has_order {
            return Ok(line);
        }
        let order = read_order(&self.path, plan, index, &line)?;
        Ok(to_line(&Line {
            record: &entry.record,
            order: Some(order.into()),
            // Earlier versions had no other series.
            series: None,
        }))
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
        let fail = |source| io_error(folder, source);
        let mut inner = Vec::new();
        if !has_runs(folder)? {
            for entry in fs::read_dir(folder).map_err(fail)? {
                let entry = entry.map_err(fail)?;
                let is_hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
                if !is_hidden && has_runs(&entry.path())? {
                    inner.push(entry.path());
                }
            }
        }
        // A folder without any is returned, and the caller's error names it.
        if inner.is_empty() {
            inner.push(folder.clone());
        }
        parts.append(&mut inner);
    }
    parts.sort();
    Ok(parts)
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
