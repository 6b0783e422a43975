//! The notes of a swarm: rows that count against a quota of their own and evict nothing.

use rusqlite::{Connection, Result as SqlResult};

use super::Store;
use super::error::StoreError;
use super::integrity;
use super::record::{Row, cost};
use super::schema::NOTE;

/// The most bytes of the row with the outcome of a note.
const OUTCOME_BYTES: usize = 64;

/// Bytes that a note with a body of this length counts for: its row, and that of its outcome.
pub fn note_bytes(body_bytes: usize) -> u64 {
    cost(body_bytes) + cost(OUTCOME_BYTES)
}

/// Bytes that all notes of a swarm count for.
pub(super) fn bytes(connection: &Connection, id: i64) -> SqlResult<u64> {
    let sums = format!(
        "SELECT count(*), coalesce(sum(length(body)), 0) FROM row WHERE swarm = ? AND kind = {NOTE}"
    );
    let [count, bytes] = connection
        .prepare_cached(&sums)?
        .query_row([id], |record| {
            let number = |column| record.get::<_, i64>(column).map(i64::cast_unsigned);
            Ok([number(0)?, number(1)?])
        })?;
    Ok(bytes + count * note_bytes(0))
}

impl Store {
    /// The notes of a swarm, oldest first. Damaged ones are left out.
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSwarm`], [`StoreError::Damaged`], and those of any read.
    pub fn notes(&self, swarm: &str) -> Result<Vec<Row>, StoreError> {
        self.read(|snapshot| {
            let (id, _) = self.find(snapshot, swarm)?;
            let mut statement = snapshot.prepare_cached(&format!(
                "SELECT {} FROM row WHERE swarm = ? AND kind = {NOTE} ORDER BY number",
                integrity::ROW
            ))?;
            let mut cursor = statement.query([id])?;
            let mut notes = Vec::new();
            while let Some(record) = integrity::next(&mut cursor)? {
                notes.extend(integrity::row(record, swarm, id)?);
            }
            Ok(notes)
        })
    }
}
