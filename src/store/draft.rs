//! A transaction on its way: what it writes, and what the catalog will be when it is committed.

use std::collections::{BTreeMap, BTreeSet};

use rusqlite::{Connection, OptionalExtension, Result as SqlResult, params};

use super::Write;
use super::catalog::{Catalog, Entry};
use super::crash;
use super::extent::{self, Extent};
use super::mend;
use super::record::{Answer, Checkpoint, Row, cost, seal_swarm};
use super::seal::digest;

/// The changes of one transaction.
pub(super) struct Draft<'a> {
    connection: &'a Connection,
    catalog: &'a Catalog,
    changes: Changes,
}

/// What a committed transaction changed.
#[derive(Default)]
pub(super) struct Changes {
    swarms: BTreeMap<String, Option<Entry>>,
    answers: Option<Extent>,
    gone: BTreeSet<i64>,
    swept: BTreeSet<i64>,
    next_id: Option<i64>,
}

impl<'a> Draft<'a> {
    /// Begins with nothing changed; the transaction on `connection` has begun.
    pub(super) fn new(connection: &'a Connection, catalog: &'a Catalog) -> Draft<'a> {
        Draft {
            connection,
            catalog,
            changes: Changes::default(),
        }
    }

    /// The transaction's connection.
    pub(super) fn connection(&self) -> &'a Connection {
        self.connection
    }

    /// Whether `writes` can follow; if not, why.
    ///
    /// # Errors
    ///
    /// What they contradict.
    pub(super) fn check(&self, writes: &[Write]) -> Result<(), String> {
        let is_answer = |write: &Write| matches!(write, Write::Answer(_) | Write::Forget { .. });
        if self.catalog.answers.is_none() && writes.iter().any(is_answer) {
            return Err("the record of the answers is damaged".to_string());
        }
        self.catalog.check(&self.changes.swarms, writes)
    }

    /// Writes what has been checked.
    pub(super) fn apply(&mut self, write: &Write) -> SqlResult<()> {
        match write {
            Write::Create {
                swarm,
                about,
                first,
            } => self.create(swarm, about, first),
            Write::Append { swarm, row } => self.append(swarm, row),
            Write::Keep { swarm, checkpoint } => self.keep(swarm, checkpoint),
            Write::Cut { swarm, after } => self.cut(swarm, *after),
            Write::Delete { swarm } => self.delete(swarm),
            Write::Answer(answer) => self.answer(answer),
            Write::Forget { client, request_id } => {
                self.forget_answer(client.as_deref(), request_id)
            }
        }
    }

    /// Writes what there is now of what changed; the transaction can be committed.
    pub(super) fn finish(self) -> SqlResult<Changes> {
        for entry in self.changes.swarms.values().flatten() {
            extent::write(self.connection, entry.id, &entry.extent)?;
        }
        if let Some(answers) = &self.changes.answers {
            extent::write(self.connection, extent::ANSWERS, answers)?;
        }
        Ok(self.changes)
    }

    /// The swarm's entry as it is now, if there is such a swarm.
    pub(super) fn known(&self, swarm: &str) -> Option<&Entry> {
        match self.changes.swarms.get(swarm) {
            Some(entry) => entry.as_ref(),
            None => self.catalog.swarms.get(swarm),
        }
    }

    /// The swarm's entry, to be changed; `None` if there is no such swarm.
    pub(super) fn entry(&mut self, swarm: &str) -> Option<&mut Entry> {
        if !self.changes.swarms.contains_key(swarm) {
            let entry = self.catalog.swarms.get(swarm)?.clone();
            self.changes.swarms.insert(swarm.to_string(), Some(entry));
        }
        self.changes.swarms.get_mut(swarm)?.as_mut()
    }

    /// Which answers there are, to be changed.
    pub(super) fn answers(&mut self) -> Option<&mut Extent> {
        let known = self.catalog.answers.as_ref()?;
        Some(self.changes.answers.get_or_insert_with(|| known.clone()))
    }

    /// Notes that nothing is left of the deleted swarm `id`.
    pub(super) fn forget(&mut self, id: i64) -> SqlResult<()> {
        self.connection
            .prepare_cached("DELETE FROM gone WHERE swarm = ?")?
            .execute([id])?;
        self.changes.swept.insert(id);
        Ok(())
    }

    fn create(&mut self, swarm: &str, about: &[u8], first: &Checkpoint) -> SqlResult<()> {
        let id = self.changes.next_id.unwrap_or(self.catalog.next_id);
        self.changes.next_id = Some(id + 1);
        self.connection
            .prepare_cached("INSERT INTO swarm (name, id, seal, about) VALUES (?, ?, ?, ?)")?
            .execute(params![swarm, id, seal_swarm(swarm, id, about), about])?;
        let (first_row, bytes) = (first.number, 0);
        let extent = Extent {
            first: first_row,
            last: first_row,
            newest: first_row,
            checkpoints: 0,
            bytes,
        };
        self.changes
            .swarms
            .insert(swarm.to_string(), Some(Entry { id, extent }));
        self.keep(swarm, first)
    }

    fn append(&mut self, swarm: &str, row: &Row) -> SqlResult<()> {
        let connection = self.connection;
        let Some(Entry { id, extent }) = self.entry(swarm) else {
            return Ok(());
        };
        extent.last = row.number;
        extent.bytes += cost(row.body.len());
        let [number, epoch, step] = [row.number, row.epoch, row.step].map(u64::cast_signed);
        connection
            .prepare_cached(
                "INSERT INTO row (swarm, number, epoch, step, kind, seal, body)
                 VALUES (?, ?, ?, ?, ?, ?, ?)",
            )?
            .execute(params![
                *id,
                number,
                epoch,
                step,
                row.kind,
                row.seal(swarm, *id),
                row.body
            ])?;
        Ok(())
    }

    fn keep(&mut self, swarm: &str, checkpoint: &Checkpoint) -> SqlResult<()> {
        let connection = self.connection;
        let Some(Entry { id, extent }) = self.entry(swarm) else {
            return Ok(());
        };
        let mark = checkpoint.mark();
        let [number, epoch, step] = [mark.number, mark.epoch, mark.step].map(u64::cast_signed);
        let replaced: Option<i64> = connection
            .prepare_cached("SELECT length(body) FROM checkpoint WHERE swarm = ? AND number = ?")?
            .query_row(params![*id, number], |row| row.get(0))
            .optional()?;
        match replaced.map(|bytes| cost(usize::try_from(bytes).unwrap_or(0))) {
            Some(bytes) => extent.bytes = extent.bytes.saturating_sub(bytes),
            None => extent.checkpoints += 1,
        }
        crash::point("store-keep");
        extent.newest = mark.number;
        extent.bytes += cost(checkpoint.body.len());
        let digest = digest(&checkpoint.body);
        connection
            .prepare_cached(
                "INSERT OR REPLACE INTO checkpoint (swarm, number, epoch, step, seal, digest, body)
                 VALUES (?, ?, ?, ?, ?, ?, ?)",
            )?
            .execute(params![
                *id,
                number,
                epoch,
                step,
                mark.seal(swarm, *id, &digest),
                digest,
                checkpoint.body
            ])?;
        Ok(())
    }

    fn cut(&mut self, swarm: &str, after: u64) -> SqlResult<()> {
        let connection = self.connection;
        mend::put_in_order(connection)?;
        let Some(Entry { id, extent }) = self.entry(swarm) else {
            return Ok(());
        };
        let number = after.cast_signed();
        connection
            .prepare_cached("DELETE FROM row WHERE swarm = ? AND number > ?")?
            .execute(params![*id, number])?;
        connection
            .prepare_cached("DELETE FROM checkpoint WHERE swarm = ? AND number > ?")?
            .execute(params![*id, number])?;
        let sums = |table: &str| -> SqlResult<(u64, u64, u64)> {
            let query = format!(
                "SELECT count(*), coalesce(sum(length(body)), 0), coalesce(max(number), 0)
                 FROM {table} WHERE swarm = ?"
            );
            connection.query_row(&query, [*id], |row| {
                let number = |column| row.get::<_, i64>(column).map(i64::cast_unsigned);
                Ok((number(0)?, number(1)?, number(2)?))
            })
        };
        let (rows, row_bytes, _) = sums("row")?;
        let (checkpoints, checkpoint_bytes, newest) = sums("checkpoint")?;
        extent.last = after;
        extent.newest = newest;
        extent.checkpoints = checkpoints;
        extent.bytes = row_bytes + checkpoint_bytes + (rows + checkpoints) * cost(0);
        Ok(())
    }

    fn delete(&mut self, swarm: &str) -> SqlResult<()> {
        let id = match self.entry(swarm) {
            Some(entry) => Some(entry.id),
            None => self.catalog.damaged.get(swarm).copied(),
        };
        let Some(id) = id else { return Ok(()) };
        self.connection
            .prepare_cached("DELETE FROM swarm WHERE name = ?")?
            .execute([swarm])?;
        self.connection
            .prepare_cached("DELETE FROM extent WHERE id = ?")?
            .execute([id])?;
        self.connection
            .prepare_cached("INSERT INTO gone (swarm) VALUES (?)")?
            .execute([id])?;
        self.changes.swarms.insert(swarm.to_string(), None);
        self.changes.gone.insert(id);
        Ok(())
    }

    fn answer(&mut self, answer: &Answer) -> SqlResult<()> {
        let connection = self.connection;
        let Some(extent) = self.answers() else {
            return Ok(());
        };
        extent.last += 1;
        extent.bytes += cost(answer.body.len());
        connection
            .prepare_cached(
                "INSERT INTO answer
                     (id, client, request_id, digest, swarm, number, is_ok, encoding, seal, body)
                 VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            )?
            .execute(params![
                extent.last.cast_signed(),
                answer.client,
                answer.request_id,
                answer.digest,
                answer.swarm,
                answer.number.cast_signed(),
                answer.is_ok,
                answer.encoding,
                answer.seal(extent.last),
                answer.body
            ])?;
        Ok(())
    }

    /// Deletes the answers to a request: there are two where the swarm's own commit had one too.
    fn forget_answer(&mut self, client: Option<&str>, request_id: &str) -> SqlResult<()> {
        let connection = self.connection;
        let Some(extent) = self.answers() else {
            return Ok(());
        };
        let mut statement = connection.prepare_cached(
            "DELETE FROM answer WHERE request_id = ? AND client IS ? RETURNING length(body)",
        )?;
        let mut deleted = statement.query(params![request_id, client])?;
        while let Some(row) = deleted.next()? {
            let bytes = usize::try_from(row.get::<_, i64>(0)?).unwrap_or(0);
            extent.checkpoints += 1;
            extent.bytes = extent.bytes.saturating_sub(cost(bytes));
        }
        Ok(())
    }
}

impl Changes {
    /// Whether nothing changed.
    pub(super) fn is_empty(&self) -> bool {
        self.swarms.is_empty()
            && self.answers.is_none()
            && self.gone.is_empty()
            && self.swept.is_empty()
    }

    /// The swarms that changed and are still there.
    pub(super) fn swarms(&self) -> impl Iterator<Item = (&String, &Entry)> {
        self.swarms
            .iter()
            .filter_map(|(name, entry)| Some((name, entry.as_ref()?)))
    }

    /// The swarms that changed, those that are gone too.
    pub(super) fn all(&self) -> impl Iterator<Item = (&String, Option<&Entry>)> {
        self.swarms
            .iter()
            .map(|(name, entry)| (name, entry.as_ref()))
    }

    /// Makes the catalog what is committed now.
    pub(super) fn enter(self, catalog: &mut Catalog) {
        for (name, entry) in self.swarms {
            catalog.damaged.remove(&name);
            match entry {
                Some(entry) => _ = catalog.swarms.insert(name, entry),
                None => _ = catalog.swarms.remove(&name),
            }
        }
        if self.answers.is_some() {
            catalog.answers = self.answers;
        }
        catalog.gone.extend(self.gone);
        for id in self.swept {
            catalog.gone.remove(&id);
        }
        catalog.next_id = self.next_id.unwrap_or(catalog.next_id);
    }
}
