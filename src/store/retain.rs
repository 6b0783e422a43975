//! What is kept no longer: taken away in pieces small enough that no commit waits long for one.

use std::collections::BTreeSet;

use rusqlite::{Result as SqlResult, params};

use super::catalog::Entry;
use super::draft::Draft;
use super::record::cost;

/// Rows taken away in one piece.
const ROWS_PER_PIECE: i64 = 1000;

/// Checkpoints taken away in one piece.
const CHECKPOINTS_PER_PIECE: usize = 4;

/// Checkpoints between the oldest and the two newest that are not thinned further, so that the
/// history goes in steps of at most a few parts of it.
const FEWEST_BETWEEN: usize = 8;

/// Takes one piece away; whether there was anything to take.
///
/// `gone` is a deleted swarm that left something; `untidy` names the swarms to look at; those found tidy leave it.
pub(super) fn tidy(
    draft: &mut Draft<'_>,
    gone: Option<i64>,
    untidy: &mut BTreeSet<String>,
    quota_bytes: u64,
) -> SqlResult<bool> {
    if let Some(id) = gone {
        return sweep_deleted(draft, id).map(|()| true);
    }
    while let Some(swarm) = untidy.first().cloned() {
        if sweep_rows(draft, &swarm)? || shorten(draft, &swarm, quota_bytes)? {
            return Ok(true);
        }
        untidy.remove(&swarm);
    }
    Ok(false)
}

/// Takes away a piece of what a deleted swarm left.
fn sweep_deleted(draft: &mut Draft<'_>, id: i64) -> SqlResult<()> {
    let rows = draft
        .connection()
        .prepare_cached(
            "DELETE FROM row WHERE swarm = ?1 AND number IN
                 (SELECT number FROM row WHERE swarm = ?1 ORDER BY number LIMIT ?2)",
        )?
        .execute(params![id, ROWS_PER_PIECE])?;
    if rows > 0 {
        return Ok(());
    }
    let checkpoints = draft
        .connection()
        .prepare_cached(
            "DELETE FROM checkpoint WHERE swarm = ?1 AND number IN
                 (SELECT number FROM checkpoint WHERE swarm = ?1 ORDER BY number LIMIT ?2)",
        )?
        .execute(params![id, CHECKPOINTS_PER_PIECE as i64])?;
    if checkpoints > 0 {
        return Ok(());
    }
    draft.forget(id)
}

/// Takes away a piece of the rows before the oldest checkpoint; whether there were any.
fn sweep_rows(draft: &mut Draft<'_>, swarm: &str) -> SqlResult<bool> {
    let connection = draft.connection();
    let Some(known) = draft.known(swarm) else {
        return Ok(false);
    };
    let (id, first) = (known.id, known.extent.first.cast_signed());
    let (count, bytes, last): (i64, Option<i64>, Option<i64>) = connection
        .prepare_cached(
            "SELECT count(*), sum(bytes), max(number) FROM
                 (SELECT number, length(body) AS bytes FROM row
                  WHERE swarm = ? AND number <= ? ORDER BY number LIMIT ?)",
        )?
        .query_row(params![id, first, ROWS_PER_PIECE], |row| {
            Ok((row.get(0)?, row.get(1)?, row.get(2)?))
        })?;
    let Some(last) = last else { return Ok(false) };
    connection
        .prepare_cached("DELETE FROM row WHERE swarm = ? AND number <= ?")?
        .execute(params![id, last])?;
    if let Some(entry) = draft.entry(swarm) {
        let freed = bytes.unwrap_or(0).cast_unsigned() + count.cast_unsigned() * cost(0);
        entry.extent.bytes = entry.extent.bytes.saturating_sub(freed);
    }
    Ok(true)
}

/// Takes away checkpoints of a swarm that is over its quota; whether there were any to take.
///
/// The two newest always stay, and all rows after the older of them.
fn shorten(draft: &mut Draft<'_>, swarm: &str, quota_bytes: u64) -> SqlResult<bool> {
    let connection = draft.connection();
    let Some(known) = draft.known(swarm).cloned() else {
        return Ok(false);
    };
    if known.extent.bytes <= quota_bytes {
        return Ok(false);
    }
    let mut kept: Vec<(i64, u64)> = connection
        .prepare_cached(
            "SELECT number, length(body) FROM checkpoint WHERE swarm = ? ORDER BY number",
        )?
        .query_map([known.id], |row| {
            let bytes = usize::try_from(row.get::<_, i64>(1)?).unwrap_or(0);
            Ok((row.get(0)?, cost(bytes)))
        })?
        .collect::<SqlResult<_>>()?;
    let mut excess = known.extent.bytes - quota_bytes;
    for piece in 0..CHECKPOINTS_PER_PIECE {
        let Some(place) = choose(&kept, quota_bytes).filter(|_| excess > 0) else {
            return Ok(piece > 0);
        };
        let (number, bytes) = kept.remove(place);
        connection
            .prepare_cached("DELETE FROM checkpoint WHERE swarm = ? AND number = ?")?
            .execute(params![known.id, number])?;
        let Some(Entry { extent, .. }) = draft.entry(swarm) else {
            return Ok(false);
        };
        extent.checkpoints = extent.checkpoints.saturating_sub(1);
        extent.bytes = extent.bytes.saturating_sub(bytes);
        extent.first = kept[0].0.cast_unsigned();
        if place == 0 {
            // Its rows go first: they may be enough.
            return Ok(true);
        }
        excess = excess.saturating_sub(bytes);
    }
    Ok(true)
}

/// Which of these checkpoints, oldest first, goes next.
///
/// Where checkpoints take more than half the quota, one between the oldest and the two newest
/// goes, the one least missed: again and again, that drops every second one, and history can still
/// be replayed, from further apart. Else, or when few are left between, the oldest goes and the
/// rows up to the next with it.
fn choose(kept: &[(i64, u64)], quota_bytes: u64) -> Option<usize> {
    let between = kept.len().checked_sub(3)?;
    let taken: u64 = kept.iter().map(|(_, bytes)| bytes).sum();
    if between <= FEWEST_BETWEEN || taken <= quota_bytes / 2 {
        return Some(0);
    }
    (1..=between).min_by_key(|place| kept[place + 1].0 - kept[place - 1].0)
}
