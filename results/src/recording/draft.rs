//! A file on its way: under another name until it is whole, with room set aside on the disk.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

use super::{RecordingError, io_error};

/// What the names of files end in that are not whole.
pub const PARTIAL: &str = "partial";

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
    #[cfg(test)]
    pub disk_bytes: u64,
}

impl Draft {
    /// Begins the file. Hidden, readers of a whole folder overlook it: its name begins with a dot.
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
                io::ErrorKind::AlreadyExists => RecordingError::Unfinished {
                    partial: partial.clone(),
                },
                _ => io_error(path, source),
            })?;
        Ok(Draft {
            path: path.to_owned(),
            partial,
            file,
            room: 0,
            keeps_room: true,
            #[cfg(test)]
            disk_bytes: u64::MAX,
        })
    }

    /// The file, to be written to.
    pub fn file(&self) -> Result<File, RecordingError> {
        self.file.try_clone().map_err(|source| self.error(source))
    }

    /// Sets room aside, so that the file can become `bytes` long whatever else fills the disk.
    pub fn reserve(&mut self, bytes: u64) -> Result<(), RecordingError> {
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

    /// Gives the file its name, once all of it is on the disk; returns its bytes.
    pub fn publish(self, replace: bool) -> Result<u64, RecordingError> {
        let error = |source| self.error(source);
        let bytes = self.file.metadata().map_err(error)?.len();
        // What was set aside and is not needed is given back.
        self.file.set_len(bytes).map_err(error)?;
        self.file.sync_all().map_err(error)?;
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
    let mut name = OsString::from(if is_hidden { "." } else { "" });
    name.push(path.file_name().unwrap_or_default());
    name.push(".");
    name.push(PARTIAL);
    path.with_file_name(name)
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}
