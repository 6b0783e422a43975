//! Recordings on their way to the daemon, piece by piece.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::playback::reel::ReadOrder;
use crate::playback::{Reel, ReplayError};

/// The longest recording that is taken in, in bytes.
pub const MOST_BYTES: u64 = 1024 * 1024 * 1024;

/// Uploads at once.
const MOST: usize = 8;

/// An upload that stands still for so long gives way to others.
const PATIENCE: Duration = Duration::from_secs(10);

/// The uploads of a daemon. Their files are gone when they are shown, or when it starts anew.
pub struct Uploads {
    folder: PathBuf,
    by_name: Mutex<BTreeMap<String, Upload>>,
}

struct Upload {
    file: File,
    received: u64,
    length: u64,
    touched: Instant,
}

impl Uploads {
    /// Opens the folder, and clears it of what was left there.
    ///
    /// # Errors
    ///
    /// What the system says.
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

    /// Takes a piece in; returns how many bytes have come.
    ///
    /// # Errors
    ///
    /// [`ReplayError`]; what came before is kept.
    pub fn take_in(
        &self,
        name: &str,
        offset: u64,
        length: u64,
        piece: &[u8],
    ) -> Result<u64, ReplayError> {
        if length > MOST_BYTES {
            return Err(ReplayError::TooLong { length });
        }
        let end = offset.saturating_add(piece.len() as u64);
        let unkept = |error: io::Error| ReplayError::Unkept(error.to_string());
        let mut by_name = self.lock();
        if offset == 0 {
            self.make_room(&mut by_name, name)?;
            let upload = Upload {
                file: File::create(self.path(name)).map_err(unkept)?,
                received: 0,
                length,
                touched: Instant::now(),
            };
            by_name.insert(name.to_owned(), upload);
        }
        let Some(upload) = by_name.get_mut(name) else {
            return Err(ReplayError::Piece { received: 0 });
        };
        upload.touched = Instant::now();
        let received = upload.received;
        if end <= received && length == upload.length {
            return Ok(received);
        }
        if offset != received || end > length || length != upload.length {
            return Err(ReplayError::Piece { received });
        }
        if let Err(error) = upload.file.write_all(piece) {
            // How much of it was written is not known.
            by_name.remove(name);
            self.remove(name);
            return Err(unkept(error));
        }
        upload.received = end;
        Ok(end)
    }

    /// Opens what was uploaded under a name; it is no upload any more.
    ///
    /// # Errors
    ///
    /// [`ReplayError::NotUploaded`] while it is not whole, [`ReplayError::Unreadable`].
    pub fn reel(&self, name: &str, read_order: ReadOrder<'_>) -> Result<Reel, ReplayError> {
        let mut by_name = self.lock();
        let is_whole = |it: &Upload| it.received == it.length;
        if !by_name.get(name).is_some_and(is_whole) {
            return Err(ReplayError::NotUploaded(name.to_owned()));
        }
        // Under a name that no upload has, for another one may begin meanwhile.
        let path = self.path(name);
        let opening = path.with_extension("opening");
        let moved = fs::rename(&path, &opening);
        by_name.remove(name);
        drop(by_name);
        moved.map_err(|error| ReplayError::Unkept(error.to_string()))?;
        let reel = Reel::open(std::slice::from_ref(&opening), read_order);
        // What is open stays readable, and leaves nothing behind.
        let _ = fs::remove_file(opening);
        reel
    }

    /// Drops what has stood still, and refuses one more than there may be.
    fn make_room(
        &self,
        by_name: &mut BTreeMap<String, Upload>,
        name: &str,
    ) -> Result<(), ReplayError> {
        by_name.retain(|it, upload| {
            let is_kept = it == name || upload.touched.elapsed() < PATIENCE;
            if !is_kept {
                self.remove(it);
            }
            is_kept
        });
        if by_name.len() >= MOST && !by_name.contains_key(name) {
            return Err(ReplayError::TooMany(MOST));
        }
        Ok(())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.mcap"))
    }

    fn remove(&self, name: &str) {
        // What cannot be removed now is when the daemon starts.
        let _ = fs::remove_file(self.path(name));
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Upload>> {
        // Every change is one of the map, and is whole.
        self.by_name.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn so_many_are_taken_in_at_once_and_those_that_stand_still_give_way() {
        let folder = tempfile::tempdir().unwrap();
        let uploads = Uploads::open(folder.path()).unwrap();
        let begin = |name: &str| uploads.take_in(name, 0, 4, b"ab");
        for number in 0..MOST {
            assert_eq!(begin(&format!("a{number}")), Ok(2));
        }
        assert_eq!(begin("b"), Err(ReplayError::TooMany(MOST)));
        // One that is there begins anew, and goes on.
        assert_eq!(begin("a1"), Ok(2));
        assert_eq!(uploads.take_in("a1", 2, 4, b"cd"), Ok(4));
        let long_ago = Instant::now().checked_sub(PATIENCE).unwrap();
        uploads.lock().get_mut("a0").unwrap().touched = long_ago;
        assert_eq!(begin("b"), Ok(2));
        assert!(!uploads.path("a0").exists());
        let lost = uploads.take_in("a0", 2, 4, b"cd");
        assert_eq!(lost, Err(ReplayError::Piece { received: 0 }));
    }
}
