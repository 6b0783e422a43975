//! The thread that writes: one transaction after another, each for all who wait.

use std::collections::BTreeSet;
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use rusqlite::{Connection, Error as SqlError, Transaction, TransactionBehavior};
use tracing::{error, warn};

use super::aside;
use super::backlog::Backlog;
use super::catalog::Catalog;
use super::crash;
use super::draft::{Changes, Draft};
use super::error::StoreFault;
use super::queue::{GROUP, Submit};
use super::reserve;
use super::{Shared, Wanted, Write};

/// How long what could not be written waits for the next attempt.
const RETRY: Duration = Duration::from_secs(1);

/// Under load, how often a piece of what is kept no longer is taken away.
const TIDY: Duration = Duration::from_millis(50);

/// What a transaction puts into the WAL beside bodies: a few pages of trees and records.
const WAL_BYTES_PER_COMMIT: usize = 6 * 4096;

/// What the thread works with.
pub(super) struct Writer {
    pub(super) connection: Connection,
    pub(super) folder: PathBuf,
    pub(super) quota_bytes: u64,
    pub(super) catalog: Catalog,
    pub(super) backlog: Backlog,
    pub(super) untidy: BTreeSet<String>,
    pub(super) shared: Arc<Shared>,
    /// Bytes put into the WAL since it was last moved into the file, about.
    pub(super) wal_bytes: usize,
    pub(super) tidied: Instant,
    /// Whether a copy of the file as it was opened is kept aside.
    is_aside: bool,
    /// Whether room is kept for deletions.
    pub(super) has_reserve: bool,
    /// What may have been written or not when the store failed.
    pub(super) unknown: Vec<Submit>,
    /// Held until the last byte is written.
    _lock: File,
}

impl Writer {
    /// Prepares the thread's work; `lock` is held while it lasts.
    pub(super) fn new(
        (connection, folder, lock): (Connection, PathBuf, File),
        quota_bytes: u64,
        shared: Arc<Shared>,
    ) -> Result<Writer, SqlError> {
        let catalog = Catalog::read(&connection)?;
        let untidy = catalog.swarms.keys().cloned().collect();
        shared.beginnings.fill(&catalog);
        let (backlog, tidied) = (Backlog::default(), Instant::now());
        Ok(Writer {
            connection,
            folder,
            quota_bytes,
            catalog,
            backlog,
            untidy,
            shared,
            wal_bytes: 0,
            tidied,
            is_aside: false,
            has_reserve: false,
            unknown: Vec::new(),
            _lock: lock,
        })
    }

    /// Writes until the queue ends; whether all was written.
    ///
    /// # Errors
    ///
    /// Only [`StoreFault::Fatal`], after which the file is not touched again.
    pub(super) fn run(&mut self) -> Result<bool, StoreFault> {
        let mut has_work = true;
        loop {
            let patience = if has_work { Duration::ZERO } else { RETRY };
            let (group, end) = self.shared.queue.take(patience);
            let is_idle = group.is_empty();
            self.round(group)?;
            if end.is_some() {
                return self.close();
            }
            has_work = match is_idle || self.tidied.elapsed() > TIDY {
                true => self.keep_house(is_idle)?,
                false => true,
            };
        }
    }

    /// Writes what was kept and then `group`, and tells those who wait.
    pub(super) fn round(&mut self, group: Vec<Submit>) -> Result<(), StoreFault> {
        if let Err(fault) = self.write_backlog() {
            return self.refuse(group, fault);
        }
        match self.commit_or_make_room(&group) {
            Ok(outcomes) => {
                for (submit, outcome) in group.into_iter().zip(outcomes) {
                    self.tell(submit.wanted, outcome);
                }
                crash::point("store-done");
                Ok(())
            }
            Err(fault) => self.refuse(group, fault),
        }
    }

    /// Writes what was kept, in groups.
    pub(super) fn write_backlog(&mut self) -> Result<(), StoreFault> {
        while !self.backlog.is_empty() {
            let mut backlog = std::mem::take(&mut self.backlog);
            let piece = backlog.front(GROUP);
            let count = piece.len();
            let written = self.commit_or_make_room(piece);
            self.backlog = backlog;
            let outcomes = written?;
            for (submit, outcome) in self.backlog.pop(count).into_iter().zip(outcomes) {
                self.tell(submit.wanted, outcome);
            }
            self.note_backlog();
        }
        Ok(())
    }

    /// Tells those who wait that nothing was written, and keeps what nobody waits for.
    ///
    /// A deletion needs little room and makes some: it is tried by itself.
    fn refuse(&mut self, group: Vec<Submit>, fault: StoreFault) -> Result<(), StoreFault> {
        if let StoreFault::Fatal(_) = fault {
            // Whether it is written is unknown: whoever waits must not hear that nothing is.
            self.unknown = group;
            return Err(fault);
        }
        for submit in group {
            if !submit.wanted.is_now() {
                self.backlog.push(submit);
            } else if fault == StoreFault::Full && is_deletion(&submit.writes) {
                self.delete(submit)?;
            } else {
                self.tell(submit.wanted, Err(fault.clone()));
            }
        }
        self.note_backlog();
        Ok(())
    }

    fn delete(&mut self, submit: Submit) -> Result<(), StoreFault> {
        let alone = std::slice::from_ref(&submit);
        let outcome = match self.commit(alone) {
            Err(StoreFault::Full) if reserve::give_up(&self.folder) => {
                self.has_reserve = false;
                self.commit_or_make_room(alone)
            }
            outcome => outcome,
        };
        match outcome {
            Ok(mut outcomes) => {
                for swarm in submit.writes.iter().filter_map(Write::swarm) {
                    self.backlog.forget(swarm);
                }
                self.tell(submit.wanted, outcomes.pop().unwrap_or(Ok(())));
                self.use_what_is_gone()
            }
            Err(fault @ StoreFault::Fatal(_)) => {
                self.unknown.push(submit);
                Err(fault)
            }
            Err(fault) => {
                self.tell(submit.wanted, Err(fault));
                Ok(())
            }
        }
    }

    /// Commits; where there is no space, moves the WAL into the file first and uses its place.
    fn commit_or_make_room(
        &mut self,
        group: &[Submit],
    ) -> Result<Vec<Result<(), StoreFault>>, StoreFault> {
        match self.commit(group) {
            Err(StoreFault::Full) => match self.move_wal("PASSIVE") {
                Ok(true) => self.commit(group),
                Err(fault @ StoreFault::Fatal(_)) => Err(fault),
                Ok(false) | Err(_) => Err(StoreFault::Full),
            },
            outcome => outcome,
        }
    }

    /// Commits `group` in one transaction, if it holds anything; what each comes to, or why nothing was written.
    fn commit(&mut self, group: &[Submit]) -> Result<Vec<Result<(), StoreFault>>, StoreFault> {
        if group.iter().all(|submit| submit.writes.is_empty()) {
            return Ok(group.iter().map(|_| Ok(())).collect());
        }
        let mut outcomes = Vec::with_capacity(group.len());
        let began = Instant::now();
        let writes = || group.iter().flat_map(|submit| &submit.writes);
        if !self.is_aside && writes().any(|write| matches!(write, Write::Cut { .. })) {
            aside::keep(&self.folder).map_err(|error| StoreFault::Io(error.to_string()))?;
            self.is_aside = true;
        }
        crash::point("store-begin");
        self.transact(|draft| {
            for submit in group {
                let checked = draft.check(&submit.writes);
                if checked.is_ok() {
                    submit
                        .writes
                        .iter()
                        .try_for_each(|write| draft.apply(write))?;
                }
                outcomes.push(checked.map_err(StoreFault::Refused));
            }
            Ok(true)
        })?;
        let (writes, bytes) = group
            .iter()
            .map(Submit::size)
            .fold((0, 0), |sum, size| (sum.0 + size.0, sum.1 + size.1));
        self.wal_bytes += bytes;
        self.shared.meter.committed(began.elapsed(), writes);
        Ok(outcomes)
    }

    /// Runs `work` in one transaction and commits what it changed, all or nothing.
    pub(super) fn transact(
        &mut self,
        work: impl FnOnce(&mut Draft<'_>) -> Result<bool, SqlError>,
    ) -> Result<bool, StoreFault> {
        let Writer {
            connection,
            catalog,
            folder,
            ..
        } = self;
        let outcome = Transaction::new_unchecked(connection, TransactionBehavior::Immediate)
            .and_then(|transaction| {
                let mut draft = Draft::new(&transaction, catalog);
                let is_worked = work(&mut draft)?;
                let changes = draft.finish()?;
                Ok((transaction, changes, is_worked))
            })
            .map_err(|error| StoreFault::of_writing(folder, &error))
            .and_then(|(transaction, changes, is_worked)| {
                crash::point("store-written");
                if let Some(fault) = crash::commit(folder) {
                    return Err(fault);
                }
                match transaction.commit() {
                    Ok(()) => Ok((changes, is_worked)),
                    Err(error) => Err(StoreFault::of_writing(folder, &error)),
                }
            });
        let outcome = match outcome {
            Err(fault) if !self.connection.is_autocommit() => {
                match self.connection.execute_batch("ROLLBACK") {
                    Ok(()) => Err(fault),
                    Err(error) => Err(StoreFault::Fatal(format!(
                        "{fault}; then the rollback failed: {error}"
                    ))),
                }
            }
            outcome => outcome,
        };
        let is_tried = !matches!(&outcome, Ok((changes, _)) if changes.is_empty());
        if is_tried {
            let meter = &self.shared.meter;
            meter
                .is_full
                .store(matches!(outcome, Err(StoreFault::Full)), Ordering::Relaxed);
            meter
                .is_failing
                .store(matches!(outcome, Err(StoreFault::Io(_))), Ordering::Relaxed);
        }
        let (changes, is_worked) = outcome?;
        crash::point("store-synced");
        self.enter(changes);
        Ok(is_worked)
    }

    fn enter(&mut self, changes: Changes) {
        for (name, entry) in changes.swarms() {
            if entry.extent.bytes > self.quota_bytes {
                self.untidy.insert(name.clone());
            }
        }
        for (name, entry) in changes.all() {
            self.shared.beginnings.moved(name, entry);
        }
        self.wal_bytes += WAL_BYTES_PER_COMMIT;
        changes.enter(&mut self.catalog);
    }

    fn note_backlog(&self) {
        self.shared
            .meter
            .kept
            .store(self.backlog.writes(), Ordering::Relaxed);
        self.shared
            .meter
            .is_overrun
            .store(self.backlog.is_overrun(), Ordering::Relaxed);
    }

    /// Tells who waits what it came to. What panics there is not the store's.
    pub(super) fn tell(&self, wanted: Wanted, outcome: Result<(), StoreFault>) {
        let told = match (wanted, outcome) {
            (Wanted::Now(done), outcome) => catch_unwind(AssertUnwindSafe(|| done(outcome))),
            (Wanted::Soon(Some(told)), Ok(())) => catch_unwind(AssertUnwindSafe(told)),
            (Wanted::Soon(_), Err(StoreFault::Refused(reason))) => {
                self.shared.meter.refused.fetch_add(1, Ordering::Relaxed);
                warn!(
                    reason,
                    "writes nobody waited for contradict what is stored: left out"
                );
                Ok(())
            }
            (Wanted::Soon(_), _) => Ok(()),
        };
        if told.is_err() {
            error!("whoever waited for the store panicked");
        }
    }
}

/// Whether it deletes swarms, and at most notes an answer beside.
fn is_deletion(writes: &[Write]) -> bool {
    writes
        .iter()
        .any(|write| matches!(write, Write::Delete { .. }))
        && writes.iter().all(|write| {
            matches!(
                write,
                Write::Delete { .. } | Write::Answer(_) | Write::Forget { .. }
            )
        })
}
