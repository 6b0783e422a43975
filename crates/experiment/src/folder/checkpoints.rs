//! Checkpoints of the runs that are being executed, in `checkpoints/` of the folder: a file for each.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::error::{FolderError, io_error};
use crate::run::RunCheckpoint;

const CHECKPOINTS: &str = "checkpoints";

/// The checkpoints of a folder. Each thread writes those of the runs that it executes.
#[derive(Clone, Debug)]
pub struct Checkpoints(PathBuf);

impl Checkpoints {
    pub(super) fn of(folder: &Path) -> Self {
        Self(folder.join(CHECKPOINTS))
    }

    /// Reads the checkpoint of a run, by its index in the plan. A checkpoint that is damaged or of
    /// another version is ignored: the run starts from its beginning, with the same result.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`].
    pub fn read(&self, index: usize) -> Result<Option<RunCheckpoint>, FolderError> {
        let path = self.path(index);
        match fs::read(&path) {
            Ok(bytes) => Ok(RunCheckpoint::from_bytes(&bytes)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(io_error(&path, source)),
        }
    }

    /// Returns whether a run has a checkpoint.
    pub(crate) fn has(&self, index: usize) -> bool {
        self.path(index).exists()
    }

    /// Replaces the checkpoint of a run. It is durable on return.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`]. The last checkpoint of the run is kept then.
    pub fn write(&self, index: usize, checkpoint: &RunCheckpoint) -> Result<(), FolderError> {
        fs::create_dir_all(&self.0).map_err(|source| io_error(&self.0, source))?;
        let path = self.path(index);
        jostle_atomic_file::write(&path, &checkpoint.to_bytes())
            .map_err(|source| io_error(&path, source))
    }

    /// Removes the checkpoint of a run, if there is one. One that cannot be removed does no harm.
    pub fn remove(&self, index: usize) {
        let _ = fs::remove_file(self.path(index));
    }

    /// Removes all checkpoints, also those that were being written when a process was killed.
    pub fn clear(&self) {
        let _ = fs::remove_dir_all(&self.0);
    }

    fn path(&self, index: usize) -> PathBuf {
        self.0.join(format!("{index:06}.cbor"))
    }
}
