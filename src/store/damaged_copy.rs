//! A copy of a damaged database, taken before it is repaired or truncated.

use std::fs::{self, File};
use std::io;
use std::path::Path;

use tracing::warn;

use super::schema;

/// Copies the database and its WAL to `damaged-N.sqlite` in the same folder.
///
/// Called between two transactions of the only writer, so the copy is consistent.
pub(super) fn create(folder: &Path) -> io::Result<()> {
    let name = |count: u64| format!("damaged-{count}.sqlite");
    let is_free = |count: &u64| !folder.join(name(*count)).exists();
    let Some(count) = (1..).find(is_free) else {
        return Ok(());
    };
    let copy = name(count);
    // The database last: if it exists, its WAL does too.
    for suffix in ["-wal", ""] {
        let from = folder.join(format!("{}{suffix}", schema::FILE));
        if from.exists() {
            let to = folder.join(format!("{copy}{suffix}"));
            fs::copy(from, &to)?;
            File::open(to)?.sync_all()?;
        }
    }
    warn!(copy, "copied the damaged database");
    Ok(())
}
