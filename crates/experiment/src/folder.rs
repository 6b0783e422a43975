//! The folder of an experiment's results. A finished run survives a crash.
//!
//! A folder contains:
//!
//! - `experiment.toml`, a copy of the experiment's file, and `experiment.points.csv`, and
//!   `experiment.start.snapshot`, copies of the files that it names;
//! - `runs.jsonl`, a header and a line for each finished run, with its order over time if the plan
//!   has `order_every`, and its measures over time if it has `series_every`, unless these are long; a
//!   run counts as finished once its line is durable;
//! - `orders/` and `series/`, with a file for each finished run whose order or measures over time are
//!   long, and the rows of unfinished ones;
//! - `order/`, in folders of earlier versions, which stored the order over time there;
//! - the tables, written from these: `results.parquet`, `results.csv`, `order.parquet`,
//!   `series.parquet` and `touch.csv`;
//! - `trajectories/`, with a file for each finished run if the plan has `record_every`, and the frames of
//!   unfinished ones;
//! - `checkpoints/`, from which unfinished runs continue;
//! - `lock`, which a process that writes to the folder holds exclusively.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{OsStr, OsString};
use std::fs::{self, File, OpenOptions};
use std::io::{BufWriter, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use jostle_physics::model::MODEL_VERSION;
use jostle_physics::observables::Definitions;
use jostle_results::ResultRow;
use jostle_results::table::order::ORDER_NAME;
use jostle_results::table::series::SERIES_NAME;
use jostle_results::table::trajectory::TRAJECTORIES;
use jostle_results::table::{CSV_NAME, PARQUET_NAME, Series};
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;

pub use self::checkpoints::Checkpoints;
use self::copy::parent;
pub use self::error::FolderError;
use self::error::io_error;
pub use self::lacking::MissingFiles;
use self::lacking::lacking;
use self::list::{Entry, Header, List, RUNS, Record, read_model_version, read_runs, to_line};
pub use self::part::{Part, parts_in, results_in};
use self::series::RAW;
pub use self::series::SeriesSource;
use crate::files::{EXPERIMENT, Files};
use crate::plan::Plan;
use crate::run::FinishedRun;
use crate::series::{SeriesKind, bytes_of, remove_spools, remove_spools_of};
use crate::subset::Subset;
use crate::trajectory::Trajectories;

mod checkpoints;
pub(crate) mod copy;
pub(crate) mod error;
mod lacking;
mod list;
mod part;
pub(crate) mod series;
mod stored;
mod tables;

const LOCK: &str = "lock";

/// The finished runs of a folder that is read without a lock.
#[derive(Clone, Debug)]
pub struct FinishedRuns {
    /// The rows, in the plan's order.
    pub rows: Vec<ResultRow>,
    /// The version of the model that executed them. Only runs of [`MODEL_VERSION`] can be executed
    /// again.
    pub model_version: u32,
    /// The finished runs by their index in the plan; their rows are above.
    entries: BTreeMap<usize, Entry>,
}

/// The folder of an experiment, locked for writing.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    definitions: Definitions,
    runs: File,
    /// The length of the list of runs, in bytes.
    length: u64,
    /// The finished runs by their index in the plan.
    finished: BTreeMap<usize, Entry>,
    /// Those of which files are missing: they count as unfinished.
    lacking: BTreeSet<usize>,
    /// The lock is released when this file is closed.
    _lock: File,
}

impl Folder {
    /// Opens and locks the folder of an experiment, or creates it. An incomplete last line of the
    /// list of runs is removed. An experiment that another version of the model has begun, and of which no run
    /// is finished, starts from its beginning.
    ///
    /// # Errors
    ///
    /// [`FolderError`]. Results in the folder are then unchanged.
    pub fn open(path: &Path, plan: &Plan) -> Result<Self, FolderError> {
        Self::open_of(path, plan, MODEL_VERSION)
    }

    /// Opens the folder as [`Self::open`], for runs that `model_version` has executed.
    pub(crate) fn open_of(
        path: &Path,
        plan: &Plan,
        model_version: u32,
    ) -> Result<Self, FolderError> {
        fs::create_dir_all(path).map_err(|source| io_error(path, source))?;
        let lock = lock(path)?;
        claim(path, plan)?;
        let file = path.join(RUNS);
        let fail = |source| io_error(&file, source);
        let mut list = read_runs(path, plan)?;
        let starts_over = list.model_version != model_version && list.finished.is_empty();
        if starts_over {
            list = List::empty(plan);
        } else {
            list.check_model(path, model_version)?;
        }
        let definitions = list.definitions(path)?;
        let list = series::settle_all(path, plan, list)?;
        let mut length = list.length;
        let mut runs = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&file)
            .map_err(fail)?;
        // A run whose line is incomplete is not finished.
        runs.set_len(length).map_err(fail)?;
        runs.seek(SeekFrom::End(0)).map_err(fail)?;
        if length == 0 {
            let header = Header {
                experiment: plan.name.clone(),
                model_version,
                definitions: definitions.number(),
            };
            let line = to_line(&header);
            runs.write_all(&line).map_err(fail)?;
            length = line.len() as u64;
        }
        runs.sync_all().map_err(fail)?;
        sync_folder(path)?;
        let folder = Self {
            path: path.to_owned(),
            definitions,
            runs,
            length,
            lacking: lacking(path, plan, &list.finished),
            finished: list.finished,
            _lock: lock,
        };
        if starts_over {
            folder.clear();
        }
        Ok(folder)
    }

    /// Returns the version of the model that executed its runs; none if no experiment has begun in it.
    #[must_use]
    pub fn model_version(path: &Path) -> Option<u32> {
        read_model_version(path)
    }

    /// Reads the finished runs, also those of another version of the model, and those of which files
    /// are missing. Does not lock the folder: another process may append runs meanwhile.
    ///
    /// # Errors
    ///
    /// [`FolderError`].
    pub fn read(path: &Path, plan: &Plan) -> Result<FinishedRuns, FolderError> {
        let mut list = read_runs(path, plan)?;
        let entries = list.finished.values_mut();
        let rows = entries.filter_map(|entry| entry.record.row.take());
        Ok(FinishedRuns {
            rows: rows.collect(),
            model_version: list.model_version,
            entries: list.finished,
        })
    }

    /// Returns the path of the trajectory of a run, by its index in the plan.
    #[must_use]
    pub fn trajectory_path(path: &Path, index: usize) -> PathBuf {
        Trajectories::of(path).path(index)
    }

    /// The path of the folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The definitions of measures under which its runs are executed: those with which it began.
    #[must_use]
    pub fn definitions(&self) -> Definitions {
        self.definitions
    }

    /// Returns whether a run is finished and its files exist, by its index in the plan.
    #[must_use]
    pub fn is_finished(&self, index: usize) -> bool {
        self.finished.contains_key(&index) && !self.lacking.contains(&index)
    }

    /// Returns the runs that were finished and of which files are missing. They are executed again.
    #[must_use]
    pub fn lacking(&self) -> Subset {
        Subset::of(self.lacking.iter().copied().collect())
    }

    /// Returns the rows of the finished runs, in the plan's order, also of those of which files are
    /// missing.
    #[must_use]
    pub fn rows(&self) -> Vec<ResultRow> {
        rows(&self.finished)
    }

    /// Returns the checkpoints of its unfinished runs.
    #[must_use]
    pub fn checkpoints(&self) -> Checkpoints {
        Checkpoints::of(&self.path)
    }

    /// Returns the trajectories of its runs.
    #[must_use]
    pub(crate) fn trajectories(&self) -> Trajectories {
        Trajectories::of(&self.path)
    }

    /// Returns the length of the list of runs, in bytes.
    #[must_use]
    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// Removes the rows of unfinished runs without a checkpoint, which start again.
    pub(crate) fn remove_unused(&self) {
        remove_unused(&self.path);
    }

    /// Removes the frames of unfinished runs without a checkpoint, of a folder that no process writes to.
    ///
    /// # Errors
    ///
    /// [`FolderError::InUse`] and [`FolderError::Io`]: the folder is unchanged.
    pub fn sweep(path: &Path) -> Result<(), FolderError> {
        let series = SeriesKind::ALL.map(SeriesKind::folder);
        let mut folders = series.into_iter().chain([TRAJECTORIES]);
        if !folders.any(|folder| path.join(folder).exists()) {
            return Ok(());
        }
        let _lock = lock(path)?;
        remove_unused(path);
        Ok(())
    }

    /// Returns the names of the runs of a subset that ended early, each with its reason.
    #[must_use]
    pub fn faults(&self, subset: &Subset) -> Vec<(String, String)> {
        let runs = subset.indices().iter();
        let runs = runs.filter(|index| self.is_finished(**index));
        let records = runs.map(|index| self.finished.get(index));
        let faults = records.flatten().filter_map(|Entry { record, .. }| {
            let fault = record.fault.as_ref()?;
            Some((record.run.clone(), fault.clone()))
        });
        faults.collect()
    }

    /// Appends finished runs, each with its index in the plan. They are durable on return.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`]. None of them counts as finished then.
    pub fn append(
        &mut self,
        plan: &Plan,
        batch: Vec<(usize, FinishedRun)>,
    ) -> Result<(), FolderError> {
        let mut lines = Vec::new();
        let mut entries = Vec::with_capacity(batch.len());
        let indices: Vec<usize> = batch.iter().map(|(index, _)| *index).collect();
        for (index, finished) in batch {
            let bytes = |series: &Option<Series>| series.as_ref().map(bytes_of);
            let record = Record {
                run: plan.runs()[index].name.clone(),
                fault: finished.fault,
                row: finished.row,
                touch: finished.touch,
                files: finished.files,
                order: bytes(&finished.order),
                series: bytes(&finished.series),
            };
            let start = self.length + lines.len() as u64;
            lines.extend(series::line(&record, [finished.order, finished.series]));
            let line = start..self.length + lines.len() as u64;
            entries.push((index, Entry { record, line }));
        }
        let written = self.runs.write_all(&lines);
        let synced = written.and_then(|()| self.runs.sync_data());
        if let Err(source) = synced {
            // A line that was written in part is not finished: the next one replaces it.
            let _ = self.runs.set_len(self.length);
            let _ = self.runs.seek(SeekFrom::Start(self.length));
            return Err(io_error(&self.path.join(RUNS), source));
        }
        self.length += lines.len() as u64;
        self.finished.extend(entries);
        let (checkpoints, trajectories) = (self.checkpoints(), self.trajectories());
        for index in indices {
            self.lacking.remove(&index);
            checkpoints.remove(index);
            trajectories.remove_spool(index);
            remove_spools_of(&self.path, index);
        }
        Ok(())
    }

    /// Appends lines that were copied from other folders of the plan, after the files that they name,
    /// and parses all lines again. They are durable on return.
    ///
    /// # Errors
    ///
    /// [`FolderError`]. The caller must discard the folder.
    pub fn append_copies(
        &mut self,
        plan: &Plan,
        lines: impl Iterator<Item = Result<Vec<u8>, FolderError>>,
    ) -> Result<(), FolderError> {
        let path = self.path.join(RUNS);
        let fail = |source| io_error(&path, source);
        let mut writer = BufWriter::new(&self.runs);
        for line in lines {
            writer.write_all(&line?).map_err(fail)?;
        }
        writer.flush().map_err(fail)?;
        drop(writer);
        self.runs.sync_data().map_err(fail)?;
        let list = read_runs(&self.path, plan)?;
        self.lacking = lacking(&self.path, plan, &list.finished);
        (self.finished, self.length) = (list.finished, list.length);
        Ok(())
    }

    /// Returns the number of finished runs whose files exist.
    #[must_use]
    pub fn finished(&self) -> usize {
        self.finished.len() - self.lacking.len()
    }

    /// Removes a folder that no process writes to, with everything in it.
    ///
    /// # Errors
    ///
    /// [`FolderError::InUse`] and [`FolderError::Io`].
    pub fn discard(path: &Path) -> Result<(), FolderError> {
        let _lock = lock(path)?;
        fs::remove_dir_all(path).map_err(|source| io_error(path, source))
    }

    /// Renames the folder to `path`, where there must be no file and no folder but an empty one. The
    /// new name is durable on return. Remaining checkpoints are removed.
    ///
    /// # Errors
    ///
    /// [`FolderError::Rename`] and [`FolderError::Io`]. The folder keeps its name, unless only the sync of the parent failed.
    pub fn rename(&mut self, path: &Path) -> Result<(), FolderError> {
        self.clear();
        sync_folder(&self.path)?;
        fs::rename(&self.path, path).map_err(|source| FolderError::Rename {
            from: self.path.clone(),
            to: path.to_owned(),
            source,
        })?;
        path.clone_into(&mut self.path);
        sync_folder(parent(path))
    }

    /// Removes checkpoints and what unfinished runs have recorded.
    pub(crate) fn clear(&self) {
        self.checkpoints().clear();
        self.trajectories().remove_spools(|_| true);
        remove_spools(&self.path, |_| true);
    }
}

fn remove_unused(folder: &Path) {
    let checkpoints = Checkpoints::of(folder);
    let is_unused = |index| !checkpoints.has(index);
    Trajectories::of(folder).remove_spools(is_unused);
    remove_spools(folder, is_unused);
}

/// Locks a folder until the returned file is closed.
fn lock(folder: &Path) -> Result<File, FolderError> {
    let path = folder.join(LOCK);
    let fail = |source| io_error(&path, source);
    let lock = OpenOptions::new()
        .create(true)
        .truncate(false)
        .write(true)
        .open(&path)
        .map_err(fail)?;
    match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(lock),
        Err(Errno::WOULDBLOCK) => Err(FolderError::InUse {
            folder: folder.to_owned(),
        }),
        Err(error) => Err(fail(error.into())),
    }
}

/// Checks that the folder belongs to the plan's file. If the folder has no results, writes the
/// file.
fn claim(folder: &Path, plan: &Plan) -> Result<(), FolderError> {
    match Files::stored(folder) {
        Ok(files) if files == plan.files => Ok(()),
        Ok(_) => Err(FolderError::OtherExperiment {
            folder: folder.to_owned(),
        }),
        Err(_) if !folder.join(EXPERIMENT).exists() => {
            let names = [RUNS, PARQUET_NAME, CSV_NAME, ORDER_NAME, SERIES_NAME, RAW];
            if let Some(file) = names.into_iter().find(|name| folder.join(name).exists()) {
                let folder = folder.to_owned();
                return Err(FolderError::NoExperiment { folder, file });
            }
            Ok(plan.files.store(folder)?)
        }
        Err(error) => Err(error.into()),
    }
}

fn rows(finished: &BTreeMap<usize, Entry>) -> Vec<ResultRow> {
    let entries = finished.values();
    entries
        .filter_map(|entry| entry.record.row.clone())
        .collect()
}

/// Makes the entries of a folder durable.
fn sync_folder(path: &Path) -> Result<(), FolderError> {
    let synced = File::open(path).and_then(|folder| folder.sync_all());
    synced.map_err(|source| io_error(path, source))
}

/// Returns where the folder `path` is written before it is renamed: beside it, with a name that
/// patterns such as `part-*` do not match. `label` distinguishes what is written.
#[must_use]
pub fn unfinished(path: &Path, label: &str) -> PathBuf {
    let mut name = OsString::from(jostle_atomic_file::PREFIX);
    name.push(path.file_name().unwrap_or(OsStr::new("results")));
    name.push(format!(".{label}"));
    parent(path).join(name)
}

/// Returns the folder that [`unfinished`] writes in `path`; `path` itself if it is no such folder.
#[must_use]
pub fn finished(path: &Path) -> PathBuf {
    let name = path.file_name().and_then(OsStr::to_str);
    let name = name.and_then(|it| it.strip_prefix(jostle_atomic_file::PREFIX));
    match name.and_then(|it| it.rsplit_once('.')) {
        Some((name, _)) => match parent(path) {
            here if here == Path::new(".") => PathBuf::from(name),
            parent => parent.join(name),
        },
        None => path.to_owned(),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod fixture;

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod definitions;

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod models;
