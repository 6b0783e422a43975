//! What can go wrong: when reading or opening, and when writing.

use std::io;
use std::path::{Path, PathBuf};

use rusqlite::ffi;
use rusqlite::{Error as SqlError, ErrorCode};
use thiserror::Error;

/// Bytes below which a disk counts as full when SQLite says only that a write failed.
const FULL_BELOW_BYTES: u64 = 64 * 1024;

/// Why the store was not opened, or something was not read.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The folder or a file in it cannot be used.
    #[error("use the data folder {}: {source}: check that it is a folder, its owner and its disk, or name another --data-dir", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Another process has it open.
    #[error("lock {}: another jostled uses this folder: stop it, or name another --data-dir", folder.display())]
    InUse {
        /// The folder.
        folder: PathBuf,
    },
    /// The file is no database of ours.
    #[error("open {}: not written by jostled: name another --data-dir, or put back a copy", file.display())]
    Foreign {
        /// The file.
        file: PathBuf,
    },
    /// A later version wrote it.
    #[error(
        "open {}: written by a newer jostled (schema {found}, this one knows {known}): upgrade, or \
         name another --data-dir", file.display()
    )]
    Newer {
        /// The file.
        file: PathBuf,
        /// Its schema.
        found: i64,
        /// The newest schema known here.
        known: i64,
    },
    /// The file's structure is broken.
    #[error(
        "read {}: it is corrupt ({detail}): keep it aside, check the disk, and put back a copy or \
         name another --data-dir", file.display()
    )]
    Corrupt {
        /// The file.
        file: PathBuf,
        /// What was found.
        detail: String,
    },
    /// A restoration of the folder was ended before it was complete.
    #[error(
        "open {}: a `jostled restore` into it was ended before it was complete: remove what is in it \
         and restore again", folder.display()
    )]
    Unrestored {
        /// The folder.
        folder: PathBuf,
    },
    /// A copy for a backup cannot be made.
    #[error("copy the database to {}: {detail}: check that disk and its free space", file.display())]
    Copy {
        /// The copy.
        file: PathBuf,
        /// What SQLite says.
        detail: String,
    },
    /// A record is not what was written.
    #[error(
        "read {what} of swarm {swarm:?} in {}: damaged since it was written: check the disk, and \
         put back a copy of the data folder", file.display()
    )]
    Damaged {
        /// The file.
        file: PathBuf,
        /// The swarm.
        swarm: String,
        /// Which record.
        what: String,
    },
    /// No such swarm is stored.
    #[error("find swarm {swarm:?} in the store: it was never created there, or is deleted")]
    NoSwarm {
        /// The swarm.
        swarm: String,
    },
    /// No such checkpoint is kept.
    #[error(
        "find checkpoint {number} of swarm {swarm:?}: not kept; `checkpoints` lists those that are"
    )]
    NoCheckpoint {
        /// The swarm.
        swarm: String,
        /// The number asked for.
        number: u64,
    },
    /// Reading failed now, and may succeed later.
    #[error("read {}: {detail}: try again, and check the disk if it stays so", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What SQLite says.
        detail: String,
    },
    /// No thread could be started.
    #[error("start the store's thread: {0}")]
    NoThread(io::Error),
    /// The store has been stopped.
    #[error("read the store: it is stopped")]
    Stopped,
}

impl StoreError {
    /// Sorts SQLite's errors into those of the file and those of the moment.
    pub(super) fn of_reading(file: &Path, error: &SqlError) -> StoreError {
        let (file, detail) = (file.to_path_buf(), error.to_string());
        match error {
            SqlError::SqliteFailure(failure, _) => match failure.code {
                ErrorCode::NotADatabase => StoreError::Foreign { file },
                ErrorCode::SystemIoFailure
                | ErrorCode::DiskFull
                | ErrorCode::CannotOpen
                | ErrorCode::PermissionDenied
                | ErrorCode::ReadOnly
                | ErrorCode::OutOfMemory
                | ErrorCode::DatabaseBusy
                | ErrorCode::DatabaseLocked => StoreError::Io { file, detail },
                // Our statements are fixed: a missing table or column was there once.
                _ => StoreError::Corrupt { file, detail },
            },
            _ => StoreError::Corrupt { file, detail },
        }
    }
}

/// Why something was not written.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum StoreFault {
    /// No space is left: nothing was written, and it may be tried again when there is.
    #[error("the disk of the data folder is full: free some space, or delete a swarm")]
    Full,
    /// A write failed: nothing was written, and it may be tried again.
    #[error("the data folder cannot be written: {0}: check the disk")]
    Io(String),
    /// It contradicts what is stored (a gap in the rows, an unknown swarm): nothing was written.
    #[error("the store refuses to write this: {0}")]
    Refused(String),
    /// The store has been stopped; nothing was written.
    #[error("the store is stopped")]
    Stopped,
    /// Whether it was written is unknown and will be until the store is opened again.
    #[error("the store can no longer be trusted: {0}: check the disk, and start jostled again")]
    Fatal(String),
}

impl StoreFault {
    /// Sorts SQLite's errors into a full disk, a failed write, and those after which nothing that
    /// was written can be trusted: a failed sync (the kernel may have dropped the pages it could
    /// not write, and a second sync would say that all is well) and a broken file.
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
            (
                ErrorCode::SystemIoFailure
                | ErrorCode::CannotOpen
                | ErrorCode::PermissionDenied
                | ErrorCode::ReadOnly
                | ErrorCode::OutOfMemory
                | ErrorCode::DatabaseBusy
                | ErrorCode::DatabaseLocked,
                _,
            ) => StoreFault::Io(error.to_string()),
            _ => StoreFault::Fatal(error.to_string()),
        }
    }
}

/// Whether the disk of `folder` has no space; SQLite does not pass on why an operation failed.
fn is_full(folder: &Path) -> bool {
    rustix::fs::statvfs(folder)
        .is_ok_and(|disk| disk.f_bavail.saturating_mul(disk.f_frsize) < FULL_BELOW_BYTES)
}
