//! A copy of a damaged file, so that nothing of it is lost by going on.

use std::fs::{self, File};
use std::io;
use std::path::Path;

use tracing::warn;

use super::schema;

/// Copies the database and its WAL under a name of their own beside them. Only the thread that
/// writes calls it, between two transactions: what is copied is whole.
pub(super) fn keep(folder: &Path) -> io::Result<()> {
    let name = |count: u64| format!("damaged-{count}.sqlite");
    let is_free = |count: &u64| !folder.join(name(*count)).exists();
    let Some(count) = (1..).find(is_free) else {
        return Ok(());
    };
    let copy = name(count);
    // The database last: whoever finds it finds its WAL too.
    for suffix in ["-wal", ""] {
        let from = folder.join(format!("{}{suffix}", schema::FILE));
        if from.exists() {
            let to = folder.join(format!("{copy}{suffix}"));
            fs::copy(from, &to)?;
            File::open(to)?.sync_all()?;
        }
    }
    warn!(copy, "the damaged database is kept aside");
    Ok(())
}
