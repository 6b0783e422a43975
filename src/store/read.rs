//! Reads. Each list is compared with its extent, so that missing records are reported.

use rusqlite::{Connection, Error as SqlError, OptionalExtension, Result as SqlResult, params};
use tracing::warn;

use super::Store;
use super::error::StoreError;
use super::integrity::{self, Extent};
use super::record::{Checkpoint, CheckpointInfo, Row, Rows, StoredReply};

/// Why something was not read.
pub(super) enum ReadError {
    /// An error of SQLite.
    Sql(SqlError),
    /// The error that follows from the records that were found.
    Found(StoreError),
}

impl From<SqlError> for ReadError {
    fn from(error: SqlError) -> ReadError {
        ReadError::Sql(error)
    }
}

impl Store {
    /// Names and metadata of the swarms, by name.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if a record is damaged or missing, and those of any read.
    pub fn swarms(&self) -> Result<Vec<(String, Vec<u8>)>, StoreError> {
        self.read(|snapshot| {
            let mut statement =
                snapshot.prepare_cached("SELECT name, id, seal, about FROM swarm ORDER BY name")?;
            let mut cursor = statement.query([])?;
            let (mut swarms, mut ids) = (Vec::<(String, Vec<u8>)>::new(), Vec::new());
            while let Some(record) = cursor.next()? {
                let last = swarms.last().map(|(name, _)| name.as_str());
                let Some(found) = integrity::swarm(record)? else {
                    return Err(self.damaged(last.unwrap_or(""), "the next record"));
                };
                let name = found.name;
                if !found.is_intact || last.is_some_and(|last| last >= name.as_str()) {
                    return Err(self.damaged(&name, "the record"));
                }
                let Some(extent) = integrity::read_extent(snapshot, found.id)? else {
                    return Err(self.damaged(&name, "the extent"));
                };
                if last_row(snapshot, found.id)? > extent.last {
                    return Err(self.damaged(&name, "the extent (less than its rows)"));
                }
                swarms.push((name, found.about));
                ids.push(found.id);
            }
            ids.sort_unstable();
            let extents: Vec<i64> = snapshot
                .prepare_cached("SELECT id FROM extent WHERE id <> 0 ORDER BY id")?
                .query_map([], |record| record.get(0))?
                .collect::<SqlResult<_>>()?;
            match ids == extents {
                true => Ok(swarms),
                false => Err(self.damaged("", "the list of swarms (incomplete)")),
            }
        })
    }

    /// The number of `swarm`. A swarm that gets the name of a deleted one has another number, and a larger one
    /// than every swarm that existed before it.
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSwarm`], [`StoreError::Damaged`], and those of any read.
    pub fn swarm_id(&self, swarm: &str) -> Result<u64, StoreError> {
        self.read(|snapshot| Ok(self.find(snapshot, swarm)?.0.cast_unsigned()))
    }

    /// At most `limit` rows after the row `after`, up to the first that is damaged or missing. If the
    /// rows after `after` are deleted, it begins with the first that is not.
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSwarm`], [`StoreError::Damaged`], and those of any read.
    pub fn rows(&self, swarm: &str, after: u64, limit: usize) -> Result<Rows, StoreError> {
        let read = self.read(|snapshot| {
            let (id, extent) = self.find(snapshot, swarm)?;
            let mut next = after.max(extent.first).saturating_add(1);
            let mut read = Rows::default();
            let mut statement = snapshot.prepare_cached(&format!(
                "SELECT {} FROM row WHERE swarm = ? AND number >= ? ORDER BY number LIMIT ?",
                integrity::ROW
            ))?;
            let max = i64::try_from(limit).unwrap_or(i64::MAX);
            let mut cursor = statement.query(params![id, next.cast_signed(), max])?;
            while next <= extent.last && read.rows.len() < limit {
                let row = match integrity::next(&mut cursor)? {
                    Some(record) => integrity::row(record, swarm, id)?,
                    None => None,
                };
                let Some(row) = row.filter(|row| row.number == next) else {
                    read.damaged_at = Some(next);
                    break;
                };
                read.rows.push(row);
                next += 1;
            }
            Ok(read)
        })?;
        if let Some(damaged_at) = read.damaged_at {
            let problem = "a row of the journal is damaged or missing";
            warn!(swarm, damaged_at, "{problem}");
            self.0.shared.meter.found_damaged(1);
        }
        Ok(read)
    }

    /// The rows of these kinds from number `first` to `last`, oldest first, until their bodies have
    /// `max_bytes`. Damaged ones are left out.
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSwarm`], [`StoreError::Damaged`], and those of any read.
    pub fn rows_of_kinds(
        &self,
        swarm: &str,
        kinds: [u8; 3],
        (first, last): (u64, u64),
        max_bytes: usize,
    ) -> Result<Vec<Row>, StoreError> {
        self.read(|snapshot| {
            let (id, _) = self.find(snapshot, swarm)?;
            let mut statement = snapshot.prepare_cached(&format!(
                "SELECT {} FROM row WHERE swarm = ? AND number BETWEEN ? AND ?
                 AND +kind IN (?, ?, ?) ORDER BY number",
                integrity::ROW
            ))?;
            let [first, last] = [first, last].map(u64::cast_signed);
            let [a, b, c] = kinds;
            let mut cursor = statement.query(params![id, first, last, a, b, c])?;
            let (mut rows, mut bytes) = (Vec::new(), 0);
            while bytes < max_bytes
                && let Some(record) = integrity::next(&mut cursor)?
            {
                if let Some(row) = integrity::row(record, swarm, id)? {
                    bytes += row.body.len() + 1;
                    rows.push(row);
                }
            }
            Ok(rows)
        })
    }

    /// The numbers of the first and the last row of `swarm`; the first is greater if it has none.
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSwarm`], [`StoreError::Damaged`], and those of any read.
    pub fn row_numbers(&self, swarm: &str) -> Result<(u64, u64), StoreError> {
        self.read(|snapshot| {
            let (_, extent) = self.find(snapshot, swarm)?;
            Ok((extent.first.saturating_add(1), extent.last))
        })
    }

    /// The checkpoints of `swarm`, newest first. Damaged ones are left out, logged and counted in
    /// [`Health::damaged`](super::Health::damaged).
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSwarm`], [`StoreError::Damaged`], and those of any read.
    pub fn checkpoints(&self, swarm: &str) -> Result<Vec<CheckpointInfo>, StoreError> {
        let (intact, damaged) = self.read(|snapshot| {
            let (id, extent) = self.find(snapshot, swarm)?;
            let mut statement = snapshot.prepare_cached(&format!(
                "SELECT {} FROM checkpoint WHERE swarm = ? ORDER BY number DESC",
                integrity::CHECKPOINT_INFO
            ))?;
            let mut cursor = statement.query([id])?;
            let (mut intact, mut found) = (Vec::<CheckpointInfo>::new(), 0);
            while let Some(record) = integrity::next(&mut cursor)? {
                found += 1;
                let Some((info, _)) = integrity::checkpoint_info(record, swarm, id)? else {
                    continue;
                };
                let is_next = match intact.last() {
                    Some(later) => info.number < later.number,
                    None => info.number <= extent.newest,
                };
                if is_next {
                    intact.push(info);
                }
            }
            let left_out = found - intact.len() as u64;
            Ok((intact, left_out.max(extent.checkpoints.abs_diff(found))))
        })?;
        if damaged > 0 {
            let problem = "checkpoints are damaged or missing: using older ones";
            warn!(swarm, damaged, "{problem}");
            self.0.shared.meter.found_damaged(damaged);
        }
        Ok(intact)
    }

    /// The oldest intact checkpoint of `swarm`: the journal is complete from there on.
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSwarm`], [`StoreError::Damaged`], and those of any read.
    pub fn history_from(&self, swarm: &str) -> Result<Option<CheckpointInfo>, StoreError> {
        self.read(|snapshot| {
            let (id, extent) = self.find(snapshot, swarm)?;
            let mut statement = snapshot.prepare_cached(&format!(
                "SELECT {} FROM checkpoint WHERE swarm = ? AND number <= ? ORDER BY number",
                integrity::CHECKPOINT_INFO
            ))?;
            let mut cursor = statement.query(params![id, extent.newest.cast_signed()])?;
            while let Some(record) = integrity::next(&mut cursor)? {
                if let Some((info, _)) = integrity::checkpoint_info(record, swarm, id)? {
                    return Ok(Some(info));
                }
            }
            Ok(None)
        })
    }

    /// The checkpoint `number` of `swarm` with its content.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if it differs from what was written, [`StoreError::NoCheckpoint`],
    /// [`StoreError::NoSwarm`], and those of any read.
    pub fn checkpoint(&self, swarm: &str, number: u64) -> Result<Checkpoint, StoreError> {
        self.read(|snapshot| {
            let (id, _) = self.find(snapshot, swarm)?;
            let missing = || StoreError::NoCheckpoint {
                swarm: swarm.to_owned(),
                number,
            };
            snapshot
                .prepare_cached(&format!(
                    "SELECT {} FROM checkpoint WHERE swarm = ? AND number = ?",
                    integrity::CHECKPOINT
                ))?
                .query_row(params![id, number.cast_signed()], |record| {
                    integrity::checkpoint(record, swarm, id)
                })
                .optional()?
                .ok_or_else(|| ReadError::Found(missing()))?
                .filter(|checkpoint| checkpoint.number == number)
                .ok_or_else(|| self.damaged(swarm, &format!("checkpoint {number}")))
        })
    }

    /// The replies, oldest first. Damaged ones are left out, logged and counted in
    /// [`Health::damaged`](super::Health::damaged).
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if their extent is damaged, and those of any read.
    pub fn replies(&self) -> Result<Vec<StoredReply>, StoreError> {
        let (replies, missing) = self.read(|snapshot| {
            let Some(extent) = integrity::read_extent(snapshot, integrity::REPLIES)? else {
                return Err(self.damaged("", "the extent of the replies"));
            };
            let Extent { first, last, .. } = extent;
            let deleted = extent.checkpoints;
            let expected = last.saturating_sub(first).saturating_sub(deleted);
            let mut statement = snapshot.prepare_cached(&format!(
                "SELECT {} FROM answer WHERE id > ? ORDER BY id",
                integrity::REPLY_COLUMNS
            ))?;
            let mut cursor = statement.query([first.cast_signed()])?;
            let (mut replies, mut next) = (Vec::new(), first + 1);
            while let Some(record) = cursor.next()? {
                // Those out of order or after the last one are not among the expected.
                if let Some((id, reply)) = integrity::reply(record)?
                    && (next..=last).contains(&id)
                {
                    next = id + 1;
                    replies.push(reply);
                }
            }
            let missing = expected.saturating_sub(replies.len() as u64);
            Ok((replies, missing))
        })?;
        if missing > 0 {
            let problem =
                "replies are damaged or missing: retries of these requests would be executed";
            warn!(damaged = missing, "{problem}");
            self.0.shared.meter.found_damaged(missing);
        }
        Ok(replies)
    }

    /// Whether a reply was ever deleted; false if that cannot be read.
    pub fn has_evicted(&self) -> bool {
        let extent = self.read(|it| Ok(integrity::read_extent(it, integrity::REPLIES)?));
        matches!(extent, Ok(Some(it)) if it.first > 0 || it.checkpoints > 0)
    }

    /// Reads one snapshot of the database.
    pub(super) fn read<T>(
        &self,
        read: impl FnOnce(&Connection) -> Result<T, ReadError>,
    ) -> Result<T, StoreError> {
        let reader = self.0.reader.lock();
        let connection = reader.as_ref().ok_or(StoreError::Stopped)?;
        let snapshot = connection.unchecked_transaction().map_err(ReadError::Sql);
        snapshot
            .and_then(|it| read(&it))
            .map_err(|error| match error {
                ReadError::Sql(error) => StoreError::of_reading(&self.0.file, &error),
                ReadError::Found(error) => error,
            })
    }

    /// Id and extent of `swarm`.
    pub(super) fn find(
        &self,
        snapshot: &Connection,
        swarm: &str,
    ) -> Result<(i64, Extent), ReadError> {
        match integrity::find(snapshot, swarm)? {
            Some((id, Some(extent))) => Ok((id, extent)),
            Some((_, None)) => Err(self.damaged(swarm, "the extent")),
            None => Err(ReadError::Found(StoreError::NoSwarm(swarm.to_owned()))),
        }
    }

    /// The error for a damaged record of a swarm, or of none (`""`).
    fn damaged(&self, swarm: &str, what: &str) -> ReadError {
        ReadError::Found(StoreError::Damaged {
            file: self.0.file.clone(),
            swarm: swarm.to_owned(),
            what: what.to_owned(),
        })
    }
}

fn last_row(snapshot: &Connection, id: i64) -> SqlResult<u64> {
    let mut statement =
        snapshot.prepare_cached("SELECT coalesce(max(number), 0) FROM row WHERE swarm = ?")?;
    statement.query_row([id], |record| {
        record.get::<_, i64>(0).map(i64::cast_unsigned)
    })
}
