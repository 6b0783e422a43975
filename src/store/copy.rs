//! A consistent copy of the database while another process writes it.

use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use fail::fail_point;
use rusqlite::Connection;
use rusqlite::backup::{Backup, StepResult};

use super::error::StoreError;
use super::schema;

/// Pages copied per step.
const PAGES: i32 = 256;

/// How long a database that another process has locked is retried.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);

/// Copies the database in `folder` to `to`, an empty file, and returns the number of its swarms.
///
/// One read transaction covers the whole copy. The writer continues meanwhile; its WAL grows until
/// the copy is complete, since the pages of the transaction must stay.
///
/// # Errors
///
/// Those of [`super::Store::open`] about a file, [`StoreError::Corrupt`] if the copy is damaged as the
/// original is, and [`StoreError::Copy`] if `to` cannot be written.
pub fn copy(folder: &Path, to: &Path) -> Result<u64, StoreError> {
    let file = folder.join(schema::FILE);
    let source = schema::open_reader(&file)?;
    schema::check_origin(&file, &source)?;
    let fail_reading = |error| StoreError::of_reading(&file, &error);
    // The next read opens the snapshot.
    let snapshot = source.unchecked_transaction().map_err(fail_reading)?;
    let swarms: i64 = snapshot
        .query_row("SELECT count(*) FROM swarm", [], |row| row.get(0))
        .map_err(fail_reading)?;
    let failed = |detail: String| StoreError::Copy {
        file: to.to_path_buf(),
        detail,
    };
    let fail_writing = |error: rusqlite::Error| failed(error.to_string());
    let mut target = Connection::open(to).map_err(fail_writing)?;
    // The backup is synced as a whole later: this file needs no journal.
    target
        .pragma_update(None, "journal_mode", "OFF")
        .map_err(fail_writing)?;
    let mut progress = Instant::now();
    {
        let backup = Backup::new(&snapshot, &mut target).map_err(fail_writing)?;
        loop {
            fail_point!("backup-pages");
            match backup.step(PAGES).map_err(fail_writing)? {
                StepResult::Done => break,
                StepResult::More => progress = Instant::now(),
                _ if progress.elapsed() > BUSY_TIMEOUT => {
                    return Err(failed(
                        "the database is locked by another process".to_owned(),
                    ));
                }
                _ => thread::sleep(BUSY_TIMEOUT / 1000),
            }
        }
    }
    drop(snapshot);
    // A daemon would reject a database with damaged pages.
    schema::check_pages(to, &target)?;
    target.close().map_err(|(_, error)| fail_writing(error))?;
    Ok(swarms.cast_unsigned())
}
