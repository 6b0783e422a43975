//! What the writer does beside writing: sweeping, moving the WAL, and the end.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use rusqlite::config::DbConfig;
use tracing::error;

use super::error::StoreFault;
use super::queue::End;
use super::writer::Writer;
use super::{OnFatal, Shared};
use super::{reserve, retain};

/// WAL bytes after which it is moved into the file when nobody waits; at four times this it is
/// moved in any case.
const WAL_BYTES: usize = 4 * 1024 * 1024;

/// Pieces of what was deleted that are taken away at once on a full disk.
const PIECES_ON_A_FULL_DISK: usize = 64;

/// Free pages always left in the file, and given back to the disk at a time.
const FREE_PAGES: (i64, usize) = (1024, 256);

/// The thread: writes until the queue ends, and tells those who still wait when it fails.
pub(super) fn run(mut writer: Writer, shared: &Arc<Shared>, on_fatal: &OnFatal) {
    shared.queue.is_written_here();
    let outcome = catch_unwind(AssertUnwindSafe(|| writer.run()))
        .unwrap_or_else(|_| Err(StoreFault::Fatal("its thread panicked".to_string())));
    let is_all_written = match outcome {
        Ok(is_all_written) => is_all_written,
        Err(fault) => {
            error!(%fault, "the store has failed");
            // Closing must not move pages whose sync failed as if they were safe.
            let _ = writer
                .connection
                .set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true);
            shared.queue.end(End::Fatal(fault.to_string()));
            // The daemon ends here, and whoever waited asks the next one.
            on_fatal(&fault);
            for submit in std::mem::take(&mut writer.unknown) {
                writer.tell(submit.wanted, Err(fault.clone()));
            }
            loop {
                let (group, _) = shared.queue.take(Duration::ZERO);
                if group.is_empty() {
                    break;
                }
                for submit in group {
                    writer.tell(submit.wanted, Err(fault.clone()));
                }
            }
            false
        }
    };
    // The file and its lock are free before anybody hears of the end.
    drop(writer);
    shared.queue.finish(is_all_written);
}

impl Writer {
    /// Does a piece of what nobody waits for; whether there is more.
    pub(super) fn keep_house(&mut self, is_idle: bool) -> Result<bool, StoreFault> {
        self.tidied = Instant::now();
        if self.shared.meter.is_full.load(Ordering::Relaxed) && is_idle {
            unless_fatal(self.probe(), ())?;
        }
        let mut has_more = unless_fatal(self.tidy(), false)?;
        if self.wal_bytes > 4 * WAL_BYTES || (is_idle && self.wal_bytes > WAL_BYTES) {
            unless_fatal(self.move_wal("PASSIVE"), false)?;
        }
        if is_idle && !has_more {
            has_more = unless_fatal(self.give_back(), false)?;
        }
        if !self.has_reserve && !self.shared.meter.is_full.load(Ordering::Relaxed) {
            // On a disk that is full for others it is tried again.
            self.has_reserve = reserve::keep(&self.folder).is_ok();
        }
        Ok(has_more)
    }

    /// Frees the pages of a swarm that was deleted on a full disk, before others take the room that
    /// this takes; up to a bound, and later the rest.
    pub(super) fn use_what_is_gone(&mut self) -> Result<(), StoreFault> {
        for _ in 0..PIECES_ON_A_FULL_DISK {
            let has_more = unless_fatal(self.tidy(), false)?;
            unless_fatal(self.move_wal("PASSIVE"), false)?;
            if !has_more {
                break;
            }
        }
        Ok(())
    }

    /// Takes away a piece of what is kept no longer; whether there is more.
    fn tidy(&mut self) -> Result<bool, StoreFault> {
        if self.catalog.gone.is_empty() && self.untidy.is_empty() {
            return Ok(false);
        }
        let (quota_bytes, gone) = (self.quota_bytes, self.catalog.gone.first().copied());
        let mut untidy = std::mem::take(&mut self.untidy);
        let tidied = self.transact(|draft| retain::tidy(draft, gone, &mut untidy, quota_bytes));
        self.untidy.append(&mut untidy);
        tidied
    }

    /// Finds out whether there is space again when nobody else tries: writes what is there.
    fn probe(&mut self) -> Result<(), StoreFault> {
        self.transact(|draft| Ok(draft.answers().is_some()))
            .map(|_| ())
    }

    /// Moves the WAL into the file as far as its readers let it; whether its place can be used
    /// again.
    pub(super) fn move_wal(&mut self, mode: &str) -> Result<bool, StoreFault> {
        let sql = format!("PRAGMA wal_checkpoint({mode})");
        let (is_busy, pages, moved): (bool, i64, i64) = self
            .connection
            .query_row(&sql, [], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))
            .map_err(|error| StoreFault::of_writing(&self.folder, &error))?;
        self.wal_bytes = 0;
        Ok(!is_busy && pages == moved)
    }

    /// Gives free pages back to the disk; whether there were any to give.
    fn give_back(&mut self) -> Result<bool, StoreFault> {
        let give = || {
            let count = |pragma| {
                self.connection
                    .pragma_query_value(None, pragma, |row| row.get::<_, i64>(0))
            };
            let (free, all) = (count("freelist_count")?, count("page_count")?);
            if free <= FREE_PAGES.0.max(all / 8) {
                return Ok(false);
            }
            self.connection
                .execute_batch(&format!("PRAGMA incremental_vacuum({})", FREE_PAGES.1))?;
            Ok(true)
        };
        let given = give().map_err(|error| StoreFault::of_writing(&self.folder, &error))?;
        self.wal_bytes += if given { FREE_PAGES.1 * 4096 } else { 0 };
        Ok(given)
    }

    /// Writes what is left and moves the WAL into the file; whether both could be done.
    ///
    /// A WAL that another process still reads, such as a backup, stays: it is synced, and the next
    /// start reads it.
    pub(super) fn close(&mut self) -> Result<bool, StoreFault> {
        let is_written = unless_fatal(self.write_backlog().map(|()| true), false)?;
        let is_moved = unless_fatal(self.move_wal("TRUNCATE").map(|_| true), false)?;
        Ok(is_written && is_moved)
    }
}

/// What is not fatal is tried again later.
fn unless_fatal<T>(outcome: Result<T, StoreFault>, otherwise: T) -> Result<T, StoreFault> {
    match outcome {
        Err(fault @ StoreFault::Fatal(_)) => Err(fault),
        Err(_) => Ok(otherwise),
        outcome => outcome,
    }
}
