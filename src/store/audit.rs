//! The audit log: its lines, and which of them are kept.
//!
//! `audit_use` has the number and the bytes of each user's lines. If all take too much, the oldest line
//! of the user whose lines take most is deleted: nobody removes those of others by sending many commands.

use rusqlite::types::Value;
use rusqlite::{Connection, OptionalExtension, Result as SqlResult, params, params_from_iter};

use super::Store;
use super::error::StoreError;
use super::integrity;
use super::record::AuditLine;

/// Lines that are deleted for their age when one is written.
const MAX_AGED: usize = 16;

/// The tables. `user` is empty for commands of nobody known.
pub(super) const TABLES: &str = "
     CREATE TABLE audit (
         number INTEGER PRIMARY KEY, user TEXT NOT NULL, client TEXT,
         verb TEXT NOT NULL, name TEXT, first_ms INTEGER NOT NULL, last_ms INTEGER NOT NULL,
         bytes INTEGER NOT NULL, seal BLOB NOT NULL, body BLOB NOT NULL
     );
     CREATE INDEX audit_user ON audit (user, number);
     CREATE TABLE audit_use (
         user TEXT PRIMARY KEY NOT NULL, lines INTEGER NOT NULL, bytes INTEGER NOT NULL
     ) WITHOUT ROWID;";

/// Which lines are read; those without a value are not compared.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AuditFilter {
    /// Only lines with higher numbers, the oldest of them.
    pub after: u64,
    /// Only lines with lower numbers, the newest of them.
    pub before: Option<u64>,
    /// The most lines.
    pub limit: usize,
    /// The user.
    pub user: Option<String>,
    /// What the client calls itself.
    pub client: Option<String>,
    /// The verb.
    pub verb: Option<String>,
    /// What the command concerns.
    pub name: Option<String>,
    /// Only lines with a command at or after this time.
    pub from_ms: Option<u64>,
    /// Only lines with a command at or before this time.
    pub to_ms: Option<u64>,
}

/// The lines that a filter selects.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AuditPage {
    /// Oldest first.
    pub lines: Vec<AuditLine>,
    /// How many of them are damaged, and how many of all are missing.
    pub damaged: u64,
    /// The number of the oldest line of all.
    pub oldest: Option<u64>,
    /// The number of the newest line; 0 if there is none.
    pub newest: u64,
}

/// The size of the audit log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AuditSize {
    /// Lines.
    pub lines: u64,
    /// Bytes that they count for.
    pub bytes: u64,
}

impl AuditFilter {
    /// The condition of the query, and its values.
    fn condition(&self) -> (String, Vec<Value>) {
        let mut condition = "number > ?".to_owned();
        let mut values = vec![Value::from(signed(self.after))];
        let before = self.before.map(signed).map(Value::from);
        let text = |text: &Option<String>| text.clone().map(Value::from);
        let ms = |ms: Option<u64>| ms.map(signed).map(Value::from);
        for (term, value) in [
            ("number < ?", before),
            ("user = ?", text(&self.user)),
            ("client = ?", text(&self.client)),
            ("verb = ?", text(&self.verb)),
            ("name = ?", text(&self.name)),
            ("last_ms >= ?", ms(self.from_ms)),
            ("first_ms <= ?", ms(self.to_ms)),
        ] {
            if let Some(value) = value {
                condition.push_str(" AND ");
                condition.push_str(term);
                values.push(value);
            }
        }
        (condition, values)
    }
}

fn signed(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

impl Store {
    /// The lines of the audit log that `filter` selects. Damaged ones are left out and counted.
    ///
    /// # Errors
    ///
    /// Those of any read.
    pub fn audit(&self, filter: &AuditFilter) -> Result<AuditPage, StoreError> {
        self.read(|snapshot| {
            let (condition, mut values) = filter.condition();
            let order = match filter.before {
                Some(_) => "DESC",
                None => "ASC",
            };
            values.push(Value::from(signed(filter.limit as u64)));
            let mut statement = snapshot.prepare_cached(&format!(
                "SELECT {} FROM audit NOT INDEXED WHERE {condition}
                 ORDER BY number {order} LIMIT ?",
                integrity::AUDIT
            ))?;
            let mut cursor = statement.query(params_from_iter(values))?;
            let mut page = AuditPage::default();
            loop {
                match cursor.next() {
                    Ok(Some(record)) => match integrity::audit_line(record)? {
                        Some(line) => page.lines.push(line),
                        None => page.damaged += 1,
                    },
                    Ok(None) => break,
                    // How many lines are on it, and after it, is not known.
                    Err(error) if integrity::is_corrupt(&error) => {
                        page.damaged += 1;
                        break;
                    }
                    Err(error) => return Err(error.into()),
                }
            }
            if filter.before.is_some() {
                page.lines.reverse();
            }
            page.damaged += missing(snapshot)?;
            page.oldest = oldest(snapshot)?.map(|(number, _)| number.cast_unsigned());
            page.newest = newest(snapshot)?;
            Ok(page)
        })
    }

    /// The number of the newest line of the audit log, which is never deleted; 0 before the first.
    ///
    /// # Errors
    ///
    /// Those of any read.
    pub fn newest_audit_line(&self) -> Result<u64, StoreError> {
        self.read(|snapshot| Ok(newest(snapshot)?))
    }

    /// The size of the audit log.
    ///
    /// # Errors
    ///
    /// Those of any read.
    pub fn audit_size(&self) -> Result<AuditSize, StoreError> {
        self.read(|snapshot| {
            let sums = "SELECT coalesce(sum(lines), 0), coalesce(sum(bytes), 0) FROM audit_use";
            let size = snapshot.prepare_cached(sums)?.query_row([], |record| {
                Ok(AuditSize {
                    lines: record.get::<_, i64>(0)?.cast_unsigned(),
                    bytes: record.get::<_, i64>(1)?.cast_unsigned(),
                })
            })?;
            Ok(size)
        })
    }
}

fn newest(connection: &Connection) -> SqlResult<u64> {
    let mut statement =
        connection.prepare_cached("SELECT coalesce(max(number), 0) FROM audit NOT INDEXED")?;
    statement.query_row([], |record| record.get::<_, i64>(0).map(i64::cast_unsigned))
}

/// How many lines are missing according to the counts of the users. It reads the numbers of all lines: a
/// search passes by those that a damaged page has out of order.
fn missing(connection: &Connection) -> SqlResult<u64> {
    let expected: i64 = connection
        .prepare_cached("SELECT coalesce(sum(lines), 0) FROM audit_use")?
        .query_row([], |record| record.get(0))?;
    let mut statement = connection.prepare_cached("SELECT number FROM audit NOT INDEXED")?;
    let mut cursor = statement.query([])?;
    let (mut found, mut last) = (0, 0);
    while let Some(record) = integrity::next(&mut cursor)? {
        let number: i64 = record.get(0)?;
        found += i64::from(number > last);
        last = last.max(number);
    }
    Ok(expected.abs_diff(found))
}

/// Number and time of the oldest line.
fn oldest(connection: &Connection) -> SqlResult<Option<(i64, i64)>> {
    connection
        .prepare_cached("SELECT number, last_ms FROM audit ORDER BY number LIMIT 1")?
        .query_row([], |record| Ok((record.get(0)?, record.get(1)?)))
        .optional()
}

/// Writes a line, or replaces the one of its number, and deletes lines so that all take at most
/// `max_bytes` and the oldest is at most `max_ms` older than this one.
pub(super) fn write(
    connection: &Connection,
    line: &AuditLine,
    (max_bytes, max_ms): (u64, u64),
) -> SqlResult<()> {
    if integrity::update_audit_line(connection, line)? {
        return Ok(());
    }
    if line.number <= newest(connection)? {
        // It was deleted meanwhile.
        return Ok(());
    }
    let bytes = line.bytes();
    integrity::insert_audit_line(connection, line, bytes)?;
    connection
        .prepare_cached(
            "INSERT INTO audit_use VALUES (?1, 1, ?2) ON CONFLICT DO UPDATE
             SET lines = lines + 1, bytes = bytes + ?2",
        )?
        .execute(params![line.user, bytes as i64])?;
    let until = line.last_ms.saturating_sub(max_ms);
    for _ in 0..MAX_AGED {
        match oldest(connection)? {
            Some((number, ms)) if ms.cast_unsigned() < until => delete(connection, number)?,
            _ => break,
        }
    }
    loop {
        let total: i64 = connection
            .prepare_cached("SELECT coalesce(sum(bytes), 0) FROM audit_use")?
            .query_row([], |record| record.get(0))?;
        if total.cast_unsigned() <= max_bytes {
            return Ok(());
        }
        let number: Option<i64> = connection
            .prepare_cached(
                "SELECT min(number) FROM audit
                 WHERE user = (SELECT user FROM audit_use ORDER BY bytes DESC LIMIT 1)",
            )?
            .query_row([], |record| record.get(0))?;
        match number {
            Some(number) if number.cast_unsigned() != line.number => delete(connection, number)?,
            // Lines are missing, or this one alone takes too much, and stays.
            _ => return recount(connection),
        }
    }
}

fn delete(connection: &Connection, number: i64) -> SqlResult<()> {
    let deleted: (String, i64) = connection
        .prepare_cached("DELETE FROM audit WHERE number = ? RETURNING user, bytes")?
        .query_row([number], |record| Ok((record.get(0)?, record.get(1)?)))?;
    connection
        .prepare_cached(
            "UPDATE audit_use SET lines = lines - 1, bytes = bytes - ?2 WHERE user = ?1",
        )?
        .execute(params![deleted.0, deleted.1])?;
    Ok(())
}

fn recount(connection: &Connection) -> SqlResult<()> {
    connection.execute_batch(
        "DELETE FROM audit_use;
         INSERT INTO audit_use SELECT user, count(*), sum(bytes) FROM audit GROUP BY user",
    )
}
