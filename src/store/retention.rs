//! Deletes what is not retained, in pieces so small that no commit waits long for one.

use std::collections::BTreeSet;

use rusqlite::{Connection, Result as SqlResult, params};

use super::notes;
use super::record::cost;
use super::transaction::Transaction;

/// Rows deleted in one piece.
const ROWS_PER_PIECE: i64 = 1000;

/// Checkpoints deleted in one piece.
const CHECKPOINTS_PER_PIECE: usize = 4;

/// Checkpoints between the oldest and the two newest below which they are not thinned further, so that
/// the history still has some points to replay from.
const MIN_BETWEEN: usize = 8;

/// A deleted swarm that still has rows or checkpoints: `gone` lists them, and the largest id of those that are
/// swept, as a negative number.
pub(super) fn tombstone(connection: &Connection) -> SqlResult<Option<i64>> {
    connection
        .prepare_cached("SELECT min(swarm) FROM gone WHERE swarm > 0")?
        .query_row([], |record| record.get(0))
}

/// Deletes one piece; whether there was one.
///
/// Swarms that have nothing to delete are removed from `candidates`.
pub(super) fn sweep(
    transaction: &mut Transaction<'_>,
    candidates: &mut BTreeSet<String>,
    quota_bytes: u64,
) -> SqlResult<bool> {
    if let Some(id) = tombstone(transaction.connection)? {
        transaction.has_changed = true;
        return sweep_deleted(transaction.connection, id).map(|()| true);
    }
    while let Some(swarm) = candidates.first().cloned() {
        if sweep_rows(transaction, &swarm)? || shorten_history(transaction, &swarm, quota_bytes)? {
            return Ok(true);
        }
        candidates.remove(&swarm);
    }
    Ok(false)
}

/// Deletes a piece of a deleted swarm, or its tombstone if nothing else is left.
fn sweep_deleted(connection: &Connection, id: i64) -> SqlResult<()> {
    for (table, limit) in [
        ("row", ROWS_PER_PIECE),
        ("checkpoint", CHECKPOINTS_PER_PIECE as i64),
    ] {
        let delete = format!(
            "DELETE FROM {table} WHERE swarm = ?1 AND number IN
                 (SELECT number FROM {table} WHERE swarm = ?1 ORDER BY number LIMIT ?2)"
        );
        let mut statement = connection.prepare_cached(&delete)?;
        if statement.execute(params![id, limit])? > 0 {
            return Ok(());
        }
    }
    connection.execute("DELETE FROM gone WHERE swarm = ?", [id])?;
    // No later swarm gets the largest id.
    let keep = "INSERT INTO gone (swarm) SELECT -?1
                WHERE NOT EXISTS (SELECT 1 FROM swarm WHERE id > ?1)
                AND NOT EXISTS (SELECT 1 FROM gone WHERE swarm <= -?1)";
    connection.execute(keep, [id])?;
    let smaller = "DELETE FROM gone WHERE swarm < 0 AND swarm > (SELECT min(swarm) FROM gone)";
    connection.execute(smaller, [])?;
    Ok(())
}

/// Deletes a piece of the rows before the oldest checkpoint; whether there were any.
fn sweep_rows(transaction: &mut Transaction<'_>, swarm: &str) -> SqlResult<bool> {
    let connection = transaction.connection;
    let Some((id, mut extent)) = transaction.find(swarm)? else {
        return Ok(false);
    };
    let (count, bytes, last): (i64, i64, Option<i64>) = connection
        .prepare_cached(
            "SELECT count(*), coalesce(sum(bytes), 0), max(number) FROM
                 (SELECT number, length(body) AS bytes FROM row
                  WHERE swarm = ? AND number <= ? ORDER BY number LIMIT ?)",
        )?
        .query_row(
            params![id, extent.first.cast_signed(), ROWS_PER_PIECE],
            |record| Ok((record.get(0)?, record.get(1)?, record.get(2)?)),
        )?;
    let Some(last) = last else { return Ok(false) };
    connection
        .prepare_cached("DELETE FROM row WHERE swarm = ? AND number <= ?")?
        .execute(params![id, last])?;
    let freed = bytes.cast_unsigned() + count.cast_unsigned() * cost(0);
    extent.bytes = extent.bytes.saturating_sub(freed);
    transaction.set_extent(swarm, id, &extent)?;
    Ok(true)
}

/// Deletes checkpoints of a swarm that takes more than its quota besides its notes; whether there were
/// any to delete.
///
/// The two newest and all rows after the older of them always stay.
fn shorten_history(
    transaction: &mut Transaction<'_>,
    swarm: &str,
    quota_bytes: u64,
) -> SqlResult<bool> {
    let connection = transaction.connection;
    let Some((id, mut extent)) = transaction.find(swarm)? else {
        return Ok(false);
    };
    if extent.bytes <= quota_bytes {
        return Ok(false);
    }
    let max_bytes = quota_bytes.saturating_add(notes::bytes(connection, id)?);
    if extent.bytes <= max_bytes {
        return Ok(false);
    }
    let mut checkpoints: Vec<(i64, u64)> = connection
        .prepare_cached(
            "SELECT number, length(body) FROM checkpoint WHERE swarm = ? ORDER BY number",
        )?
        .query_map([id], |record| {
            let bytes = usize::try_from(record.get::<_, i64>(1)?).unwrap_or(0);
            Ok((record.get(0)?, cost(bytes)))
        })?
        .collect::<SqlResult<_>>()?;
    let mut has_deleted = false;
    for _ in 0..CHECKPOINTS_PER_PIECE {
        let Some(index) =
            checkpoint_to_delete(&checkpoints, quota_bytes).filter(|_| extent.bytes > max_bytes)
        else {
            break;
        };
        let (number, bytes) = checkpoints.remove(index);
        connection
            .prepare_cached("DELETE FROM checkpoint WHERE swarm = ? AND number = ?")?
            .execute(params![id, number])?;
        extent.checkpoints = extent.checkpoints.saturating_sub(1);
        extent.bytes = extent.bytes.saturating_sub(bytes);
        extent.first = checkpoints[0].0.cast_unsigned();
        has_deleted = true;
        if index == 0 {
            // The rows before the next checkpoint are deleted first: that may be enough.
            break;
        }
    }
    if has_deleted {
        transaction.set_extent(swarm, id, &extent)?;
    }
    Ok(has_deleted)
}

/// The index of the checkpoint, oldest first, to delete next.
///
/// While checkpoints take more than half the quota, it is the one between the oldest and the two newest
/// whose neighbours are closest, so that repeated calls drop every second one and the history can
/// still be replayed, from points further apart. Otherwise, or when few are left between, it is the
/// oldest; the rows up to the next one are deleted with it.
fn checkpoint_to_delete(checkpoints: &[(i64, u64)], quota_bytes: u64) -> Option<usize> {
    let between = checkpoints.len().checked_sub(3)?;
    let taken: u64 = checkpoints.iter().map(|(_, bytes)| bytes).sum();
    if between <= MIN_BETWEEN || taken <= quota_bytes / 2 {
        return Some(0);
    }
    (1..=between).min_by_key(|index| checkpoints[index + 1].0 - checkpoints[index - 1].0)
}
