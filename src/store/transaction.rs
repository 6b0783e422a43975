//! A write transaction: checks the writes of each submit and applies all of them or none.

use std::collections::BTreeSet;

use rusqlite::{Connection, Error as SqlError, OptionalExtension, Result as SqlResult, params};

use super::audit;
use super::integrity::{self, Extent};
use super::record::{Checkpoint, Row, StoredReply, cost};
use super::repair;
use super::{Settings, Write};
use crate::failpoint;

/// The open transaction of a connection.
pub(super) struct Transaction<'a> {
    pub(super) connection: &'a Connection,
    settings: Settings,
    /// Whether anything was written.
    pub(super) has_changed: bool,
    /// Swarms that were written and take more than the quota.
    pub(super) over_quota: BTreeSet<String>,
}

/// Why a write is not applied.
enum WriteError {
    /// It contradicts what is stored.
    Rejected(String),
    Sql(SqlError),
}

impl From<SqlError> for WriteError {
    fn from(error: SqlError) -> WriteError {
        WriteError::Sql(error)
    }
}

fn rejected(reason: impl Into<String>) -> WriteError {
    WriteError::Rejected(reason.into())
}

impl<'a> Transaction<'a> {
    /// The transaction that has begun on `connection`.
    pub(super) fn new(connection: &'a Connection, settings: Settings) -> Transaction<'a> {
        Transaction {
            connection,
            settings,
            has_changed: false,
            over_quota: BTreeSet::new(),
        }
    }

    /// Applies all `writes` of a submit; `Ok(Err(reason))` if one contradicts what is stored, and then
    /// none.
    pub(super) fn apply(&mut self, writes: &[Write]) -> SqlResult<Result<(), String>> {
        let had_changed = self.has_changed;
        self.execute("SAVEPOINT submit")?;
        let applied = writes.iter().try_for_each(|write| self.write(write));
        let outcome = match applied {
            Ok(()) => Ok(()),
            Err(WriteError::Rejected(reason)) => {
                self.execute("ROLLBACK TO submit")?;
                self.has_changed = had_changed;
                Err(reason)
            }
            Err(WriteError::Sql(error)) => return Err(error),
        };
        self.execute("RELEASE submit")?;
        Ok(outcome)
    }

    /// Id and extent of `swarm`, if both are intact.
    pub(super) fn find(&self, swarm: &str) -> SqlResult<Option<(i64, Extent)>> {
        let found = integrity::find(self.connection, swarm)?;
        Ok(found.and_then(|(id, extent)| Some((id, extent?))))
    }

    pub(super) fn set_extent(&mut self, swarm: &str, id: i64, extent: &Extent) -> SqlResult<()> {
        if extent.bytes > self.settings.quota_bytes {
            self.over_quota.insert(swarm.to_owned());
        }
        self.has_changed = true;
        integrity::write_extent(self.connection, id, extent)
    }

    /// Writes the extent of the replies as it is, which fails while the disk is full.
    pub(super) fn probe(&mut self) -> SqlResult<()> {
        match integrity::read_extent(self.connection, integrity::REPLIES)? {
            Some(extent) => self.set_replies_extent(&extent),
            None => Ok(()),
        }
    }

    fn write(&mut self, write: &Write) -> Result<(), WriteError> {
        match write {
            Write::Create {
                swarm,
                about,
                first,
            } => self.create(swarm, about, first),
            Write::Append { swarm, row } => self.append(swarm, row),
            Write::SaveCheckpoint { swarm, checkpoint } => self.save_checkpoint(swarm, checkpoint),
            Write::Truncate { swarm, after } => self.truncate(swarm, *after),
            Write::Delete { swarm } => self.delete(swarm),
            Write::InsertReply(reply) => self.insert_reply(reply),
            Write::DeleteReply { client, request_id } => {
                self.delete_reply(client.as_deref(), request_id)
            }
            Write::Audit(line) => {
                let Settings {
                    audit_bytes,
                    audit_ms,
                    ..
                } = self.settings;
                self.has_changed = true;
                Ok(audit::write(
                    self.connection,
                    line,
                    (audit_bytes, audit_ms),
                )?)
            }
        }
    }

    fn create(&mut self, swarm: &str, about: &[u8], first: &Checkpoint) -> Result<(), WriteError> {
        match integrity::find(self.connection, swarm)? {
            None if i64::try_from(first.number).is_ok() => {}
            Some((_, None)) => return Err(rejected(DAMAGED)),
            _ => return Err(rejected("the swarm exists")),
        }
        // No id that a swarm had before, or under which a damaged file still has records.
        let id: i64 = self
            .connection
            .prepare_cached(
                "SELECT 1 + max(
                     (SELECT coalesce(max(id), 0) FROM swarm), (SELECT coalesce(max(id), 0) FROM extent),
                     (SELECT coalesce(max(swarm), 0) FROM row),
                     (SELECT coalesce(max(swarm), 0) FROM checkpoint),
                     (SELECT coalesce(max(abs(swarm)), 0) FROM gone))",
            )?
            .query_row([], |record| record.get(0))?;
        integrity::insert_swarm(self.connection, swarm, id, about)?;
        let extent = Extent {
            first: first.number,
            last: first.number,
            newest: first.number,
            ..Extent::default()
        };
        self.set_extent(swarm, id, &extent)?;
        self.save_checkpoint(swarm, first)
    }

    fn append(&mut self, swarm: &str, row: &Row) -> Result<(), WriteError> {
        let (id, mut extent) = self.existing(swarm)?;
        if row.number != extent.last + 1 || i64::try_from(row.number).is_err() {
            let (number, last) = (row.number, extent.last);
            return Err(rejected(format!("row {number} does not follow row {last}")));
        }
        extent.last = row.number;
        extent.bytes += cost(row.body.len());
        integrity::insert_row(self.connection, "INSERT INTO row", (swarm, id), row)?;
        Ok(self.set_extent(swarm, id, &extent)?)
    }

    fn save_checkpoint(&mut self, swarm: &str, checkpoint: &Checkpoint) -> Result<(), WriteError> {
        let (id, mut extent) = self.existing(swarm)?;
        let (number, newest, last) = (checkpoint.number, extent.newest, extent.last);
        if number < newest || number > last {
            return Err(rejected(format!(
                "checkpoint {number} is not within {newest} to {last}"
            )));
        }
        let replaced: Option<i64> = self
            .connection
            .prepare_cached("SELECT length(body) FROM checkpoint WHERE swarm = ? AND number = ?")?
            .query_row(params![id, number.cast_signed()], |record| record.get(0))
            .optional()?;
        match replaced.map(|bytes| cost(usize::try_from(bytes).unwrap_or(0))) {
            Some(bytes) => extent.bytes = extent.bytes.saturating_sub(bytes),
            None => extent.checkpoints += 1,
        }
        failpoint::kill("store-keep");
        extent.newest = number;
        extent.bytes += cost(checkpoint.body.len());
        let insert = "INSERT OR REPLACE INTO checkpoint";
        integrity::insert_checkpoint(self.connection, insert, (swarm, id), checkpoint)?;
        Ok(self.set_extent(swarm, id, &extent)?)
    }

    fn truncate(&mut self, swarm: &str, after: u64) -> Result<(), WriteError> {
        let (id, mut extent) = self.existing(swarm)?;
        let (first, last) = (extent.first, extent.last);
        if after < first || after > last {
            return Err(rejected(format!(
                "row {after} is not within {first} to {last}"
            )));
        }
        repair::rewrite(self.connection)?;
        for table in ["row", "checkpoint"] {
            let delete = format!("DELETE FROM {table} WHERE swarm = ? AND number > ?");
            self.connection
                .execute(&delete, params![id, after.cast_signed()])?;
        }
        let sums = |table| {
            let query = format!(
                "SELECT count(*), coalesce(sum(length(body)), 0), coalesce(max(number), 0)
                 FROM {table} WHERE swarm = ?"
            );
            self.connection.query_row(&query, [id], |record| {
                let number = |column| record.get::<_, i64>(column).map(i64::cast_unsigned);
                Ok([number(0)?, number(1)?, number(2)?])
            })
        };
        let [rows, row_bytes, _] = sums("row")?;
        let [checkpoints, checkpoint_bytes, newest] = sums("checkpoint")?;
        extent.newest = newest;
        extent.checkpoints = checkpoints;
        extent.bytes = row_bytes + checkpoint_bytes + (rows + checkpoints) * cost(0);
        extent.last = after;
        Ok(self.set_extent(swarm, id, &extent)?)
    }

    fn delete(&mut self, swarm: &str) -> Result<(), WriteError> {
        let found = integrity::find(self.connection, swarm)?;
        let (id, _) = found.ok_or_else(|| rejected(MISSING))?;
        self.has_changed = true;
        self.connection
            .prepare_cached("DELETE FROM swarm WHERE name = ?")?
            .execute([swarm])?;
        for statement in [
            "DELETE FROM extent WHERE id = ?",
            "INSERT INTO gone (swarm) VALUES (?)",
        ] {
            self.connection.prepare_cached(statement)?.execute([id])?;
        }
        Ok(())
    }

    fn insert_reply(&mut self, reply: &StoredReply) -> Result<(), WriteError> {
        let mut extent = self.replies_extent()?;
        extent.last += 1;
        extent.bytes += cost(reply.body.len());
        integrity::insert_reply(self.connection, extent.last, reply)?;
        Ok(self.set_replies_extent(&extent)?)
    }

    /// Deletes the replies to a request: there are two if the commit of the swarm had one too.
    fn delete_reply(&mut self, client: Option<&str>, request_id: &str) -> Result<(), WriteError> {
        let mut extent = self.replies_extent()?;
        let mut statement = self.connection.prepare_cached(
            "DELETE FROM answer WHERE request_id = ? AND client IS ? RETURNING length(body)",
        )?;
        let mut deleted = statement.query(params![request_id, client])?;
        while let Some(record) = deleted.next()? {
            let bytes = usize::try_from(record.get::<_, i64>(0)?).unwrap_or(0);
            extent.checkpoints += 1;
            extent.bytes = extent.bytes.saturating_sub(cost(bytes));
        }
        Ok(self.set_replies_extent(&extent)?)
    }

    fn existing(&self, swarm: &str) -> Result<(i64, Extent), WriteError> {
        match integrity::find(self.connection, swarm)? {
            Some((id, Some(extent))) => Ok((id, extent)),
            Some((_, None)) => Err(rejected(DAMAGED)),
            None => Err(rejected(MISSING)),
        }
    }

    fn replies_extent(&self) -> Result<Extent, WriteError> {
        let extent = integrity::read_extent(self.connection, integrity::REPLIES)?;
        extent.ok_or_else(|| rejected("the record of the replies is damaged"))
    }

    fn set_replies_extent(&mut self, extent: &Extent) -> SqlResult<()> {
        self.has_changed = true;
        integrity::write_extent(self.connection, integrity::REPLIES, extent)
    }

    fn execute(&self, statement: &str) -> SqlResult<()> {
        self.connection.prepare_cached(statement)?.execute([])?;
        Ok(())
    }
}

const MISSING: &str = "there is no such swarm";
const DAMAGED: &str = "the swarm's record is damaged; it can only be deleted";
