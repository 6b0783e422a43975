//! Disk space reserved for deletions, which need some before they free some.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

use rustix::fs::statvfs;

/// Its name in the data folder.
pub(super) const FILE: &str = "reserve";

/// More than a deletion writes to the WAL and the checkpoint to the database.
const BYTES: usize = 1024 * 1024;

/// How many times as much must be free, so that the reserve does not fill the disk.
const MIN_FREE_FACTOR: u64 = 3;

/// Creates the reserve if it is not complete.
pub(super) fn create(folder: &Path) -> io::Result<()> {
    let path = folder.join(FILE);
    if fs::metadata(&path).is_ok_and(|it| it.len() == BYTES as u64) {
        return Ok(());
    }
    let disk = statvfs(folder)?;
    if disk.f_bavail.saturating_mul(disk.f_frsize) < MIN_FREE_FACTOR * BYTES as u64 {
        return Err(io::ErrorKind::StorageFull.into());
    }
    let created = File::create(&path).and_then(|mut file| {
        // Written, since a sparse file reserves nothing.
        file.write_all(&vec![1; BYTES])?;
        file.sync_all()
    });
    if created.is_err() {
        remove(folder);
    }
    created
}

/// Deletes the reserve; whether it existed.
pub(super) fn remove(folder: &Path) -> bool {
    fs::remove_file(folder.join(FILE)).is_ok()
}
