//! Recordings that clients upload in pieces.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use parking_lot::Mutex;

use crate::playback::ReplayError;
use crate::playback::mcap::{McapSource, ReadCommand};

/// The maximum length of an upload in bytes.
pub const MAX_UPLOAD_BYTES: u64 = 1024 * 1024 * 1024;

/// Maximum number of concurrent uploads.
const MAX_UPLOADS: usize = 8;

/// An upload without a piece for so long may be evicted by another one.
const IDLE_TIMEOUT: Duration = Duration::from_secs(10);

/// The uploads of a daemon. A file is removed when it is opened, or when the daemon restarts.
pub struct Uploads {
    folder: PathBuf,
    /// Nothing between two changes can panic.
    by_name: Mutex<BTreeMap<String, Upload>>,
}

struct Upload {
    file: File,
    received: u64,
    length: u64,
    touched: Instant,
}

impl Uploads {
    /// Creates the folder, or empties it.
    pub fn open(folder: &Path) -> io::Result<Self> {
        match fs::remove_dir_all(folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => fs::create_dir_all(folder)?,
        }
        Ok(Uploads {
            folder: folder.to_owned(),
            by_name: Mutex::default(),
        })
    }

    /// Appends a piece, and returns the number of received bytes. After an error these are kept.
    pub fn receive(
        &self,
        name: &str,
        offset: u64,
        length: u64,
        piece: &[u8],
    ) -> Result<u64, ReplayError> {
        if length > MAX_UPLOAD_BYTES {
            return Err(ReplayError::TooLong(length));
        }
        let end = offset.saturating_add(piece.len() as u64);
        let not_stored = |error: io::Error| ReplayError::NotStored(error.to_string());
        let mut by_name = self.by_name.lock();
        if offset == 0 {
            self.make_room(&mut by_name, name)?;
            let upload = Upload {
                file: File::create(self.path(name)).map_err(not_stored)?,
                received: 0,
                length,
                touched: Instant::now(),
            };
            by_name.insert(name.to_owned(), upload);
        }
        let Some(upload) = by_name.get_mut(name) else {
            return Err(ReplayError::Piece(0));
        };
        upload.touched = Instant::now();
        let received = upload.received;
        if end <= received && length == upload.length {
            return Ok(received);
        }
        if offset != received || end > length || length != upload.length {
            return Err(ReplayError::Piece(received));
        }
        if let Err(error) = upload.file.write_all(piece) {
            // It is unknown how much was written.
            by_name.remove(name);
            self.remove(name);
            return Err(not_stored(error));
        }
        upload.received = end;
        Ok(end)
    }

    /// Opens a complete upload, which ends it.
    ///
    /// # Errors
    ///
    /// [`ReplayError::NotUploaded`] while it is incomplete, [`ReplayError::Unreadable`].
    pub fn open_upload(
        &self,
        name: &str,
        read_command: ReadCommand<'_>,
    ) -> Result<McapSource, ReplayError> {
        let mut by_name = self.by_name.lock();
        let is_complete = |it: &Upload| it.received == it.length;
        if !by_name.get(name).is_some_and(is_complete) {
            return Err(ReplayError::NotUploaded(name.to_owned()));
        }
        // Renamed, because another upload of this name may start meanwhile.
        let path = self.path(name);
        let opening = path.with_extension("opening");
        let moved = fs::rename(&path, &opening);
        by_name.remove(name);
        drop(by_name);
        moved.map_err(|error| ReplayError::NotStored(error.to_string()))?;
        let source = McapSource::open(std::slice::from_ref(&opening), read_command);
        // Open files stay readable.
        let _ = fs::remove_file(opening);
        source
    }

    /// Evicts idle uploads, and rejects an upload beyond the maximum.
    fn make_room(
        &self,
        by_name: &mut BTreeMap<String, Upload>,
        name: &str,
    ) -> Result<(), ReplayError> {
        by_name.retain(|it, upload| {
            let is_kept = it == name || upload.touched.elapsed() < IDLE_TIMEOUT;
            if !is_kept {
                self.remove(it);
            }
            is_kept
        });
        if by_name.len() >= MAX_UPLOADS && !by_name.contains_key(name) {
            return Err(ReplayError::TooMany(MAX_UPLOADS));
        }
        Ok(())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.mcap"))
    }

    fn remove(&self, name: &str) {
        // After an error the next start removes it.
        let _ = fs::remove_file(self.path(name));
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn uploads_are_limited_and_idle_ones_are_evicted() {
        let folder = tempfile::tempdir().unwrap();
        let uploads = Uploads::open(folder.path()).unwrap();
        let begin = |name: &str| uploads.receive(name, 0, 4, b"ab");
        for number in 0..MAX_UPLOADS {
            assert_eq!(begin(&format!("a{number}")), Ok(2));
        }
        assert_eq!(begin("b"), Err(ReplayError::TooMany(MAX_UPLOADS)));
        // An upload in progress may restart and continue.
        assert_eq!(begin("a1"), Ok(2));
        assert_eq!(uploads.receive("a1", 2, 4, b"cd"), Ok(4));
        let long_ago = Instant::now().checked_sub(IDLE_TIMEOUT).unwrap();
        uploads.by_name.lock().get_mut("a0").unwrap().touched = long_ago;
        assert_eq!(begin("b"), Ok(2));
        assert!(!uploads.path("a0").exists());
        let lost = uploads.receive("a0", 2, 4, b"cd");
        assert_eq!(lost, Err(ReplayError::Piece(0)));
    }
}
