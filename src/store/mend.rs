//! Trees whose keys are out of order, written anew.
//!
//! A damaged key misleads every search that comes by it: what is there is not found, and what is
//! written later may be put where nobody finds it again. So the trees of a file that is small enough
//! to be looked through are put in order when it is opened, and all when a swarm is cut. Reading
//! then tells what is missing.

use std::collections::BTreeMap;
use std::path::Path;

use rusqlite::{Connection, Result as SqlResult, TransactionBehavior, params};

use super::aside;
use super::error::StoreError;
use super::read::{fitting, read_mark, read_row};
use super::schema::{CHECKPOINT, FILE, ROW};

/// Puts the trees of the database that was just opened in `folder` in order, if they are not. The
/// file as it was is kept aside.
///
/// # Errors
///
/// [`StoreError`] of a file.
pub(super) fn open(folder: &Path, connection: &mut Connection) -> Result<(), StoreError> {
    let file = folder.join(FILE);
    let fail = |error| StoreError::of_reading(&file, &error);
    if is_in_order(connection, "row").map_err(fail)?
        && is_in_order(connection, "checkpoint").map_err(fail)?
    {
        return Ok(());
    }
    aside::keep(folder).map_err(|error| StoreError::Io {
        file: file.clone(),
        detail: error.to_string(),
    })?;
    let mut mend = || {
        let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        put_in_order(&transaction)?;
        transaction.commit()
    };
    mend().map_err(fail)
}

/// Puts the trees of rows and checkpoints in order, if they are not. What is damaged is left out,
/// and so is what deleted swarms have left.
///
/// Takes as long as reading all of them.
pub(super) fn put_in_order(connection: &Connection) -> SqlResult<()> {
    let names: BTreeMap<i64, String> = connection
        .prepare("SELECT id, name FROM swarm")?
        .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?
        .collect::<SqlResult<_>>()?;
    if !is_in_order(connection, "row")? {
        connection.execute_batch(&format!("CREATE TABLE mended {ROW}"))?;
        copy_rows(connection, &names)?;
        connection.execute_batch("DROP TABLE row; ALTER TABLE mended RENAME TO row")?;
    }
    if !is_in_order(connection, "checkpoint")? {
        connection.execute_batch(&format!("CREATE TABLE mended {CHECKPOINT}"))?;
        copy_checkpoints(connection, &names)?;
        connection
            .execute_batch("DROP TABLE checkpoint; ALTER TABLE mended RENAME TO checkpoint")?;
    }
    Ok(())
}

fn is_in_order(connection: &Connection, table: &str) -> SqlResult<bool> {
    let query = format!("PRAGMA integrity_check('{table}')");
    let found: String = connection.query_row(&query, [], |row| row.get(0))?;
    Ok(found == "ok")
}

fn copy_rows(connection: &Connection, names: &BTreeMap<i64, String>) -> SqlResult<()> {
    let mut insert = connection.prepare(
        "INSERT OR IGNORE INTO mended (number, epoch, step, kind, body, seal, swarm)
         VALUES (?, ?, ?, ?, ?, ?, ?)",
    )?;
    let mut select =
        connection.prepare("SELECT number, epoch, step, kind, body, seal, swarm FROM row")?;
    let mut cursor = select.query([])?;
    while let Some(record) = cursor.next()? {
        let (Some((row, seal)), Some(id)) = (fitting(read_row(record))?, fitting(record.get(6))?)
        else {
            continue;
        };
        if names
            .get(&id)
            .is_some_and(|name| seal == row.seal(name, id))
        {
            let [number, epoch, step] = [row.number, row.epoch, row.step].map(u64::cast_signed);
            insert.execute(params![number, epoch, step, row.kind, row.body, seal, id])?;
        }
    }
    Ok(())
}

fn copy_checkpoints(connection: &Connection, names: &BTreeMap<i64, String>) -> SqlResult<()> {
    let mut insert = connection.prepare(
        "INSERT OR IGNORE INTO mended (number, epoch, step, seal, digest, body, swarm)
         VALUES (?, ?, ?, ?, ?, ?, ?)",
    )?;
    let mut select = connection
        .prepare("SELECT number, epoch, step, seal, digest, swarm, body FROM checkpoint")?;
    let mut cursor = select.query([])?;
    while let Some(record) = cursor.next()? {
        let (Some((mark, seal, digest)), Some(id)) =
            (fitting(read_mark(record))?, fitting(record.get(5))?)
        else {
            continue;
        };
        let Some(body) = fitting(record.get::<_, Vec<u8>>(6))? else {
            continue;
        };
        let is_sound = |name: &String| seal == mark.seal(name, id, &digest);
        if names.get(&id).is_some_and(is_sound) {
            let [number, epoch, step] = [mark.number, mark.epoch, mark.step].map(u64::cast_signed);
            insert.execute(params![number, epoch, step, seal, digest, body, id])?;
        }
    }
    Ok(())
}
