//! Rewrites trees whose keys are out of order.
//!
//! A search that passes a damaged key misses records, and an insert after it can put a record where no
//! search finds it. So both trees of a small file are checked when it is opened, and of any file
//! when a journal is truncated. Readers then report which records are missing.

use std::collections::BTreeMap;
use std::path::Path;

use rusqlite::{Connection, Result as SqlResult, Row as SqlRow, TransactionBehavior};

use super::damaged_copy;
use super::error::StoreError;
use super::integrity::{self, decoded};
use super::schema;

/// Repairs the database that was just opened in `folder`, after a copy of its file, if it needs that.
///
/// # Errors
///
/// [`StoreError::of_reading`] of SQLite's error; [`StoreError::Io`] if it cannot be copied.
pub(super) fn on_open(folder: &Path, connection: &mut Connection) -> Result<(), StoreError> {
    let file = folder.join(schema::FILE);
    let fail = |error| StoreError::of_reading(&file, &error);
    if is_in_order(connection, "row").map_err(fail)?
        && is_in_order(connection, "checkpoint").map_err(fail)?
    {
        return Ok(());
    }
    damaged_copy::create(folder).map_err(|error| StoreError::Io {
        file: file.clone(),
        detail: error.to_string(),
    })?;
    let mut repair = || {
        let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        rewrite(&transaction)?;
        transaction.commit()
    };
    repair().map_err(fail)
}

/// Rewrites the trees of rows and checkpoints if they are out of order, without damaged records and
/// those of deleted swarms. Reads both completely.
pub(super) fn rewrite(connection: &Connection) -> SqlResult<()> {
    let insert = "INSERT OR IGNORE INTO repaired";
    let is_rewritten = rewrite_tree(
        connection,
        "row",
        schema::ROW,
        integrity::ROW,
        |record, swarm| match integrity::row(record, swarm.0, swarm.1)? {
            Some(row) => integrity::insert_row(connection, insert, swarm, &row),
            None => Ok(()),
        },
    )?;
    if is_rewritten {
        // It was dropped with the old tree.
        connection.execute_batch(schema::NOTES)?;
    }
    let columns = integrity::CHECKPOINT;
    rewrite_tree(
        connection,
        "checkpoint",
        schema::CHECKPOINT,
        columns,
        |record, swarm| match integrity::checkpoint(record, swarm.0, swarm.1)? {
            Some(it) => integrity::insert_checkpoint(connection, insert, swarm, &it),
            None => Ok(()),
        },
    )?;
    Ok(())
}

/// Rewrites one tree if it is out of order: `copy` gets its records, decodable from `columns`, with
/// name and id of the swarm. Returns whether it was.
fn rewrite_tree(
    connection: &Connection,
    table: &str,
    definition: &str,
    columns: &str,
    copy: impl Fn(&SqlRow<'_>, (&str, i64)) -> SqlResult<()>,
) -> SqlResult<bool> {
    if is_in_order(connection, table)? {
        return Ok(false);
    }
    let names: BTreeMap<i64, String> = connection
        .prepare("SELECT id, name FROM swarm")?
        .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?
        .collect::<SqlResult<_>>()?;
    connection.execute_batch(&format!("CREATE TABLE repaired {definition}"))?;
    {
        let mut select = connection.prepare(&format!("SELECT {columns}, swarm FROM {table}"))?;
        let mut cursor = select.query([])?;
        while let Some(record) = cursor.next()? {
            let id = decoded(record.get(6))?;
            let name = id.and_then(|id| names.get_key_value(&id));
            if let Some((id, name)) = name {
                copy(record, (name, *id))?;
            }
        }
    }
    connection.execute_batch(&format!(
        "DROP TABLE {table}; ALTER TABLE repaired RENAME TO {table}"
    ))?;
    Ok(true)
}

fn is_in_order(connection: &Connection, table: &str) -> SqlResult<bool> {
    let query = format!("PRAGMA integrity_check('{table}')");
    let found: String = connection.query_row(&query, [], |row| row.get(0))?;
    Ok(found == "ok")
}
