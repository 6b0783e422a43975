//! Why the folder of an experiment cannot be used.

use std::io;
use std::path::{Path, PathBuf};

use jostle_physics::model::MODEL_VERSION;
use jostle_results::table::TableError;
use thiserror::Error;

use super::EXPERIMENT;

/// Why a folder cannot be used.
#[derive(Debug, Error)]
pub enum FolderError {
    /// A system call failed.
    #[error("use {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A table could not be written.
    #[error(transparent)]
    Table(#[from] TableError),
    /// Another process has locked the folder.
    #[error("use {}: another process is running this experiment", folder.display())]
    InUse {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder contains results of another file.
    #[error(
        "use {}: it contains results of another experiment.toml; choose another folder, or \
         continue with that file", folder.display()
    )]
    OtherExperiment {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder contains results, but no `experiment.toml`.
    #[error(
        "use {}: it contains {file} but no {EXPERIMENT}; choose another folder", folder.display()
    )]
    NoExperiment {
        /// The folder.
        folder: PathBuf,
        /// The first file or folder of results that was found.
        file: &'static str,
    },
    /// The runs were computed with another version of the model, which gives other results for the
    /// same seeds.
    #[error(
        "use {}: its runs have model version {theirs}, this program has {MODEL_VERSION}; finish it \
         with the jostled that started it, or choose another folder", folder.display()
    )]
    OtherModel {
        /// The folder.
        folder: PathBuf,
        /// The model version of its runs.
        theirs: u32,
    },
    /// A line of the list of runs is damaged.
    #[error("read {}: line {line}: {reason}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
}

/// Returns the error of a system call on `path`.
pub fn io_error(path: &Path, source: io::Error) -> FolderError {
    FolderError::Io {
        path: path.to_owned(),
        source,
    }
}
