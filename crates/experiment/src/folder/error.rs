//! Why the folder of an experiment cannot be used.

use std::io;
use std::path::{Path, PathBuf};

use jostle_physics::model::MODEL_VERSION;
use jostle_results::table::TableError;
use thiserror::Error;

use crate::files::{EXPERIMENT, FilesError};

/// Why a folder cannot be used.
#[derive(Debug, Error)]
pub enum FolderError {
    /// A system call failed.
    #[error("failed to use {}: {source}{}", path.display(), remedy(source))]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A complete folder could not be renamed.
    #[error(
        "failed to rename {} to {}: {source}; the results are complete in the former",
        from.display(), to.display()
    )]
    Rename {
        /// The present name.
        from: PathBuf,
        /// The name that it was to get.
        to: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A table could not be written.
    #[error("failed to {0}{remedy}", remedy = remedy_of_table(.0))]
    Table(#[from] TableError),
    /// Another process has locked the folder.
    #[error(
        "{} is in use: another process is writing to it; wait until that ends, or choose another \
         folder", folder.display()
    )]
    InUse {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder contains results of another file.
    #[error(
        "{} contains results of another experiment.toml: choose another folder, or continue with \
         that file", folder.display()
    )]
    OtherExperiment {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder contains results, but no `experiment.toml`.
    #[error(
        "{} contains {file} but no {EXPERIMENT}: choose another folder", folder.display()
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
        "{} has runs of model version {theirs}, this program has {MODEL_VERSION}: they remain readable, and \
         none is added; execute all runs again in another folder", folder.display()
    )]
    OtherModel {
        /// The folder.
        folder: PathBuf,
        /// The model version of its runs.
        theirs: u32,
    },
    /// The runs were measured by the definitions of a later version.
    #[error(
        "{} has runs under the definitions {theirs} of measures, of a later version of jostle: execute all \
         runs of an experiment with the same version", folder.display()
    )]
    OtherDefinitions {
        /// The folder.
        folder: PathBuf,
        /// The number of its definitions.
        theirs: u32,
    },
    /// A folder contains no results.
    #[error("{} contains no results: use folders that `jostled run` wrote", folder.display())]
    NoResults {
        /// The folder.
        folder: PathBuf,
    },
    /// A line of the list of runs is damaged.
    #[error(
        "{}, line {line}: {reason}; restore the file from a copy, or remove it to execute its runs \
         again", path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
}

impl FolderError {
    /// Returns whether a file has other content than was written.
    #[must_use]
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Table(TableError::Malformed { .. }))
    }

    /// Returns whether a file could not be written since the disk is full.
    #[must_use]
    pub fn is_disk_full(&self) -> bool {
        match self {
            Self::Io { source, .. } | Self::Table(TableError::Io { source, .. }) => is_full(source),
            _ => false,
        }
    }
}

impl From<FilesError> for FolderError {
    fn from(FilesError { path, source }: FilesError) -> Self {
        Self::Io { path, source }
    }
}

/// Returns what to do after an error of the system; empty if the error says it.
fn remedy(error: &io::Error) -> &'static str {
    match is_full(error) {
        true => "; finished runs are kept: free disk space, then continue the experiment",
        false => "",
    }
}

fn is_full(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded
    )
}

fn remedy_of_table(error: &TableError) -> &'static str {
    match error {
        TableError::Io { source, .. } => remedy(source),
        _ => "",
    }
}

/// Returns the error of a system call on `path`.
pub fn io_error(path: &Path, source: io::Error) -> FolderError {
    FolderError::Io {
        path: path.to_owned(),
        source,
    }
}
