//! Maintenance by the writer thread between commits, and its end.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use rusqlite::config::DbConfig;
use tracing::error;

use super::error::{StoreFault, unless_fatal};
use super::writer::Writer;
use super::{OnFatal, Shared};
use super::{reserve, retention};

/// WAL size from which an idle writer checkpoints it; at four times this a busy one does, too.
const WAL_BYTES: usize = 4 * 1024 * 1024;

/// Pieces swept at once after a deletion on a full disk.
const SWEEPS_AFTER_DELETION: usize = 64;

/// Free pages that stay in the file.
const MIN_FREE_PAGES: i64 = 1024;

/// Free pages returned to the disk in one piece.
const VACUUM_PAGES: usize = 256;

/// Body of the writer thread: writes until the queue ends; after a failure it rejects what is queued.
pub(super) fn run(mut writer: Writer, shared: &Arc<Shared>, on_fatal: &OnFatal) {
    shared.queue.set_writer_thread();
    let outcome = catch_unwind(AssertUnwindSafe(|| writer.run()))
        .unwrap_or_else(|_| Err(StoreFault::Fatal("the writer thread panicked".to_string())));
    let is_all_written = match outcome {
        Ok(is_all_written) => is_all_written,
        Err(fault) => {
            error!(%fault, "store failed");
            // Closing must not checkpoint pages whose sync failed.
            let _ = writer
                .connection
                .set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true);
            shared.queue.end(fault.clone());
            // The daemon exits here; clients retry on the next one.
            on_fatal(&fault);
            let mut group = std::mem::take(&mut writer.unknown);
            loop {
                for submit in group {
                    writer.complete(submit.durability, Err(fault.clone()));
                }
                (group, _) = shared.queue.take(Duration::ZERO);
                if group.is_empty() {
                    break;
                }
            }
            false
        }
    };
    // Close the file and release its lock before waiters are woken.
    drop(writer);
    shared.queue.finish(is_all_written);
}

impl Writer {
    /// Does a piece of maintenance; whether there is more.
    pub(super) fn maintain(&mut self, is_idle: bool) -> Result<bool, StoreFault> {
        self.swept_at = Instant::now();
        if self.shared.meter.is_full.load(Ordering::Relaxed) && is_idle {
            // Without submits only this write detects that the disk has space again.
            unless_fatal(self.transact(|transaction| transaction.probe()), ())?;
        }
        let mut has_more = unless_fatal(self.sweep(), false)?;
        if self.wal_bytes > 4 * WAL_BYTES || (is_idle && self.wal_bytes > WAL_BYTES) {
            unless_fatal(self.checkpoint_wal("PASSIVE"), false)?;
        }
        if is_idle && !has_more {
            has_more = unless_fatal(self.vacuum(), false)?;
        }
        if !self.has_reserve && !self.shared.meter.is_full.load(Ordering::Relaxed) {
            // On a full disk the next round tries again.
            self.has_reserve = reserve::create(&self.folder).is_ok();
        }
        Ok(has_more)
    }

    /// Frees the pages of a swarm that was deleted on a full disk, before other writes take the space
    /// that this needs; up to a bound, the rest later.
    pub(super) fn sweep_after_deletion(&mut self) -> Result<(), StoreFault> {
        for _ in 0..SWEEPS_AFTER_DELETION {
            let has_more = unless_fatal(self.sweep(), false)?;
            unless_fatal(self.checkpoint_wal("PASSIVE"), false)?;
            if !has_more {
                break;
            }
        }
        Ok(())
    }

    /// Deletes a piece of what is not retained; whether there is more.
    fn sweep(&mut self) -> Result<bool, StoreFault> {
        let tombstone = retention::tombstone(&self.connection)
            .map_err(|error| StoreFault::of_writing(&self.folder, &error))?;
        if tombstone.is_none() && self.over_quota.is_empty() {
            return Ok(false);
        }
        let (quota_bytes, mut candidates) = (
            self.settings.quota_bytes,
            std::mem::take(&mut self.over_quota),
        );
        let swept = self
            .transact(|transaction| retention::sweep(transaction, &mut candidates, quota_bytes));
        self.over_quota.append(&mut candidates);
        swept
    }

    /// Checkpoints the WAL as far as its readers allow; whether the WAL can be overwritten from its start.
    pub(super) fn checkpoint_wal(&mut self, mode: &str) -> Result<bool, StoreFault> {
        let sql = format!("PRAGMA wal_checkpoint({mode})");
        let (is_busy, pages, copied): (bool, i64, i64) = self
            .connection
            .query_row(&sql, [], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))
            .map_err(|error| StoreFault::of_writing(&self.folder, &error))?;
        self.wal_bytes = 0;
        Ok(!is_busy && pages == copied)
    }

    /// Returns free pages to the disk; whether there were enough of them.
    fn vacuum(&mut self) -> Result<bool, StoreFault> {
        let vacuum = || {
            let count = |pragma| {
                self.connection
                    .pragma_query_value(None, pragma, |row| row.get::<_, i64>(0))
            };
            let (free, all) = (count("freelist_count")?, count("page_count")?);
            if free <= MIN_FREE_PAGES.max(all / 8) {
                return Ok(false);
            }
            self.connection
                .execute_batch(&format!("PRAGMA incremental_vacuum({VACUUM_PAGES})"))?;
            Ok(true)
        };
        let has_vacuumed =
            vacuum().map_err(|error| StoreFault::of_writing(&self.folder, &error))?;
        self.wal_bytes += if has_vacuumed { VACUUM_PAGES * 4096 } else { 0 };
        Ok(has_vacuumed)
    }

    /// Writes the backlog and checkpoints the WAL; whether both succeeded.
    ///
    /// A WAL that another process reads, such as a backup, stays: it is synced, and the next start
    /// reads it.
    pub(super) fn close(&mut self) -> Result<bool, StoreFault> {
        let is_written = unless_fatal(self.write_backlog().map(|()| true), false)?;
        let has_checkpointed = unless_fatal(self.checkpoint_wal("TRUNCATE").map(|_| true), false)?;
        Ok(is_written && has_checkpointed)
    }
}
