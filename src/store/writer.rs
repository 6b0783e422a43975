//! The writer thread: commits what is queued, a group of submits per transaction.

use std::collections::BTreeSet;
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use rusqlite::{Connection, Error as SqlError, Result as SqlResult};
use tracing::{error, warn};

use super::backlog::{Backlog, MAX_BACKLOG};
use super::damaged_copy;
use super::error::{StoreFault, unless_fatal};
use super::failpoint::commit_fault;
use super::queue::Submit;
use super::reserve;
use super::transaction::Transaction;
use super::{Durability, Settings, Shared, Write};
use crate::failpoint;

/// Time between two attempts to write the backlog.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Time between two pieces of maintenance under load.
const SWEEP_INTERVAL: Duration = Duration::from_millis(50);

/// Estimated size of a transaction in the WAL besides bodies: a few pages of trees and records.
const WAL_BYTES_PER_COMMIT: usize = 6 * 4096;

/// State of the writer thread.
pub(super) struct Writer {
    pub(super) connection: Connection,
    pub(super) folder: PathBuf,
    pub(super) settings: Settings,
    pub(super) backlog: Backlog,
    pub(super) over_quota: BTreeSet<String>,
    pub(super) shared: Arc<Shared>,
    /// Estimated size of the WAL since the last checkpoint.
    pub(super) wal_bytes: usize,
    pub(super) swept_at: Instant,
    /// Whether [`damaged_copy`] was taken since the file was opened.
    has_damaged_copy: bool,
    /// Whether the file [`reserve`] exists.
    pub(super) has_reserve: bool,
    /// Submits of which it is unknown whether they were written when the store failed.
    pub(super) unknown: Vec<Submit>,
    /// Released after the last write.
    _lock: File,
}

impl Writer {
    /// The state for an opened database; holds `lock` until it is dropped.
    pub(super) fn new(
        (connection, folder, lock): (Connection, PathBuf, File),
        settings: Settings,
        shared: Arc<Shared>,
    ) -> SqlResult<Writer> {
        // A crash may have left rows of any swarm unswept.
        let over_quota = connection
            .prepare("SELECT name FROM swarm")?
            .query_map([], |record| record.get(0))?
            .collect::<SqlResult<_>>()?;
        let (backlog, swept_at) = (Backlog::new(MAX_BACKLOG), Instant::now());
        Ok(Writer {
            connection,
            folder,
            settings,
            backlog,
            over_quota,
            shared,
            wal_bytes: 0,
            swept_at,
            has_damaged_copy: false,
            has_reserve: false,
            unknown: Vec::new(),
            _lock: lock,
        })
    }

    /// Writes until the queue ends; whether everything was written.
    ///
    /// # Errors
    ///
    /// Only [`StoreFault::Fatal`], after which the file is not touched again.
    pub(super) fn run(&mut self) -> Result<bool, StoreFault> {
        let mut has_work = true;
        loop {
            let patience = match has_work {
                true => Duration::ZERO,
                false => RETRY_INTERVAL,
            };
            let (group, has_ended) = self.shared.queue.take(patience);
            let is_idle = group.is_empty();
            self.process(group)?;
            if has_ended {
                return self.close();
            }
            has_work = match is_idle || self.swept_at.elapsed() > SWEEP_INTERVAL {
                true => self.maintain(is_idle)?,
                false => true,
            };
        }
    }

    /// Writes the backlog and then `group`, and completes its submits.
    pub(super) fn process(&mut self, group: Vec<Submit>) -> Result<(), StoreFault> {
        if let Err(fault) = self.write_backlog() {
            return self.reject(group, fault);
        }
        match self.commit_or_make_room(&group) {
            Ok(outcomes) => {
                for (submit, outcome) in group.into_iter().zip(outcomes) {
                    self.complete(submit.durability, outcome);
                }
                failpoint::kill("store-done");
                Ok(())
            }
            Err(fault) => self.reject(group, fault),
        }
    }

    /// Writes the backlog, in groups.
    pub(super) fn write_backlog(&mut self) -> Result<(), StoreFault> {
        while !self.backlog.is_empty() {
            let mut backlog = std::mem::take(&mut self.backlog);
            let piece = backlog.front();
            let count = piece.len();
            let written = self.commit_or_make_room(piece);
            self.backlog = backlog;
            let outcomes = written?;
            for (submit, outcome) in self.backlog.pop(count).into_iter().zip(outcomes) {
                self.complete(submit.durability, outcome);
            }
            self.update_backlog_metrics();
        }
        Ok(())
    }

    /// Rejects the sync submits of `group` and adds the deferred ones to the backlog.
    ///
    /// On a full disk a deletion is tried by itself: it needs little space and frees some.
    fn reject(&mut self, group: Vec<Submit>, fault: StoreFault) -> Result<(), StoreFault> {
        if let StoreFault::Fatal(_) = fault {
            // It may have been written: no submit may be completed as not written.
            self.unknown = group;
            return Err(fault);
        }
        for submit in group {
            if !submit.durability.is_sync() {
                self.backlog.push(submit);
            } else if fault == StoreFault::Full && is_deletion(&submit.writes) {
                self.delete(submit)?;
            } else {
                self.complete(submit.durability, Err(fault.clone()));
            }
        }
        self.update_backlog_metrics();
        Ok(())
    }

    fn delete(&mut self, submit: Submit) -> Result<(), StoreFault> {
        let alone = std::slice::from_ref(&submit);
        let outcome = match self.commit(alone) {
            Err(StoreFault::Full) if reserve::remove(&self.folder) => {
                self.has_reserve = false;
                self.commit_or_make_room(alone)
            }
            outcome => outcome,
        };
        match outcome {
            Ok(mut outcomes) => {
                for swarm in submit.writes.iter().filter_map(Write::swarm) {
                    self.backlog.remove_swarm(swarm);
                }
                self.complete(submit.durability, outcomes.pop().unwrap_or(Ok(())));
                self.sweep_after_deletion()
            }
            Err(fault @ StoreFault::Fatal(_)) => {
                self.unknown.push(submit);
                Err(fault)
            }
            Err(fault) => {
                self.complete(submit.durability, Err(fault));
                Ok(())
            }
        }
    }

    /// Commits; if there is no space, checkpoints the WAL and overwrites it.
    fn commit_or_make_room(
        &mut self,
        group: &[Submit],
    ) -> Result<Vec<Result<(), StoreFault>>, StoreFault> {
        let outcome = self.commit(group);
        if outcome != Err(StoreFault::Full) {
            return outcome;
        }
        match unless_fatal(self.checkpoint_wal("PASSIVE"), false)? {
            true => self.commit(group),
            false => outcome,
        }
    }

    /// Commits `group` in one transaction. Returns the outcome of each submit, or why nothing was written.
    fn commit(&mut self, group: &[Submit]) -> Result<Vec<Result<(), StoreFault>>, StoreFault> {
        if group.iter().all(|submit| submit.writes.is_empty()) {
            return Ok(group.iter().map(|_| Ok(())).collect());
        }
        let began = Instant::now();
        let writes = || group.iter().flat_map(|submit| &submit.writes);
        if !self.has_damaged_copy && writes().any(|write| matches!(write, Write::Truncate { .. })) {
            damaged_copy::create(&self.folder)
                .map_err(|error| StoreFault::Io(error.to_string()))?;
            self.has_damaged_copy = true;
        }
        failpoint::kill("store-begin");
        let outcomes = self.transact(|transaction| {
            let submits = group.iter();
            let applied = submits.map(|submit| {
                let outcome = transaction.apply(&submit.writes)?;
                Ok(outcome.map_err(StoreFault::Refused))
            });
            applied.collect::<SqlResult<Vec<_>>>()
        })?;
        let (writes, bytes) = group
            .iter()
            .map(Submit::size)
            .fold((0, 0), |sum, size| (sum.0 + size.0, sum.1 + size.1));
        self.wal_bytes += bytes;
        self.shared.meter.committed(began.elapsed(), writes);
        Ok(outcomes)
    }

    /// Runs `work` in a transaction and commits it; on an error everything is rolled back.
    pub(super) fn transact<T>(
        &mut self,
        work: impl FnOnce(&mut Transaction<'_>) -> SqlResult<T>,
    ) -> Result<T, StoreFault> {
        let fault = |error: SqlError| StoreFault::of_writing(&self.folder, &error);
        let mut transaction = Transaction::new(&self.connection, self.settings);
        let run = || {
            self.connection
                .execute_batch("BEGIN IMMEDIATE")
                .map_err(fault)?;
            let value = work(&mut transaction).map_err(fault)?;
            failpoint::kill("store-written");
            if let Some(fault) = commit_fault(&self.folder) {
                return Err(fault);
            }
            self.connection.execute_batch("COMMIT").map_err(fault)?;
            Ok(value)
        };
        let mut outcome = run();
        if let Err(fault) = &outcome
            && !self.connection.is_autocommit()
            && let Err(error) = self.connection.execute_batch("ROLLBACK")
        {
            outcome = Err(StoreFault::Fatal(format!(
                "{fault}; then the rollback failed: {error}"
            )));
        }
        let meter = &self.shared.meter;
        if transaction.has_changed || outcome.is_err() {
            let is_full = matches!(outcome, Err(StoreFault::Full));
            meter.is_full.store(is_full, Ordering::Relaxed);
            let is_failing = matches!(outcome, Err(StoreFault::Io(_)));
            meter.is_failing.store(is_failing, Ordering::Relaxed);
        }
        let value = outcome?;
        failpoint::kill("store-synced");
        self.over_quota.append(&mut transaction.over_quota);
        self.wal_bytes += WAL_BYTES_PER_COMMIT;
        Ok(value)
    }

    fn update_backlog_metrics(&self) {
        let (meter, backlog) = (&self.shared.meter, &self.backlog);
        meter.backlog.store(backlog.writes(), Ordering::Relaxed);
        meter
            .is_overrun
            .store(backlog.is_overrun(), Ordering::Relaxed);
    }

    /// Reports the outcome of a submit. A panic of the callback does not end the writer.
    pub(super) fn complete(&self, durability: Durability, outcome: Result<(), StoreFault>) {
        let receiver = match (durability, &outcome) {
            (Durability::Sync(done), _) | (Durability::Deferred(Some(done)), Ok(())) => done,
            (Durability::Deferred(_), outcome) => {
                if let Err(StoreFault::Refused(reason)) = outcome {
                    let problem = "deferred writes rejected: they contradict what is stored";
                    warn!(reason, "{problem}");
                }
                return;
            }
        };
        if catch_unwind(AssertUnwindSafe(|| receiver.committed(outcome))).is_err() {
            error!("a commit callback panicked");
        }
    }
}

/// Whether `writes` delete swarms and write at most replies besides.
fn is_deletion(writes: &[Write]) -> bool {
    let is_delete = |write: &Write| matches!(write, Write::Delete { .. });
    let mut all = writes.iter();
    writes.iter().any(is_delete) && all.all(|write| is_delete(write) || write.swarm().is_none())
}
