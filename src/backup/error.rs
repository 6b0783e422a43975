//! Errors of backups and restorations.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::store::StoreError;

/// Why a backup was not taken or not restored.
#[derive(Debug, Error)]
pub enum BackupError {
    /// The folder is not a data folder.
    #[error(
        "{} has no database of jostled: name the daemon's data folder with --data-dir ({})",
        .0.display(), data_folder(.0, Path::new(SERVICE_DATA))
    )]
    NoData(PathBuf),
    /// The folder for the backup is not empty.
    #[error("{} is not empty: name a new folder for the backup", .0.display())]
    Exists(PathBuf),
    /// The target folder is the data folder or inside it.
    #[error("{} is the data folder or inside it: name a folder elsewhere, best on another disk", .0.display())]
    Inside(PathBuf),
    /// The data folder is inside the backup.
    #[error("the data folder {} is inside the backup: name another with --data-dir", .0.display())]
    DataInside(PathBuf),
    /// The disk has too little free space.
    #[error(
        "the backup needs about {} MiB and {} has {} MiB: free some space, or name a folder \
         on another disk", needed.div_ceil(1024 * 1024), folder.display(), free / (1024 * 1024)
    )]
    NoRoom {
        /// The folder for the backup.
        folder: PathBuf,
        /// Its size in bytes.
        needed: u64,
        /// Available bytes.
        free: u64,
    },
    /// An error of the system.
    #[error("use {}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The error.
        source: io::Error,
    },
    /// The database cannot be copied, or the data folder cannot be locked.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// There is no manifest.
    #[error(
        "{} is not a finished backup, it has no backup.json: restore another one", .0.display()
    )]
    Unfinished(PathBuf),
    /// A file differs from what was written.
    #[error("the backup is damaged: {}: {problem}: restore another one", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A newer version took it.
    #[error(
        "{} was taken by a newer jostled ({what} {found}, this one knows {known}): restore it with \
         that version", folder.display()
    )]
    Newer {
        /// The backup.
        folder: PathBuf,
        /// What is newer.
        what: &'static str,
        /// Its number in the backup.
        found: i64,
        /// The newest that this version knows.
        known: i64,
    },
    /// The data folder is not empty.
    #[error(
        "the data folder {} is not empty: name an empty or a new one with --data-dir", .0.display()
    )]
    NotEmpty(PathBuf),
}

/// Where `jostled.service` has the data folders of its nodes.
const SERVICE_DATA: &str = "/var/lib/jostle/jostle";

/// Where the data folder may be: that of the service if it has one of the same node.
fn data_folder(given: &Path, service: &Path) -> String {
    match given.file_name().map(|node| service.join(node)) {
        Some(folder) if folder != given && folder.is_dir() => {
            format!("that of the service is {}", folder.display())
        }
        _ => "`jostled config explain`, run as the daemon is, prints it".to_owned(),
    }
}

/// The error of the system that names `path`.
pub fn io_error(path: &Path) -> impl Fn(io::Error) -> BackupError + '_ {
    |source| BackupError::Io {
        path: path.to_owned(),
        source,
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn without_data_the_folder_of_the_service_is_named_if_it_exists() {
        let service = tempfile::tempdir().unwrap();
        let given = Path::new("/root/.local/state/jostle/lab");
        let remedy = || data_folder(given, service.path());
        assert!(remedy().contains("jostled config explain"), "{}", remedy());
        let folder = service.path().join("lab");
        std::fs::create_dir(&folder).unwrap();
        assert!(remedy().contains(folder.to_str().unwrap()), "{}", remedy());
    }
}
