//! Backups of a data folder, taken while the daemon runs, and their restoration.
//!
//! A backup is a folder with a copy of the database, `experiments/` and `recordings/` of the data
//! folder, and `backup.json`, which is written last: without it the backup is not finished. It contains
//! no secrets: neither the token of the page nor the `auth_dir`.
//!
//! A separate process takes it. It reads completed files and one snapshot of the database and sends no
//! request to the daemon, so it works while a daemon hangs, or without one.

mod complete;
mod error;
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

pub use crate::backup::complete::Incomplete;
use crate::backup::complete::incomplete;
pub use crate::backup::error::BackupError;
use crate::backup::error::io_error;
pub use crate::backup::files::FOLDERS;
use crate::backup::files::{make_folder, sync_folder};
use crate::backup::manifest::FileEntry;
pub use crate::backup::manifest::Manifest;
use crate::store::{self, StoreError};

/// The manifest's file name until it is complete.
const TEMP_MANIFEST: &str = "backup.json.new";

/// Free space that a backup leaves on the disk of the data folder.
const MIN_FREE_BYTES: u64 = 64 * 1024 * 1024;

/// Niceness of a backup, so that it yields to the daemon.
const NICENESS: i32 = 10;

/// Takes a backup of `data` into the new or empty folder `target`. If it fails, its files are removed.
/// What the data folder lacks is in [`Manifest::incomplete`].
pub fn take(data: &Path, target: &Path) -> Result<Manifest, BackupError> {
    check_database(data)?;
    if is_within(target, data)? {
        return Err(BackupError::Inside(target.to_owned()));
    }
    let _ = rustix::process::setpriority_process(None, NICENESS);
    let is_new = !target.exists();
    if !is_new && !is_empty(target, &[])? {
        return Err(BackupError::Exists(target.to_owned()));
    }
    make_folder(target)?;
    // Creating the temporary manifest claims the folder: a second, concurrent backup fails here.
    let manifest_file = match files::create(&target.join(TEMP_MANIFEST)) {
        Err(BackupError::Io { source, .. }) if source.kind() == io::ErrorKind::AlreadyExists => {
            return Err(BackupError::Exists(target.to_owned()));
        }
        created => created?,
    };
    let taken = match is_empty(target, &[TEMP_MANIFEST]) {
        Ok(false) => {
            let _ = fs::remove_file(target.join(TEMP_MANIFEST));
            return Err(BackupError::Exists(target.to_owned()));
        }
        Ok(true) => check_room(data, target).and_then(|()| copy_data(data, target, manifest_file)),
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
        let _ = fs::remove_file(target.join(TEMP_MANIFEST));
        if is_new {
            let _ = fs::remove_dir(target);
        }
    }
    taken
}

/// Checks that a data folder has a database.
///
/// # Errors
///
/// [`BackupError::NoData`] and [`BackupError::Io`].
pub fn check_database(data: &Path) -> Result<(), BackupError> {
    let database = data.join(store::FILE);
    match fs::metadata(&database) {
        Ok(it) if it.is_file() => Ok(()),
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(io_error(&database)(error)),
        _ => Err(BackupError::NoData(data.to_owned())),
    }
}

/// Whether `target`, which need not exist, is `folder` or inside it.
fn is_within(target: &Path, folder: &Path) -> Result<bool, BackupError> {
    let real = |path: &Path| fs::canonicalize(path).map_err(io_error(path));
    let absolute = std::path::absolute(target).map_err(io_error(target))?;
    let there = absolute.ancestors().find(|it| it.exists());
    Ok(real(there.unwrap_or(target))?.starts_with(real(folder)?))
}

/// Checks that the disk of `target` has enough free space.
fn check_room(data: &Path, target: &Path) -> Result<(), BackupError> {
    let length = |path: PathBuf| fs::metadata(path).map_or(0, |file| file.len());
    let mut needed = length(data.join(store::FILE)) + length(data.join(store::WAL));
    for name in FOLDERS {
        let folder = data.join(name);
        files::for_each(&folder, files::MAX_DEPTH, &mut |path| {
            needed += length(folder.join(path));
            Ok(())
        })?;
    }
    let fail = io_error(target);
    let disk = statvfs(target).map_err(|error| fail(error.into()))?;
    let mut free = disk.f_bavail.saturating_mul(disk.f_frsize);
    let device = |path: &Path| fs::metadata(path).map(|it| it.dev());
    if device(data).map_err(&fail)? == device(target).map_err(&fail)? {
        free = free.saturating_sub(MIN_FREE_BYTES);
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
/// A swarm may be deleted or created between the two copies. In this order no recording or experiment is
/// newer than the database.
fn copy_data(data: &Path, target: &Path, manifest_file: File) -> Result<Manifest, BackupError> {
    let mut copies = Copies {
        data,
        target,
        entries: Vec::new(),
        folders: BTreeSet::new(),
    };
    for name in FOLDERS {
        let (root, path) = (data.join(name), Path::new(name));
        files::for_each(&root, 0, &mut |file| copies.copy(&path.join(file)))?;
        for folder in files::folders(&root)? {
            copies.copy_folder(&path.join(folder))?;
        }
    }
    let Copies {
        mut entries,
        mut folders,
        ..
    } = copies;
    omit_deleted(data, target, &mut entries);
    let taken = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let database = target.join(store::FILE);
    let file = files::create(&database)?;
    let swarms = store::copy(data, &database)?;
    let (bytes, blake3) = files::hash(&database)?;
    file.sync_all().map_err(io_error(&database))?;
    entries.push(FileEntry {
        path: store::FILE.to_owned(),
        bytes,
        blake3,
    });
    folders.extend(FOLDERS.map(|name| target.join(name)));
    for folder in folders.iter().filter(|it| it.is_dir()) {
        sync_folder(folder)?;
    }
    let taken = taken.unwrap_or_default().as_secs();
    let mut manifest = Manifest::new(store::SCHEMA, taken, swarms, entries);
    write_manifest(target, manifest_file, &manifest)?;
    manifest.incomplete = incomplete(target);
    Ok(manifest)
}

/// The files that have been copied from a data folder.
struct Copies<'a> {
    data: &'a Path,
    target: &'a Path,
    entries: Vec<FileEntry>,
    /// The folders below the target.
    folders: BTreeSet<PathBuf>,
}

impl Copies<'_> {
    /// Copies the folder of one experiment or recording, by its path in the data folder. If it is deleted
    /// meanwhile, it is omitted; if another one takes its place, that is copied instead.
    fn copy_folder(&mut self, folder: &Path) -> Result<(), BackupError> {
        let source = self.data.join(folder);
        while let Some(before) = files::Identity::of(&source)? {
            let copied = self.entries.len();
            files::for_each(&source, files::MAX_DEPTH, &mut |path| {
                self.copy(&folder.join(path))
            })?;
            if before.is_of(&source)? {
                break;
            }
            self.entries.truncate(copied);
            let copy = self.target.join(folder);
            self.folders.retain(|it| !it.starts_with(&copy));
            match fs::remove_dir_all(&copy) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(io_error(&copy)(error));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Copies a file, by its path in the data folder, unless it is deleted meanwhile.
    fn copy(&mut self, path: &Path) -> Result<(), BackupError> {
        fail_point!("backup-file");
        let to = self.target.join(path);
        if let Some(folder) = to.parent()
            && self.folders.insert(folder.to_owned())
        {
            make_folder(folder)?;
        }
        if let Some((bytes, blake3)) = files::copy(&self.data.join(path), &to)? {
            self.entries.push(FileEntry {
                path: path.to_string_lossy().into_owned(),
                bytes,
                blake3,
            });
        }
        Ok(())
    }
}

/// Omits the recordings and experiments that were deleted while they were copied.
fn omit_deleted(data: &Path, target: &Path, entries: &mut Vec<FileEntry>) {
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

/// Writes the manifest under its temporary name and renames it, which completes the backup.
fn write_manifest(target: &Path, mut file: File, manifest: &Manifest) -> Result<(), BackupError> {
    sync_folder(target)?;
    fail_point!("backup-manifest");
    let (temp, path) = (target.join(TEMP_MANIFEST), target.join(manifest::FILE));
    let mut write = || {
        file.write_all(manifest.to_text()?.as_bytes())?;
        file.sync_all()?;
        fs::rename(&temp, &path)
    };
    write().map_err(io_error(&path))?;
    sync_folder(target)
}

/// Restores the backup in `source` into the new or empty data folder `data`.
///
/// The files are written into [`store::RESTORING`] and renamed once all are complete, the database last.
/// While that folder exists, no daemon starts on the data folder. After an error the data folder
/// contains only its `lock`, unless a rename failed. Experiments and recordings that lack files are
/// restored, too: [`Manifest::incomplete`] names them.
pub fn restore(source: &Path, data: &Path) -> Result<Manifest, BackupError> {
    let mut manifest = Manifest::read(source)?;
    if manifest.schema > store::SCHEMA {
        return Err(BackupError::Newer {
            folder: source.to_owned(),
            what: "schema",
            found: manifest.schema,
            known: store::SCHEMA,
        });
    }
    if data.exists() && !data.is_dir() {
        return Err(io_error(data)(io::ErrorKind::NotADirectory.into()));
    }
    if is_within(data, source)? {
        return Err(BackupError::DataInside(data.to_owned()));
    }
    // Do not create a lock file in a folder that is not a data folder.
    if data.exists() && !data.join(store::LOCK).exists() && !is_empty(data, &[])? {
        return Err(BackupError::NotEmpty(data.to_owned()));
    }
    // Lock first, so that no daemon starts on the folder meanwhile.
    let lock = store::lock(data)?;
    let staging = data.join(store::RESTORING);
    if staging.exists() {
        return Err(StoreError::Unrestored(data.to_owned()).into());
    }
    if !is_empty(data, &[store::LOCK])? {
        return Err(BackupError::NotEmpty(data.to_owned()));
    }
    if let Err(error) = write_files(source, &staging, &manifest) {
        let _ = fs::remove_dir_all(&staging);
        return Err(error);
    }
    manifest.incomplete = incomplete(&staging);
    fail_point!("restore-rename");
    for name in FOLDERS.into_iter().chain([store::FILE]) {
        let (from, to) = (staging.join(name), data.join(name));
        if from.exists() {
            fs::rename(&from, &to).map_err(io_error(&to))?;
        }
    }
    sync_folder(data)?;
    fs::remove_dir(&staging).map_err(io_error(&staging))?;
    sync_folder(data)?;
    drop(lock);
    Ok(manifest)
}

/// Copies the files of a backup into a new folder and verifies each.
fn write_files(source: &Path, staging: &Path, manifest: &Manifest) -> Result<(), BackupError> {
    make_folder(staging)?;
    let mut folders = BTreeSet::from([staging.to_owned()]);
    for entry in &manifest.files {
        let (from, to) = (source.join(&entry.path), staging.join(&entry.path));
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
            let problem = format!("it has {bytes} of {} bytes", entry.bytes);
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

/// Whether a folder is empty except for `ignored`.
fn is_empty(folder: &Path, ignored: &[&str]) -> Result<bool, BackupError> {
    for entry in fs::read_dir(folder).map_err(io_error(folder))? {
        let name = entry.map_err(io_error(folder))?.file_name();
        if !ignored.iter().any(|it| *it == name) {
            return Ok(false);
        }
    }
    Ok(true)
}
