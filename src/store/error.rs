//! Errors of opening and reading, and faults of writing.

use std::io;
use std::path::{Path, PathBuf};

use rusqlite::ffi;
use rusqlite::{Error as SqlError, ErrorCode};
use thiserror::Error;

/// Free bytes below which a disk counts as full when SQLite reports only that a write failed.
const FULL_BELOW_BYTES: u64 = 64 * 1024;

/// Why the store was not opened or a record was not read.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The folder or a file in it cannot be used.
    #[error("use the data folder {}: {source}: check that it is a folder, its owner and its disk, or name another --data-dir", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// Another process has it open.
    #[error("lock {}: another jostled uses this folder: stop it, or name another --data-dir", .0.display())]
    InUse(PathBuf),
    /// The file is not a database of jostled.
    #[error("open {}: not written by jostled: name another --data-dir, or restore a backup", .0.display())]
    Foreign(PathBuf),
    /// A newer version wrote it.
    #[error(
        "open {}: written by a newer jostled{} ({what} {found}, this one knows {known}): upgrade, or \
         name another --data-dir", file.display(), version(writer.as_deref())
    )]
    Newer {
        /// The file.
        file: PathBuf,
        /// The version of the program that wrote it, if that is known.
        writer: Option<String>,
        /// What is newer: `schema` or `model version`.
        what: &'static str,
        /// Its number in the file.
        found: i64,
        /// The newest one that this version knows.
        known: i64,
    },
    /// The structure of the file is damaged.
    #[error(
        "read {}: it is corrupt ({detail}): keep a copy of it, check the disk, and restore a backup or \
         name another --data-dir", file.display()
    )]
    Corrupt {
        /// The file.
        file: PathBuf,
        /// What SQLite found.
        detail: String,
    },
    /// A restoration into the folder was interrupted.
    #[error(
        "open {}: a `jostled restore` into it was interrupted: remove its contents and restore again", .0.display()
    )]
    Unrestored(PathBuf),
    /// The copy for a backup failed.
    #[error("copy the database to {}: {detail}: check that disk and its free space", file.display())]
    Copy {
        /// The copy.
        file: PathBuf,
        /// The error of SQLite.
        detail: String,
    },
    /// A record differs from what was written.
    #[error(
        "read {what}{} in {}: damaged since it was written: check the disk, and restore a \
         backup", of_swarm(swarm), file.display()
    )]
    Damaged {
        /// The file.
        file: PathBuf,
        /// The swarm; empty if the record belongs to none.
        swarm: String,
        /// Which record.
        what: String,
    },
    /// No such swarm is stored.
    #[error("find swarm {0:?} in the store: it was not created there, or was deleted")]
    NoSwarm(String),
    /// There is no such checkpoint.
    #[error(
        "find checkpoint {number} of swarm {swarm:?}: not stored; `checkpoints` lists those that are"
    )]
    NoCheckpoint {
        /// The swarm.
        swarm: String,
        /// The requested number.
        number: u64,
    },
    /// Reading failed and may succeed later.
    #[error("read {}: {detail}: retry, and check the disk if the error persists", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// The error of SQLite.
        detail: String,
    },
    /// The writer thread was not started.
    #[error("start the store's thread: {0}")]
    NoThread(io::Error),
    /// The store has been stopped.
    #[error("read the store: it is stopped")]
    Stopped,
}

impl StoreError {
    /// Distinguishes errors of the file from transient errors.
    pub(super) fn of_reading(file: &Path, error: &SqlError) -> StoreError {
        let (file, detail) = (file.to_path_buf(), error.to_string());
        match error.sqlite_error_code() {
            Some(ErrorCode::NotADatabase) => StoreError::Foreign(file),
            Some(code) if is_transient(code) => StoreError::Io { file, detail },
            // The statements are fixed: a missing table or column is damage.
            _ => StoreError::Corrupt { file, detail },
        }
    }
}

/// Whether the error may be transient.
fn is_transient(code: ErrorCode) -> bool {
    matches!(
        code,
        ErrorCode::SystemIoFailure
            | ErrorCode::DiskFull
            | ErrorCode::CannotOpen
            | ErrorCode::PermissionDenied
            | ErrorCode::ReadOnly
            | ErrorCode::OutOfMemory
            | ErrorCode::DatabaseBusy
            | ErrorCode::DatabaseLocked
    )
}

fn of_swarm(name: &str) -> String {
    match name {
        "" => String::new(),
        name => format!(" of swarm {name:?}"),
    }
}

/// Why writes were not committed.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum StoreFault {
    /// The disk is full: nothing was written; a retry may succeed.
    #[error("the disk of the data folder is full: free some space, or delete a swarm")]
    Full,
    /// A write failed: nothing was written; a retry may succeed.
    #[error("the data folder cannot be written: {0}: check the disk")]
    Io(String),
    /// They contradict what is stored (a gap in the rows, an unknown swarm): nothing was written.
    #[error("the store rejects the writes: {0}")]
    Refused(String),
    /// The store has been stopped; nothing was written.
    #[error("the store is stopped")]
    Stopped,
    /// Whether they were written is unknown until the store is opened again.
    #[error("the store failed: {0}: check the disk, and restart jostled")]
    Fatal(String),
}

impl StoreFault {
    /// Distinguishes a full disk and a failed write from fatal errors: a damaged file, and a failed sync, after
    /// which the kernel may have dropped the pages that it could not write, so that the next sync
    /// succeeds without them.
    pub(super) fn of_writing(folder: &Path, error: &SqlError) -> StoreFault {
        let SqlError::SqliteFailure(failure, _) = error else {
            return StoreFault::Fatal(error.to_string());
        };
        match (failure.code, failure.extended_code) {
            (ErrorCode::DiskFull, _) => StoreFault::Full,
            (
                _,
                ffi::SQLITE_IOERR_FSYNC
                | ffi::SQLITE_IOERR_DIR_FSYNC
                | ffi::SQLITE_IOERR_CORRUPTFS
                | ffi::SQLITE_IOERR_DATA,
            ) => StoreFault::Fatal(error.to_string()),
            (ErrorCode::SystemIoFailure, _) if is_full(folder) => StoreFault::Full,
            (code, _) if is_transient(code) => StoreFault::Io(error.to_string()),
            _ => StoreFault::Fatal(error.to_string()),
        }
    }
}

/// Ignores a fault that is not fatal: the next round tries again.
pub(super) fn unless_fatal<T>(
    outcome: Result<T, StoreFault>,
    otherwise: T,
) -> Result<T, StoreFault> {
    match outcome {
        Err(fault @ StoreFault::Fatal(_)) => Err(fault),
        Err(_) => Ok(otherwise),
        outcome => outcome,
    }
}

/// Whether the disk of `folder` is full: SQLite does not report why a write failed.
fn is_full(folder: &Path) -> bool {
    rustix::fs::statvfs(folder)
        .is_ok_and(|disk| disk.f_bavail.saturating_mul(disk.f_frsize) < FULL_BELOW_BYTES)
}

/// A version in a message.
fn version(writer: Option<&str>) -> String {
    writer.map_or_else(String::new, |it| format!(", version {it}"))
}
