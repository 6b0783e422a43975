//! A file on its way: under another name until it is whole, with room set aside on the disk.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

use super::{RecordingError, io_error};

/// What the names of files end in that are not whole.
pub const PARTIAL: &str = "partial";

/// The suffix of a file that is made from another one; what an earlier attempt left is overwritten.
const REBUILT: &str = "rebuilt";

/// Room is set aside in steps of so many bytes.
const ROOM: u64 = 1024 * 1024;

/// A file on its way.
pub struct Draft {
    /// Its name once it is whole.
    pub path: PathBuf,
    partial: PathBuf,
    file: File,
    room: u64,
    keeps_room: bool,
    /// How many times its length is reserved on the disk.
    times: u64,
    #[cfg(test)]
    pub disk_bytes: u64,
}

impl Draft {
    /// Begins the file, and locks it until it is published or this process ends. Hidden, readers of a
    /// whole folder overlook it: its name begins with a dot.
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
        // Created here and by nobody else: two that record to one name would ruin each other's.
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
        // Another process holds the lock for a moment only, to see whether this one does. Where the
        // file system has no locks, a recovery cannot see that the file is being written.
        let _ = file.lock();
        Ok(Draft::of(path, partial, file))
    }

    /// Begins the file from the contents of another one, under a temporary name.
    pub fn rebuild(path: &Path) -> Result<Self, RecordingError> {
        let rebuilt = with_ending(path, REBUILT);
        let file = File::create(&rebuilt).map_err(|source| io_error(path, source))?;
        Ok(Draft::of(path, rebuilt, file))
    }

    fn of(path: &Path, partial: PathBuf, file: File) -> Self {
        Draft {
            path: path.to_owned(),
            partial,
            file,
            room: 0,
            keeps_room: true,
            times: 1,
            #[cfg(test)]
            disk_bytes: u64::MAX,
        }
    }

    /// Reserves twice its length: another file is to be made from this one.
    pub fn doubled(self) -> Self {
        Draft { times: 2, ..self }
    }

    /// The file, to be written to.
    pub fn file(&self) -> Result<File, RecordingError> {
        self.file.try_clone().map_err(|source| self.error(source))
    }

    /// Sets room aside, so that the file can become `bytes` long whatever else fills the disk.
    pub fn reserve(&mut self, bytes: u64) -> Result<(), RecordingError> {
        let bytes = bytes.saturating_mul(self.times);
        #[cfg(test)]
        if bytes > self.disk_bytes {
            return Err(self.error(io::ErrorKind::StorageFull.into()));
        }
        if bytes <= self.room || !self.keeps_room {
            return Ok(());
        }
        // Ahead, if there is so much.
        for room in [bytes.saturating_add(ROOM), bytes] {
            match fallocate(&self.file, FallocateFlags::KEEP_SIZE, 0, room) {
                Ok(()) => {
                    self.room = room;
                    return Ok(());
                }
                Err(Errno::NOSPC | Errno::DQUOT) if room == bytes => {
                    return Err(self.error(io::ErrorKind::StorageFull.into()));
                }
                Err(Errno::NOSPC | Errno::DQUOT | Errno::INTR) => {}
                // Not every file system can: there a write may fail.
                Err(Errno::OPNOTSUPP | Errno::NOSYS) => self.keeps_room = false,
                Err(error) => return Err(self.error(error.into())),
            }
        }
        Ok(())
    }

    /// Gives back the room that the file does not need and syncs it; returns its bytes.
    pub fn sync(&self) -> Result<u64, RecordingError> {
        let error = |source| self.error(source);
        let bytes = self.file.metadata().map_err(error)?.len();
        self.file.set_len(bytes).map_err(error)?;
        self.file.sync_all().map_err(error)?;
        Ok(bytes)
    }

    /// Where the file is until it is published.
    pub fn partial(&self) -> &Path {
        &self.partial
    }

    /// Removes the file.
    pub fn discard(self) {
        let _ = fs::remove_file(self.partial);
    }

    /// Gives the file its name, once all of it is on the disk; returns its bytes.
    pub fn publish(&self, replace: bool) -> Result<u64, RecordingError> {
        let error = |source| self.error(source);
        let bytes = self.sync()?;
        if replace {
            fs::rename(&self.partial, &self.path).map_err(error)?;
        } else {
            // Unlike a renaming it fails where a file is.
            fs::hard_link(&self.partial, &self.path).map_err(|source| match source.kind() {
                io::ErrorKind::AlreadyExists => RecordingError::Exists {
                    path: self.path.clone(),
                },
                _ => self.error(source),
            })?;
            fs::remove_file(&self.partial).map_err(error)?;
        }
        // The name is an entry of the folder, which is written apart from the file.
        File::open(folder(&self.path))
            .and_then(|folder| folder.sync_all())
            .map_err(error)?;
        Ok(bytes)
    }

    fn error(&self, source: io::Error) -> RecordingError {
        io_error(&self.path, source)
    }
}

/// What a file is called until it is whole.
fn partial_of(path: &Path, is_hidden: bool) -> PathBuf {
    let path = with_ending(path, PARTIAL);
    if !is_hidden {
        return path;
    }
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    path.with_file_name(name)
}

/// The partial file of a recording that is written to one file.
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

/// Whether a process has the file locked.
#[must_use]
pub fn is_being_written(partial: &Path) -> bool {
    lock(partial).is_ok_and(|locked| locked.is_none())
}

/// Locks a partial file; `None` if another process writes it. The lock ends with the file's handle.
///
/// # Errors
///
/// When the file cannot be opened.
pub fn lock(partial: &Path) -> io::Result<Option<File>> {
    let file = File::open(partial)?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Ok(None),
        // A file system without locks is no reason to leave a recording unreadable.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(Some(file)),
    }
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}
