//! Room on the disk that is kept for deletions: they need some before they make some.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

use rustix::fs::statvfs;

/// Its name in the data folder.
pub(super) const FILE: &str = "reserve";

/// How much: what a deletion writes, and moving the pages behind it into the database, is less.
const BYTES: usize = 1024 * 1024;

/// How many times as much must be free: to keep it takes nobody else's last room.
const TIMES: u64 = 3;

/// Keeps it, if it is not there whole.
pub(super) fn keep(folder: &Path) -> io::Result<()> {
    let path = folder.join(FILE);
    if fs::metadata(&path).is_ok_and(|it| it.len() == BYTES as u64) {
        return Ok(());
    }
    let disk = statvfs(folder)?;
    if disk.f_bavail.saturating_mul(disk.f_frsize) < TIMES * BYTES as u64 {
        return Err(io::ErrorKind::StorageFull.into());
    }
    let kept = File::create(&path).and_then(|mut file| {
        // Written, since a file with nothing in it has no room of its own.
        file.write_all(&vec![1; BYTES])?;
        file.sync_all()
    });
    if kept.is_err() {
        give_up(folder);
    }
    kept
}

/// Gives it up; whether it was there.
pub(super) fn give_up(folder: &Path) -> bool {
    fs::remove_file(folder.join(FILE)).is_ok()
}
