//! Backups of a data folder, taken while the daemon runs, and their restoration.
//!
//! A backup is a folder with a copy of the database, `experiments/` and `recordings/` as in the data
//! folder, and `backup.json`, which is written last: without it the backup is unfinished. It holds
//! no secrets: neither the page's token nor the `auth_dir`.
//!
//! A process of its own takes it. It reads files that the daemon has finished and one snapshot of
//! the database, and asks the daemon nothing, so it works beside a daemon that hangs, or without one.

mod files;
mod manifest;

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use fail::fail_point;
use rustix::fs::statvfs;
use thiserror::Error;

use crate::backup::files::{io_error, make_folder, sync_folder};
use crate::backup::manifest::FileEntry;
pub use crate::backup::manifest::Manifest;
use crate::store::{self, StoreError};

/// The folders of a data folder that belong in a backup.
const FOLDERS: [&str; 2] = ["experiments", "recordings"];

/// The manifest's file name until it is complete.
const DRAFT: &str = "backup.json.new";

/// Room that a backup leaves on the disk of the data folder.
const KEPT_FREE_BYTES: u64 = 64 * 1024 * 1024;

/// How much lower than the daemon a backup ranks (its niceness).
const NICENESS: i32 = 10;

/// Why a backup is not taken or not restored.
#[derive(Debug, Error)]
pub enum BackupError {
    /// The folder is not a data folder.
    #[error(
        "{} holds no database of jostled: name the daemon's data folder with --data-dir \
         (`jostled config explain` tells it)", .0.display()
    )]
    NoData(PathBuf),
    /// The folder for the backup holds something.
    #[error("{} is not empty: name a new folder for the backup", .0.display())]
    Exists(PathBuf),
    /// The target folder is the data folder or inside it.
    #[error("{} is the data folder or inside it: name a folder elsewhere, best on another disk", .0.display())]
    Inside(PathBuf),
    /// The data folder is inside the backup.
    #[error("the data folder {} is inside the backup: name another with --data-dir", .0.display())]
    DataInside(PathBuf),
    /// The disk has too little room.
    #[error(
        "the backup takes about {} MiB and {} has {} MiB for it: free some space, or name a folder \
         on another disk", needed.div_ceil(1024 * 1024), folder.display(), free / (1024 * 1024)
    )]
    NoRoom {
        /// Where it would be.
        folder: PathBuf,
        /// What it takes.
        needed: u64,
        /// What there is.
        free: u64,
    },
    /// The system refused.
    #[error("use {}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The database cannot be copied, or the data folder cannot be locked.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// There is no manifest.
    #[error(
        "{} is not a finished backup, it has no {}: restore another one", .0.display(), manifest::FILE
    )]
    Unfinished(PathBuf),
    /// A file is not what was written.
    #[error("the backup is damaged: {}: {problem}: restore another one", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A later version took it.
    #[error(
        "{} was taken by a newer jostled ({what} {found}, this one knows {known}): restore it with \
         that version", folder.display()
    )]
    Newer {
        /// The backup.
        folder: PathBuf,
        /// What is newer.
        what: &'static str,
        /// Its number.
        found: i64,
        /// The newest known here.
        known: i64,
    },
    /// The data folder holds something.
    #[error(
        "the data folder {} is not empty: name an empty or a new one with --data-dir", .0.display()
    )]
    NotEmpty(PathBuf),
}

/// Takes a backup of `data` into the folder `target`, which is made. What was written of a backup
/// that fails is removed.
///
/// # Errors
///
/// [`BackupError`].
pub fn take(data: &Path, target: &Path) -> Result<Manifest, BackupError> {
    let database = data.join(store::FILE);
    match fs::metadata(&database) {
        Ok(it) if it.is_file() => {}
        Err(source) if source.kind() != io::ErrorKind::NotFound => {
            return Err(io_error(&database, source));
        }
        _ => return Err(BackupError::NoData(data.to_owned())),
    }
    if is_within(target, data)? {
        return Err(BackupError::Inside(target.to_owned()));
    }
    // A backup computes little; it yields to the daemon all the same.
    let _ = rustix::process::setpriority_process(None, NICENESS);
    let is_new = !target.exists();
    if !is_new && !is_empty(target, &[])? {
        return Err(BackupError::Exists(target.to_owned()));
    }
    make_folder(target)?;
    // Creating the manifest's draft claims the folder: a second, concurrent backup fails here.
    let draft = match files::create(&target.join(DRAFT)) {
        Err(BackupError::Io { source, .. }) if source.kind() == io::ErrorKind::AlreadyExists => {
            return Err(BackupError::Exists(target.to_owned()));
        }
        created => created?,
    };
    let taken = match is_empty(target, &[DRAFT]) {
        Ok(false) => {
            let _ = fs::remove_file(target.join(DRAFT));
            return Err(BackupError::Exists(target.to_owned()));
        }
        Ok(true) => check_room(data, target).and_then(|()| fill(data, target, draft)),
        Err(error) => Err(error),
    };
    if taken.is_err() {
        for name in FOLDERS {
            let _ = fs::remove_dir_all(target.join(name));
        }
        for suffix in ["-shm", "-wal", ""] {
            let _ = fs::remove_file(target.join(format!("{}{suffix}", store::FILE)));
        }
        let _ = fs::remove_file(target.join(manifest::FILE));
        let _ = fs::remove_file(target.join(DRAFT));
        if is_new {
            let _ = fs::remove_dir(target);
        }
    }
    taken
}

/// Whether `target`, which need not exist, is `folder` or inside it.
fn is_within(target: &Path, folder: &Path) -> Result<bool, BackupError> {
    let real = |path: &Path| fs::canonicalize(path).map_err(|source| io_error(path, source));
    let absolute = std::path::absolute(target).map_err(|source| io_error(target, source))?;
    let there = absolute.ancestors().find(|it| it.exists());
    Ok(real(there.unwrap_or(target))?.starts_with(real(folder)?))
}

/// Checks that the disk of `target` has room.
fn check_room(data: &Path, target: &Path) -> Result<(), BackupError> {
    let length = |path: PathBuf| fs::metadata(path).map_or(0, |file| file.len());
    let mut needed = length(data.join(store::FILE)) + length(data.join(store::WAL));
    for name in FOLDERS {
        let folder = data.join(name);
        let paths = files::list(&folder)?.into_iter();
        needed += paths.map(|path| length(folder.join(path))).sum::<u64>();
    }
    let fail = |source| io_error(target, source);
    let disk = statvfs(target).map_err(|error| fail(error.into()))?;
    let mut free = disk.f_bavail.saturating_mul(disk.f_frsize);
    let device = |path: &Path| fs::metadata(path).map(|it| it.dev());
    if device(data).map_err(fail)? == device(target).map_err(fail)? {
        free = free.saturating_sub(KEPT_FREE_BYTES);
    }
    match needed <= free {
        true => Ok(()),
        false => Err(BackupError::NoRoom {
            folder: target.to_owned(),
            needed,
            free,
        }),
    }
}

/// Copies the files, then the database, then writes the manifest.
///
/// A swarm may be deleted or created between the two copies. In this order a recording or experiment is
/// never of a later time than the database.
fn fill(data: &Path, target: &Path, draft: File) -> Result<Manifest, BackupError> {
    let (mut entries, mut folders) = (Vec::new(), BTreeSet::new());
    for name in FOLDERS {
        let root = data.join(name);
        for path in files::list(&root)? {
            fail_point!("backup-file");
            let to = target.join(name).join(&path);
            if let Some(folder) = to.parent()
                && folders.insert(folder.to_owned())
            {
                make_folder(folder)?;
            }
            if let Some((bytes, blake3)) = files::copy(&root.join(&path), &to)? {
                let path = Path::new(name).join(path).to_string_lossy().into_owned();
                entries.push(FileEntry {
                    path,
                    bytes,
                    blake3,
                });
            }
        }
    }
    forget_deleted(data, target, &mut entries);
    let taken = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let database = target.join(store::FILE);
    let file = files::create(&database)?;
    let swarms = store::copy(data, &database)?;
    let (bytes, blake3) = files::hash(&database)?;
    file.sync_all()
        .map_err(|source| io_error(&database, source))?;
    entries.push(FileEntry {
        path: store::FILE.to_owned(),
        bytes,
        blake3,
    });
    for folder in &folders {
        sync_folder_if_there(folder)?;
    }
    for name in FOLDERS {
        sync_folder_if_there(&target.join(name))?;
    }
    let taken = taken.unwrap_or_default().as_secs();
    let manifest = Manifest::new(store::SCHEMA, taken, swarms, entries);
    write_manifest(target, draft, &manifest)?;
    Ok(manifest)
}

/// Leaves out the recordings and experiments that were deleted while they were copied.
fn forget_deleted(data: &Path, target: &Path, entries: &mut Vec<FileEntry>) {
    for name in FOLDERS {
        let copies = fs::read_dir(target.join(name)).into_iter().flatten();
        for copy in copies.flatten() {
            let one = Path::new(name).join(copy.file_name());
            if !data.join(&one).exists() {
                let _ = fs::remove_dir_all(target.join(&one));
                entries.retain(|entry| !Path::new(&entry.path).starts_with(&one));
            }
        }
    }
}

fn sync_folder_if_there(folder: &Path) -> Result<(), BackupError> {
    match folder.is_dir() {
        true => sync_folder(folder),
        false => Ok(()),
    }
}

/// Writes the manifest to its draft and renames the draft, which completes the backup.
fn write_manifest(target: &Path, mut file: File, manifest: &Manifest) -> Result<(), BackupError> {
    sync_folder(target)?;
    fail_point!("backup-manifest");
    let (draft, path) = (target.join(DRAFT), target.join(manifest::FILE));
    let mut write = || {
        file.write_all(manifest.to_text()?.as_bytes())?;
        file.sync_all()?;
        fs::rename(&draft, &path)
    };
    write().map_err(|source| io_error(&path, source))?;
    sync_folder(target)
}

/// Restores the backup in `source` into the data folder `data`, which is made or is empty.
///
/// The files are written into a folder inside it and renamed once all of them are whole, the database
/// last. Until the end that folder is there, and a daemon does not start on it.
///
/// # Errors
///
/// [`BackupError`]; there is nothing in the data folder but its `lock`, then, unless renaming failed.
pub fn restore(source: &Path, data: &Path) -> Result<Manifest, BackupError> {
    let manifest = Manifest::read(source)?;
    if manifest.schema > store::SCHEMA {
        return Err(BackupError::Newer {
            folder: source.to_owned(),
            what: "schema",
            found: manifest.schema,
            known: store::SCHEMA,
        });
    }
    if data.exists() && !data.is_dir() {
        let error = io::ErrorKind::NotADirectory.into();
        return Err(io_error(data, error));
    }
    if is_within(data, source)? {
        return Err(BackupError::DataInside(data.to_owned()));
    }
    // Create no lock file in a folder that is not a data folder.
    if data.exists() && !data.join(store::LOCK).exists() && !is_empty(data, &[])? {
        return Err(BackupError::NotEmpty(data.to_owned()));
    }
    // The lock first, so that no daemon starts on the folder meanwhile.
    let lock = store::lock(data)?;
    let draft = data.join(store::RESTORING);
    if draft.exists() {
        let folder = data.to_owned();
        return Err(StoreError::Unrestored { folder }.into());
    }
    if !is_empty(data, &[store::LOCK])? {
        return Err(BackupError::NotEmpty(data.to_owned()));
    }
    if let Err(error) = write_files(source, &draft, &manifest) {
        let _ = fs::remove_dir_all(&draft);
        return Err(error);
    }
    fail_point!("restore-rename");
    for name in FOLDERS.into_iter().chain([store::FILE]) {
        let (from, to) = (draft.join(name), data.join(name));
        if from.exists() {
            fs::rename(&from, &to).map_err(|source| io_error(&to, source))?;
        }
    }
    sync_folder(data)?;
    fs::remove_dir(&draft).map_err(|source| io_error(&draft, source))?;
    sync_folder(data)?;
    drop(lock);
    Ok(manifest)
}

/// Copies the files of a backup into a new folder, and compares each with the manifest.
fn write_files(source: &Path, draft: &Path, manifest: &Manifest) -> Result<(), BackupError> {
    make_folder(draft)?;
    let mut folders = BTreeSet::from([draft.to_owned()]);
    for entry in &manifest.files {
        let (from, to) = (source.join(&entry.path), draft.join(&entry.path));
        let damaged = |problem: String| BackupError::Damaged {
            path: from.clone(),
            problem,
        };
        if let Some(folder) = to.parent()
            && folders.insert(folder.to_owned())
        {
            make_folder(folder)?;
        }
        let copied = files::copy(&from, &to)?;
        let (bytes, blake3) = copied.ok_or_else(|| damaged("it is missing".to_owned()))?;
        if bytes != entry.bytes {
            let problem = format!("it has {bytes} bytes, of {}", entry.bytes);
            return Err(damaged(problem));
        }
        if blake3 != entry.blake3 {
            return Err(damaged("its checksum differs".to_owned()));
        }
    }
    for folder in &folders {
        sync_folder(folder)?;
    }
    Ok(())
}

/// Whether a folder holds nothing but `ignored`.
fn is_empty(folder: &Path, ignored: &[&str]) -> Result<bool, BackupError> {
    let fail = |source| io_error(folder, source);
    for entry in fs::read_dir(folder).map_err(fail)? {
        let name = entry.map_err(fail)?.file_name();
        if !ignored.iter().any(|it| *it == name) {
            return Ok(false);
        }
    }
    Ok(true)
}
