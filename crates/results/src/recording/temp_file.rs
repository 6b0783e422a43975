//! A file that has a temporary name until it is whole, with disk space reserved for it.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

use super::RecordingError;
use super::error::io_error;

/// The extension of files that are not whole.
pub const PARTIAL: &str = "partial";

/// The extension of a file that is rebuilt from another one. A leftover of an earlier attempt is
/// overwritten.
const REBUILT: &str = "rebuilt";

/// Disk space is reserved this many bytes ahead.
const RESERVE_AHEAD: u64 = 1024 * 1024;

/// A file that is not whole yet.
pub struct TempFile {
    /// Its path once it is whole.
    pub path: PathBuf,
    partial: PathBuf,
    file: File,
    /// The number of bytes that are reserved on the disk.
    reserved: u64,
    /// Whether the file system supports reserving space.
    can_reserve: bool,
    /// How many times its length is reserved on the disk.
    times: u64,
    #[cfg(test)]
    pub disk_bytes: u64,
}

impl TempFile {
    /// Creates the partial file and locks it until all its handles are closed. With `is_hidden` its
    /// name begins with a dot, so that programs that read a whole folder skip it.
    pub fn begin(path: &Path, replace: bool, is_hidden: bool) -> Result<Self, RecordingError> {
        if path.file_name().is_none() {
            let source = io::ErrorKind::InvalidFilename.into();
            return Err(io_error(path, source));
        }
        if !replace && fs::symlink_metadata(path).is_ok() {
            let path = path.to_owned();
            return Err(RecordingError::Exists { path });
        }
        let partial = partial_of(path, is_hidden);
        // `create_new`: two processes that record to one name would corrupt each other's file.
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&partial)
            .map_err(|source| match source.kind() {
                io::ErrorKind::AlreadyExists => match is_being_written(&partial) {
                    true => RecordingError::BeingWritten {
                        path: partial.clone(),
                    },
                    false => RecordingError::Unfinished {
                        path: path.to_owned(),
                        partial: partial.clone(),
                    },
                },
                _ => io_error(path, source),
            })?;
        // Another process holds the lock only briefly, to test whether this process holds it. If
        // the file system has no locks, a recovery cannot detect that the file is being written.
        let _ = file.lock();
        Ok(TempFile::of(path, partial, file))
    }

    /// Creates a temporary file for contents that are rebuilt from another one. It is not locked.
    pub fn rebuild(path: &Path) -> Result<Self, RecordingError> {
        let rebuilt = with_ending(path, REBUILT);
        let file = File::create(&rebuilt).map_err(|source| io_error(path, source))?;
        Ok(TempFile::of(path, rebuilt, file))
    }

    fn of(path: &Path, partial: PathBuf, file: File) -> Self {
        TempFile {
            path: path.to_owned(),
            partial,
            file,
            reserved: 0,
            can_reserve: true,
            times: 1,
            #[cfg(test)]
            disk_bytes: u64::MAX,
        }
    }

    /// Reserves twice the file's length, since another file will be made from it.
    pub fn reserving_twice(self) -> Self {
        TempFile { times: 2, ..self }
    }

    /// Returns another handle of the file, for writing.
    pub fn file(&self) -> Result<File, RecordingError> {
        self.file.try_clone().map_err(|source| self.error(source))
    }

    /// Reserves disk space, so that the file can grow to `bytes` even if the disk fills meanwhile.
    pub fn reserve(&mut self, bytes: u64) -> Result<(), RecordingError> {
        let bytes = bytes.saturating_mul(self.times);
        #[cfg(test)]
        if bytes > self.disk_bytes {
            return Err(self.error(io::ErrorKind::StorageFull.into()));
        }
        if bytes <= self.reserved || !self.can_reserve {
            return Ok(());
        }
        // Reserve ahead if the disk has the space.
        for length in [bytes.saturating_add(RESERVE_AHEAD), bytes] {
            match fallocate(&self.file, FallocateFlags::KEEP_SIZE, 0, length) {
                Ok(()) => {
                    self.reserved = length;
                    return Ok(());
                }
                Err(Errno::NOSPC | Errno::DQUOT) if length == bytes => {
                    return Err(self.error(io::ErrorKind::StorageFull.into()));
                }
                Err(Errno::NOSPC | Errno::DQUOT | Errno::INTR) => {}
                // On a file system that cannot reserve space, a write may fail.
                Err(Errno::OPNOTSUPP | Errno::NOSYS) => self.can_reserve = false,
                Err(error) => return Err(self.error(error.into())),
            }
        }
        Ok(())
    }

    /// Frees the reserved space beyond the file's end and syncs it. Returns its length in bytes.
    pub fn sync(&self) -> Result<u64, RecordingError> {
        let error = |source| self.error(source);
        let bytes = self.file.metadata().map_err(error)?.len();
        self.file.set_len(bytes).map_err(error)?;
        self.file.sync_all().map_err(error)?;
        Ok(bytes)
    }

    /// Returns the path of the file until it is published.
    pub fn partial(&self) -> &Path {
        &self.partial
    }

    /// Removes the file.
    pub fn discard(self) {
        let _ = fs::remove_file(self.partial);
    }

    /// Syncs the file and gives it its name. Returns its length in bytes.
    pub fn publish(&self, replace: bool) -> Result<u64, RecordingError> {
        let error = |source| self.error(source);
        let bytes = self.sync()?;
        if replace {
            fs::rename(&self.partial, &self.path).map_err(error)?;
        } else {
            // Unlike a rename, a hard link fails if the target exists.
            fs::hard_link(&self.partial, &self.path).map_err(|source| match source.kind() {
                io::ErrorKind::AlreadyExists => RecordingError::Exists {
                    path: self.path.clone(),
                },
                _ => self.error(source),
            })?;
            fs::remove_file(&self.partial).map_err(error)?;
        }
        // The name is an entry of the folder, which is synced separately from the file.
        File::open(folder(&self.path))
            .and_then(|folder| folder.sync_all())
            .map_err(error)?;
        Ok(bytes)
    }

    fn error(&self, source: io::Error) -> RecordingError {
        io_error(&self.path, source)
    }
}

/// Returns the path of a file until it is whole.
fn partial_of(path: &Path, is_hidden: bool) -> PathBuf {
    let path = with_ending(path, PARTIAL);
    if !is_hidden {
        return path;
    }
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    path.with_file_name(name)
}

/// Returns the partial file of a recording that is written to one file.
#[must_use]
pub fn partial(path: &Path) -> PathBuf {
    partial_of(path, false)
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".");
    name.push(ending);
    path.with_file_name(name)
}

/// Returns whether another process or handle has the file locked.
#[must_use]
pub fn is_being_written(partial: &Path) -> bool {
    lock(partial).is_ok_and(|locked| locked.is_none())
}

/// Locks a partial file. Returns `None` if another process is writing it. Closing the returned
/// handle releases the lock.
///
/// # Errors
///
/// The system's error if the file cannot be opened.
pub fn lock(partial: &Path) -> io::Result<Option<File>> {
    let file = File::open(partial)?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Ok(None),
        // On a file system without locks the recording must remain readable.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(Some(file)),
    }
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}
