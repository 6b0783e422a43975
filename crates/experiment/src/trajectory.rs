//! The trajectories of runs, in `trajectories/` of the folder: a Parquet file for each run.
//!
//! While a run is executed its frames are appended to a file without a format of its own, the spool: a
//! Parquet file has no end from which it could be continued. A checkpoint of the run has the length and
//! the hash of the spool, to which a resumed run truncates it. At the end of the run the spool is converted. It is
//! removed once the run counts as finished.

use std::cell::RefCell;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use jostle_physics::model::State;
use jostle_results::table::trajectory::{TRAJECTORIES, file_name};

use self::about::about;
use self::spool::Spool;
pub use self::spool::frame;
use crate::disk::DiskWatch;
use crate::folder::FolderError;
use crate::folder::copy::copy;
use crate::folder::error::io_error;
use crate::plan::{Plan, PlannedRun};
use crate::run::RunCheckpoint;

mod about;
mod spool;

/// Returns the path of the trajectory of a run in a folder of results, by its index in the plan.
pub fn trajectory_file(index: usize) -> String {
    format!("{TRAJECTORIES}/{}", file_name(index + 1))
}

/// The trajectories of a folder. Each thread writes those of the runs that it executes.
#[derive(Clone, Debug)]
pub struct Trajectories(PathBuf);

impl Trajectories {
    /// Returns those of a folder of results.
    pub fn of(folder: &Path) -> Self {
        Self(folder.join(TRAJECTORIES))
    }

    /// Returns the path of the trajectory of a run, by its index in the plan.
    #[must_use]
    pub fn path(&self, index: usize) -> PathBuf {
        self.0.join(file_name(index + 1))
    }

    /// Returns the path of the spool of a run.
    fn spool(&self, index: usize) -> PathBuf {
        self.path(index).with_extension("partial")
    }

    /// Removes the spool of a run, if there is one. One that cannot be removed does no harm.
    pub fn remove_spool(&self, index: usize) {
        let _ = fs::remove_file(self.spool(index));
    }

    /// Removes the spools of runs that `is_unused`, by their index in the plan, and files that were
    /// being written when a process was killed.
    pub fn remove_spools(&self, is_unused: impl Fn(usize) -> bool) {
        remove_spools_in(&self.0, is_unused);
    }

    /// Copies the trajectory of a run from those of another folder. It is durable on return.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`].
    pub fn copy(&self, from: &Self, index: usize) -> Result<(), FolderError> {
        copy(&from.path(index), &self.path(index))
    }

    /// Begins to record a run, or continues after a checkpoint, which is dropped if the spool lacks
    /// frames before it or is damaged. None if the plan records no trajectories.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`].
    pub fn record(
        &self,
        plan: &Plan,
        index: usize,
        checkpoint: &mut Option<RunCheckpoint>,
    ) -> Result<Option<Recording>, FolderError> {
        if plan.record_every.is_none() {
            return Ok(None);
        }
        fs::create_dir_all(&self.0).map_err(|source| io_error(&self.0, source))?;
        let path = self.spool(index);
        let fail = |source| io_error(&path, source);
        let mut spool = Spool::open(&path).map_err(fail)?;
        let is_kept = match checkpoint {
            Some(RunCheckpoint {
                recorded: Some(length),
                hashes,
                ..
            }) => spool
                .keep(&path, *length, hashes.frames.as_ref())
                .map_err(fail)?,
            _ => false,
        };
        if !is_kept {
            *checkpoint = None;
        }
        Ok(Some(Recording {
            spool: RefCell::new((spool, Ok(()))),
            path,
            target: self.path(index),
        }))
    }
}

/// Removes the spools of a folder from which no run continues, and files that were being written when
/// a process was killed. One that cannot be removed does no harm.
pub fn remove_spools_in(folder: &Path, is_unused: impl Fn(usize) -> bool) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for path in entries.flatten().map(|entry| entry.path()) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_spool_unused = name
            .strip_suffix(".partial")
            .is_some_and(|stem| index_of(stem).is_none_or(&is_unused));
        if name.starts_with(jostle_atomic_file::PREFIX) || is_spool_unused {
            let _ = fs::remove_file(path);
        }
    }
}

/// Returns the index of a run in the plan by the name of its file without the extension.
fn index_of(stem: &str) -> Option<usize> {
    let number: usize = stem.strip_prefix("run-")?.parse().ok()?;
    number.checked_sub(1)
}

/// The recording of a run that is executed.
pub struct Recording {
    /// The spool, and the first error of writing it.
    spool: RefCell<(Spool, io::Result<()>)>,
    path: PathBuf,
    target: PathBuf,
}

impl Recording {
    /// Appends the frame of a state. After an error nothing more is written.
    pub fn add(&self, state: &State) {
        let (spool, written) = &mut *self.spool.borrow_mut();
        if written.is_ok() {
            *written = spool.add(state);
        }
    }

    /// Returns whether a frame could not be written.
    pub fn has_failed(&self) -> bool {
        self.spool.borrow().1.is_err()
    }

    /// Makes the frames durable and returns the length of the spool; none if one could not be written.
    pub fn sync(&self) -> Option<u64> {
        let (spool, written) = &mut *self.spool.borrow_mut();
        match spool.sync() {
            Ok(length) if written.is_ok() => Some(length),
            Ok(_) => None,
            Err(error) => {
                *written = Err(error);
                None
            }
        }
    }

    /// Returns the length of the spool.
    pub fn length(&self) -> u64 {
        self.spool.borrow().0.length()
    }

    /// Returns the hash of the spool.
    pub fn hash(&self) -> String {
        self.spool.borrow().0.hash().hex()
    }

    /// Ends the recording of a run that is finished: writes its file and returns its length in bytes,
    /// or none for a run that has no row. Returns none in place of both if the disk space ended before:
    /// there is no file then.
    ///
    /// # Errors
    ///
    /// [`FolderError`] if it cannot be written, or one of the frames could not.
    pub fn finish(
        self,
        plan: &Plan,
        run: &PlannedRun,
        has_row: bool,
        disk: Option<&DiskWatch>,
    ) -> Result<Option<Option<u64>>, FolderError> {
        self.check()?;
        if !has_row {
            return Ok(Some(None));
        }
        let (mut spool, _) = self.spool.into_inner();
        spool
            .flush()
            .and_then(|()| spool.hash().check(&self.path))
            .map_err(|source| io_error(&self.path, source))?;
        let removed = jostle_atomic_file::remove_unfinished(&self.target);
        removed.map_err(|source| io_error(&self.target, source))?;
        let mut copied = 0;
        let has_room = |bytes| {
            copied += bytes;
            disk.is_none_or(|disk| disk.add(bytes))
        };
        let is_written = spool::convert(&self.path, &self.target, &about(plan, run), has_room)?;
        let written = match is_written {
            true => {
                let written = fs::metadata(&self.target);
                let written = written.map_err(|source| io_error(&self.target, source))?;
                Some(written.len())
            }
            false => None,
        };
        if let Some(disk) = disk {
            disk.remove(copied);
            if let Some(written) = written {
                // The spool is removed once the run counts as finished.
                disk.remove(spool.length());
                disk.add(written);
            }
        }
        Ok(written.map(Some))
    }

    /// Returns the error of a frame that could not be written.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`].
    pub fn check(&self) -> Result<(), FolderError> {
        let (_, written) = &*self.spool.borrow();
        written.as_ref().copied().map_err(|error| {
            let source = io::Error::new(error.kind(), error.to_string());
            io_error(&self.path, source)
        })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
