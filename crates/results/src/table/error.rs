//! Errors of files with tables.

use std::io;
use std::path::{Path, PathBuf};

use super::{CSV_NAME, PARQUET_NAME};

/// An error of writing or reading a table.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// A system call failed.
    #[error("use {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The directory has no results.
    #[error("find results in {}: it holds neither {PARQUET_NAME} nor {CSV_NAME}", directory.display())]
    Absent {
        /// The directory.
        directory: PathBuf,
    },
    /// The file name has none of the known extensions.
    #[error("read {}: its name ends in neither .parquet nor .csv", path.display())]
    UnknownKind {
        /// The file.
        path: PathBuf,
    },
    /// The file is not of the kind of its extension, is damaged, or cannot be encoded.
    #[error("read or write {}: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The message of its parser or writer.
        reason: String,
    },
    /// A column is missing.
    #[error("read {}: it has no column `{column}`", path.display())]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
    },
    /// A value does not fit its column.
    #[error("use {}: {place} {row}, column `{column}`: {reason}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The unit of `row`: `line` of text or `row` of a table.
        place: &'static str,
        /// The number of the row or line, from 1.
        row: u64,
        /// The column.
        column: String,
        /// The defect.
        reason: String,
    },
}

/// Returns the error of a system call on a file.
pub fn io_error(path: &Path, source: io::Error) -> TableError {
    TableError::Io {
        path: path.to_owned(),
        source,
    }
}
