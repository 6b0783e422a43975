//! Queries. Each list is compared with its extent, so that missing records are reported.

use std::path::Path;

use rusqlite::{Connection, Error as SqlError, OptionalExtension, Result as SqlResult, params};

use super::error::StoreError;
use super::integrity::{self, Extent};
use super::record::{Answer, Checkpoint, CheckpointInfo, Rows};

/// Why something was not read.
pub(super) enum ReadError {
    /// An error of SQLite.
    Sql(SqlError),
    /// The swarm is not stored.
    NoSwarm,
    /// The checkpoint is not stored.
    NoCheckpoint(u64),
    /// A record of a swarm, or one that belongs to no swarm (`""`), is damaged.
    Damaged { swarm: String, what: String },
}

impl From<SqlError> for ReadError {
    fn from(error: SqlError) -> ReadError {
        ReadError::Sql(error)
    }
}

impl ReadError {
    fn damaged(swarm: &str, what: impl Into<String>) -> ReadError {
        ReadError::Damaged {
            swarm: swarm.to_owned(),
            what: what.into(),
        }
    }

    /// The error of a read of `swarm` in `file`.
    pub(super) fn into_store_error(self, file: &Path, swarm: &str) -> StoreError {
        let (file, of_swarm) = (file.to_path_buf(), swarm.to_string());
        match self {
            ReadError::Sql(error) => StoreError::of_reading(&file, &error),
            ReadError::NoSwarm => StoreError::NoSwarm { swarm: of_swarm },
            ReadError::NoCheckpoint(number) => StoreError::NoCheckpoint {
                swarm: of_swarm,
                number,
            },
            ReadError::Damaged { swarm, what } => StoreError::Damaged { file, swarm, what },
        }
    }
}

/// Names and metadata of the swarms, by name.
pub(super) fn swarms(connection: &Connection) -> Result<Vec<(String, Vec<u8>)>, ReadError> {
    let snapshot = connection.unchecked_transaction()?;
    let mut statement =
        snapshot.prepare_cached("SELECT name, id, seal, about FROM swarm ORDER BY name")?;
    let mut cursor = statement.query([])?;
    let (mut swarms, mut ids) = (Vec::<(String, Vec<u8>)>::new(), Vec::new());
    while let Some(record) = cursor.next()? {
        let last = swarms.last().map(|(name, _)| name.as_str());
        let Some(found) = integrity::swarm(record)? else {
            return Err(ReadError::damaged(last.unwrap_or(""), "the next record"));
        };
        let name = found.name;
        if !found.is_intact || last.is_some_and(|last| last >= name.as_str()) {
            return Err(ReadError::damaged(&name, "the record"));
        }
        let Some(extent) = integrity::read_extent(&snapshot, found.id)? else {
            return Err(ReadError::damaged(&name, "the extent"));
        };
        if last_row(&snapshot, found.id)? > extent.last {
            return Err(ReadError::damaged(&name, "the extent (less than its rows)"));
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
        false => Err(ReadError::damaged("", "the list of swarms (incomplete)")),
    }
}

fn last_row(connection: &Connection, id: i64) -> SqlResult<u64> {
    connection
        .prepare_cached("SELECT coalesce(max(number), 0) FROM row WHERE swarm = ?")?
        .query_row([id], |record| {
            record.get::<_, i64>(0).map(i64::cast_unsigned)
        })
}

/// The rows of `swarm` after the row `after`, at most `limit`.
pub(super) fn rows(
    connection: &Connection,
    swarm: &str,
    after: u64,
    limit: usize,
) -> Result<Rows, ReadError> {
    let snapshot = connection.unchecked_transaction()?;
    let (id, extent) = find(&snapshot, swarm)?;
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
}

/// The checkpoints of `swarm`, newest first, and how many are damaged or missing.
pub(super) fn checkpoints(
    connection: &Connection,
    swarm: &str,
) -> Result<(Vec<CheckpointInfo>, u64), ReadError> {
    let snapshot = connection.unchecked_transaction()?;
    let (id, extent) = find(&snapshot, swarm)?;
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
}

/// The oldest intact checkpoint of `swarm`.
pub(super) fn oldest_checkpoint(
    connection: &Connection,
    swarm: &str,
) -> Result<Option<CheckpointInfo>, ReadError> {
    let snapshot = connection.unchecked_transaction()?;
    let (id, extent) = find(&snapshot, swarm)?;
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
}

/// The checkpoint `number` of `swarm`.
pub(super) fn checkpoint(
    connection: &Connection,
    swarm: &str,
    number: u64,
) -> Result<Checkpoint, ReadError> {
    let snapshot = connection.unchecked_transaction()?;
    let (id, _) = find(&snapshot, swarm)?;
    snapshot
        .prepare_cached(&format!(
            "SELECT {} FROM checkpoint WHERE swarm = ? AND number = ?",
            integrity::CHECKPOINT
        ))?
        .query_row(params![id, number.cast_signed()], |record| {
            integrity::checkpoint(record, swarm, id)
        })
        .optional()?
        .ok_or(ReadError::NoCheckpoint(number))?
        .filter(|checkpoint| checkpoint.number == number)
        .ok_or_else(|| ReadError::damaged(swarm, format!("checkpoint {number}")))
}

/// All answers, oldest first, and how many are damaged or missing.
pub(super) fn answers(connection: &Connection) -> Result<(Vec<Answer>, u64), ReadError> {
    let snapshot = connection.unchecked_transaction()?;
    let Some(extent) = integrity::read_extent(&snapshot, integrity::ANSWERS)? else {
        return Err(ReadError::damaged("", "the extent of the answers"));
    };
    let Extent { first, last, .. } = extent;
    let deleted = extent.checkpoints;
    let expected = last.saturating_sub(first).saturating_sub(deleted);
    let mut statement = snapshot.prepare_cached(&format!(
        "SELECT {} FROM answer WHERE id > ? ORDER BY id",
        integrity::ANSWER
    ))?;
    let mut cursor = statement.query([first.cast_signed()])?;
    let (mut answers, mut next) = (Vec::new(), first + 1);
    while let Some(record) = cursor.next()? {
        // Those out of order or after the last one are not among the expected.
        if let Some((id, answer)) = integrity::answer(record)?
            && (next..=last).contains(&id)
        {
            next = id + 1;
            answers.push(answer);
        }
    }
    let missing = expected.saturating_sub(answers.len() as u64);
    Ok((answers, missing))
}

/// Whether an answer was ever deleted.
pub(super) fn has_forgotten(connection: &Connection) -> Result<bool, ReadError> {
    let extent = integrity::read_extent(connection, integrity::ANSWERS)?;
    Ok(extent.is_some_and(|it| it.first > 0 || it.checkpoints > 0))
}

/// Id and extent of `swarm`.
fn find(connection: &Connection, swarm: &str) -> Result<(i64, Extent), ReadError> {
    let (id, extent) = integrity::find(connection, swarm)?.ok_or(ReadError::NoSwarm)?;
    Ok((
        id,
        extent.ok_or_else(|| ReadError::damaged(swarm, "the extent"))?,
    ))
}
