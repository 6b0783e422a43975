//! Reading, and telling what is damaged or missing.
//!
//! A broken page may hide records as well as change them. So every list is held against its
//! extent, which stands on another page: numbers follow each other, and as many as there must be.

use std::path::Path;

use rusqlite::{
    Connection, Error as SqlError, ErrorCode, OptionalExtension, Result as SqlResult,
    Row as SqlRow, params,
};

use super::error::StoreError;
use super::extent::{self, Extent};
use super::record::{Answer, Checkpoint, Mark, Row, Rows, seal_swarm};

/// Answers read at once.
const ANSWERS_PER_PAGE: i64 = 1000;

/// Why something was not read.
pub(super) enum Trouble {
    /// SQLite says so.
    Sql(SqlError),
    /// The swarm is not stored.
    NoSwarm,
    /// The checkpoint is not kept.
    NoCheckpoint(u64),
    /// A record of the swarm is damaged.
    Damaged(String),
    /// A record of this other swarm is damaged.
    DamagedOf(String, &'static str),
}

impl From<SqlError> for Trouble {
    fn from(error: SqlError) -> Trouble {
        Trouble::Sql(error)
    }
}

impl Trouble {
    /// The error for whoever read about `swarm` in `file`.
    pub(super) fn told(self, file: &Path, swarm: &str) -> StoreError {
        let swarm = swarm.to_string();
        match self {
            Trouble::Sql(error) => StoreError::of_reading(file, &error),
            Trouble::NoSwarm => StoreError::NoSwarm { swarm },
            Trouble::NoCheckpoint(number) => StoreError::NoCheckpoint { swarm, number },
            Trouble::Damaged(what) => StoreError::Damaged {
                file: file.to_path_buf(),
                swarm,
                what,
            },
            Trouble::DamagedOf(swarm, what) => StoreError::Damaged {
                file: file.to_path_buf(),
                swarm,
                what: what.to_string(),
            },
        }
    }
}

/// The swarms, by name.
pub(super) fn swarms(connection: &Connection) -> Result<Vec<(String, Vec<u8>)>, Trouble> {
    let damaged = |name: &str, what| Trouble::DamagedOf(name.to_string(), what);
    let moment = connection.unchecked_transaction()?;
    let mut statement =
        moment.prepare_cached("SELECT name, id, seal, about FROM swarm ORDER BY name")?;
    let mut cursor = statement.query([])?;
    let (mut swarms, mut ids) = (Vec::<(String, Vec<u8>)>::new(), Vec::new());
    while let Some(row) = cursor.next()? {
        let last = swarms.last().map_or("", |(name, _)| name.as_str());
        let Some((name, id, seal, about)) = fitting(read_swarm(row))? else {
            return Err(damaged(last, "the record after that"));
        };
        let is_next = swarms.is_empty() || last < name.as_str();
        if seal != seal_swarm(&name, id, &about) || !is_next {
            return Err(damaged(&name, "the record"));
        }
        let Some(extent) = extent::read(&moment, id)? else {
            return Err(damaged(&name, "the extent"));
        };
        if last_row(&moment, id)? > extent.last {
            return Err(damaged(&name, "the extent, which rows go beyond,"));
        }
        swarms.push((name, about));
        ids.push(id);
    }
    ids.sort_unstable();
    if ids != extent::swarms(&moment)? {
        return Err(damaged(
            "",
            "the list of swarms (at least one is missing), not",
        ));
    }
    Ok(swarms)
}

type RawSwarm = (String, i64, Vec<u8>, Vec<u8>);

fn read_swarm(row: &SqlRow<'_>) -> SqlResult<RawSwarm> {
    Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?))
}

fn last_row(connection: &Connection, id: i64) -> SqlResult<u64> {
    connection
        .prepare_cached("SELECT coalesce(max(number), 0) FROM row WHERE swarm = ?")?
        .query_row([id], |row| row.get::<_, i64>(0).map(i64::cast_unsigned))
}

/// The rows of `swarm` after the row `after`, at most `limit`.
pub(super) fn rows(
    connection: &Connection,
    swarm: &str,
    after: u64,
    limit: usize,
) -> Result<Rows, Trouble> {
    let moment = connection.unchecked_transaction()?;
    let (id, extent) = find(&moment, swarm)?;
    let mut next = after.max(extent.first).saturating_add(1);
    let mut read = Rows::default();
    let mut statement = moment.prepare_cached(
        "SELECT number, epoch, step, kind, body, seal FROM row
         WHERE swarm = ? AND number >= ? ORDER BY number LIMIT ?",
    )?;
    let most = i64::try_from(limit).unwrap_or(i64::MAX);
    let mut cursor = statement.query(params![id, next.cast_signed(), most])?;
    while next <= extent.last && read.rows.len() < limit {
        let found = match cursor.next() {
            Ok(Some(row)) => fitting(read_row(row))?,
            Ok(None) => None,
            Err(error) if is_corrupt(&error) => None,
            Err(error) => return Err(error.into()),
        };
        match found {
            Some((row, seal)) if row.number == next && seal == row.seal(swarm, id) => {
                read.rows.push(row);
            }
            _ => {
                read.damaged_at = Some(next);
                break;
            }
        }
        next += 1;
    }
    Ok(read)
}

/// Reads a row and its seal: number, epoch, step, kind, body, seal.
pub(super) fn read_row(row: &SqlRow<'_>) -> SqlResult<(Row, Vec<u8>)> {
    let found = Row {
        number: unsigned(row, 0)?,
        epoch: unsigned(row, 1)?,
        step: unsigned(row, 2)?,
        kind: row.get(3)?,
        body: row.get(4)?,
    };
    Ok((found, row.get(5)?))
}

/// The checkpoints of `swarm`, newest first, and how many are damaged or missing.
pub(super) fn checkpoints(
    connection: &Connection,
    swarm: &str,
) -> Result<(Vec<Mark>, u64), Trouble> {
    let moment = connection.unchecked_transaction()?;
    let (id, extent) = find(&moment, swarm)?;
    let mut statement = moment.prepare_cached(
        "SELECT number, epoch, step, seal, digest FROM checkpoint WHERE swarm = ?
         ORDER BY number DESC",
    )?;
    let mut cursor = statement.query([id])?;
    let (mut marks, mut found) = (Vec::<Mark>::new(), 0);
    loop {
        let row = match cursor.next() {
            Ok(Some(row)) => row,
            Ok(None) => break,
            Err(error) if is_corrupt(&error) => break,
            Err(error) => return Err(error.into()),
        };
        found += 1;
        let Some((mark, seal, digest)) = fitting(read_mark(row))? else {
            continue;
        };
        let is_next = match marks.last() {
            Some(later) => mark.number < later.number,
            None => mark.number <= extent.newest,
        };
        if is_next && seal == mark.seal(swarm, id, &digest) {
            marks.push(mark);
        }
    }
    let left_out = found - marks.len() as u64;
    Ok((marks, left_out.max(extent.checkpoints.abs_diff(found))))
}

/// Reads a mark, its seal and the digest of its body: number, epoch, step, seal, digest.
pub(super) fn read_mark(row: &SqlRow<'_>) -> SqlResult<(Mark, Vec<u8>, Vec<u8>)> {
    let mark = Mark {
        number: unsigned(row, 0)?,
        epoch: unsigned(row, 1)?,
        step: unsigned(row, 2)?,
    };
    Ok((mark, row.get(3)?, row.get(4)?))
}

/// The checkpoint `number` of `swarm`.
pub(super) fn checkpoint(
    connection: &Connection,
    swarm: &str,
    number: u64,
) -> Result<Checkpoint, Trouble> {
    let moment = connection.unchecked_transaction()?;
    let (id, _) = find(&moment, swarm)?;
    let found = moment
        .prepare_cached(
            "SELECT number, epoch, step, seal, digest, body FROM checkpoint
             WHERE swarm = ? AND number = ?",
        )?
        .query_row(params![id, number.cast_signed()], |row| {
            Ok(fitting(
                read_mark(row).and_then(|found| Ok((found, row.get::<_, Vec<u8>>(5)?))),
            ))
        })
        .optional()?
        .ok_or(Trouble::NoCheckpoint(number))?;
    found?
        .filter(|((mark, seal, digest), _)| {
            *seal == mark.seal(swarm, id, digest) && mark.number == number
        })
        .and_then(|((mark, _, digest), body)| mark.with(body, &digest))
        .ok_or_else(|| Trouble::Damaged(format!("checkpoint {number}")))
}

/// All answers, oldest first, and how many are damaged or missing. Between two pages `connection`
/// is free for others.
pub(super) fn answers(
    page: impl Fn(u64) -> Result<AnswerPage, StoreError>,
) -> Result<(Vec<Answer>, u64), StoreError> {
    let (mut answers, mut after) = (Vec::new(), 0);
    loop {
        let mut read = page(after)?;
        answers.append(&mut read.answers);
        match read.next {
            Some(next) if next > after => after = next,
            _ => {
                let missing = read.expected.saturating_sub(answers.len() as u64);
                return Ok((answers, missing));
            }
        }
    }
}

/// Whether an answer was ever deleted.
pub(super) fn has_forgotten(connection: &Connection) -> Result<bool, Trouble> {
    let extent = extent::read(connection, extent::ANSWERS)?;
    Ok(extent.is_some_and(|it| it.first > 0 || it.checkpoints > 0))
}

/// Some answers.
#[derive(Default)]
pub(super) struct AnswerPage {
    answers: Vec<Answer>,
    /// How many answers there must be, on all pages.
    expected: u64,
    /// Where the next page begins, if there may be one.
    next: Option<u64>,
}

/// The answers after the answer `after`.
pub(super) fn answer_page(connection: &Connection, after: u64) -> Result<AnswerPage, Trouble> {
    let moment = connection.unchecked_transaction()?;
    let Some(extent) = extent::read(&moment, extent::ANSWERS)? else {
        return Err(Trouble::DamagedOf(
            String::new(),
            "the extent of the answers, not",
        ));
    };
    let Extent { first, last, .. } = extent;
    let mut next = after.max(first) + 1;
    let mut page = AnswerPage {
        expected: last
            .saturating_sub(first)
            .saturating_sub(extent.checkpoints),
        ..AnswerPage::default()
    };
    let mut statement = moment.prepare_cached(
        "SELECT id, client, request_id, digest, swarm, number, is_ok, encoding, body, seal
         FROM answer WHERE id >= ? ORDER BY id LIMIT ?",
    )?;
    let mut cursor = statement.query(params![next.cast_signed(), ANSWERS_PER_PAGE])?;
    let mut count = 0;
    while let Some(row) = cursor.next()? {
        count += 1;
        // What is out of order or beyond the end is missing from those expected.
        let Some((id, answer, seal)) = fitting(read_answer(row))? else {
            continue;
        };
        if id < next || id > last || seal != answer.seal(id) {
            continue;
        }
        next = id + 1;
        page.answers.push(answer);
    }
    if count == ANSWERS_PER_PAGE && next <= last {
        page.next = Some(next - 1);
    }
    Ok(page)
}

fn read_answer(row: &SqlRow<'_>) -> SqlResult<(u64, Answer, Vec<u8>)> {
    let answer = Answer {
        client: row.get(1)?,
        request_id: row.get(2)?,
        digest: row.get(3)?,
        swarm: row.get(4)?,
        number: unsigned(row, 5)?,
        is_ok: row.get(6)?,
        encoding: row.get(7)?,
        body: row.get(8)?,
    };
    Ok((unsigned(row, 0)?, answer, row.get(9)?))
}

/// The swarm's number and extent.
fn find(connection: &Connection, swarm: &str) -> Result<(i64, Extent), Trouble> {
    let id: Option<i64> = connection
        .prepare_cached("SELECT id FROM swarm WHERE name = ?")?
        .query_row([swarm], |row| row.get(0))
        .optional()?;
    let id = id.ok_or(Trouble::NoSwarm)?;
    let extent = extent::read(connection, id)?;
    Ok((
        id,
        extent.ok_or_else(|| Trouble::Damaged("the extent".to_string()))?,
    ))
}

/// A record whose columns are of the wrong type or no text is damaged, and no error of SQLite's.
pub(super) fn fitting<T>(record: SqlResult<T>) -> SqlResult<Option<T>> {
    match record {
        Err(error @ SqlError::SqliteFailure(..)) => Err(error),
        Err(_) => Ok(None),
        Ok(record) => Ok(Some(record)),
    }
}

fn is_corrupt(error: &SqlError) -> bool {
    error.sqlite_error_code() == Some(ErrorCode::DatabaseCorrupt)
}

fn unsigned(row: &SqlRow<'_>, column: usize) -> SqlResult<u64> {
    row.get::<_, i64>(column).map(i64::cast_unsigned)
}
