//! Detection of damaged and missing records: the only place that reads and writes checksums.
//!
//! ```text
//!  swarm (name)        extent (id)                      row, checkpoint (swarm, number)
//! ┌────────────────┐  ┌───────────────────────────┐   ┌──────────────────────────────────┐
//! │ name, id, about│─►│ first, last, newest,      │──►│ rows first + 1 to last, no gap;  │
//! │ seal           │  │ checkpoints, bytes, seal  │   │ checkpoints first to newest; seal│
//! └────────────────┘  ├───────────────────────────┤   ├──────────────────────────────────┤
//!                     │ the same, of id 0         │──►│ replies first + 1 to last        │
//!                     └───────────────────────────┘   └──────────────────────────────────┘
//! ```
//!
//! `seal` is a checksum of all columns of its record and of the name and id of its swarm: it does not
//! fit a record that was moved. The checksum of a checkpoint covers a digest of its body, so a list of
//! checkpoints is verified without reading the bodies.
//!
//! A damaged page can also hide records. So the extent, which lies on a page of another tree, holds
//! which records exist:
//!
//! | found | reaction |
//! |---|---|
//! | row with a wrong checksum, or a gap | reading ends before it; [`super::Write::Truncate`] truncates the journal there |
//! | checkpoint or reply with a wrong checksum, or fewer than the extent holds | left out and counted |
//! | swarm or extent with a wrong checksum, or one without the other | reading the list of swarms fails and names it; the swarm can only be deleted |
//! | keys out of order in a tree, which hides records from a search | [`super::repair`] writes the tree again, without its damaged records |
//! | a broken page in a small file | [`super::schema::open`] rejects the file |

use rusqlite::{
    Connection, Error as SqlError, ErrorCode, OptionalExtension, Result as SqlResult,
    Row as SqlRow, Rows as SqlRows, params,
};

use super::record::{AuditLine, Checkpoint, CheckpointInfo, Row, StoredReply};

/// The columns that [`row`] decodes.
pub(super) const ROW: &str = "number, epoch, step, kind, seal, body";

/// The columns that [`checkpoint_info`] decodes.
pub(super) const CHECKPOINT_INFO: &str = "number, epoch, step, seal, digest";

/// The columns that [`checkpoint`] decodes.
pub(super) const CHECKPOINT: &str = "number, epoch, step, seal, digest, body";

/// The columns that [`reply`] decodes.
pub(super) const REPLY_COLUMNS: &str =
    "id, client, request_id, digest, swarm, number, is_ok, encoding, seal, body";

/// The columns that [`audit_line`] decodes.
pub(super) const AUDIT: &str = "number, user, client, verb, name, first_ms, last_ms, seal, body";

/// The id of the extent of the replies; swarms count from 1.
pub(super) const REPLIES: i64 = 0;

/// Which rows and checkpoints of a swarm exist; for the replies, all fields but `newest`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Extent {
    /// Rows up to this one are deleted: the number of the oldest checkpoint.
    pub(super) first: u64,
    /// The last row.
    pub(super) last: u64,
    /// The number of the newest checkpoint.
    pub(super) newest: u64,
    /// Number of checkpoints; for the replies, how many after `first` were deleted.
    pub(super) checkpoints: u64,
    /// Size of rows and checkpoints, including those not swept yet.
    pub(super) bytes: u64,
}

/// A BLAKE3 hash, cut to 16 bytes.
type Checksum = [u8; 16];

/// Hashes a record field by field. Each field is preceded by its length, so no two records hash the
/// same bytes.
struct Hasher(blake3::Hasher);

impl Hasher {
    /// Starts the checksum of a record of the table `kind`.
    fn new(kind: &str) -> Hasher {
        Hasher(blake3::Hasher::new()).bytes(kind.as_bytes())
    }

    fn bytes(mut self, field: &[u8]) -> Hasher {
        self.0.update(&(field.len() as u64).to_le_bytes());
        self.0.update(field);
        self
    }

    fn numbers<const N: usize>(mut self, fields: [u64; N]) -> Hasher {
        for field in fields {
            self.0.update(&field.to_le_bytes());
        }
        self
    }

    fn finish(self) -> Checksum {
        let mut checksum = [0; 16];
        checksum.copy_from_slice(&self.0.finalize().as_bytes()[..16]);
        checksum
    }
}

fn digest(body: &[u8]) -> Checksum {
    Hasher::new("body").bytes(body).finish()
}

fn swarm_checksum(name: &str, id: i64, about: &[u8]) -> Checksum {
    Hasher::new("swarm")
        .bytes(name.as_bytes())
        .numbers([id.cast_unsigned()])
        .bytes(about)
        .finish()
}

fn row_checksum(swarm: &str, id: i64, row: &Row) -> Checksum {
    let kind = row.kind.into();
    Hasher::new("row")
        .bytes(swarm.as_bytes())
        .numbers([id.cast_unsigned(), row.number, row.epoch, row.step, kind])
        .bytes(&row.body)
        .finish()
}

fn checkpoint_checksum(swarm: &str, id: i64, info: &CheckpointInfo, digest: &[u8]) -> Checksum {
    Hasher::new("checkpoint")
        .bytes(swarm.as_bytes())
        .numbers([id.cast_unsigned(), info.number, info.epoch, info.step])
        .bytes(digest)
        .finish()
}

fn reply_checksum(id: u64, reply: &StoredReply) -> Checksum {
    let has_client = reply.client.is_some().into();
    Hasher::new("answer")
        .numbers([id, has_client, reply.number, reply.is_ok.into()])
        .bytes(reply.client.as_deref().unwrap_or("").as_bytes())
        .bytes(reply.request_id.as_bytes())
        .bytes(&reply.digest)
        .bytes(reply.swarm.as_bytes())
        .bytes(reply.encoding.as_bytes())
        .bytes(&reply.body)
        .finish()
}

fn audit_checksum(line: &AuditLine) -> Checksum {
    let has = |text: &Option<String>| u64::from(text.is_some());
    Hasher::new("audit")
        .numbers([line.number, line.first_ms, line.last_ms])
        .numbers([has(&line.client), has(&line.name)])
        .bytes(line.user.as_bytes())
        .bytes(line.client.as_deref().unwrap_or("").as_bytes())
        .bytes(line.verb.as_bytes())
        .bytes(line.name.as_deref().unwrap_or("").as_bytes())
        .bytes(&line.body)
        .finish()
}

impl Extent {
    fn numbers(&self) -> [u64; 5] {
        let Extent {
            first,
            last,
            newest,
            checkpoints,
            bytes,
        } = *self;
        [first, last, newest, checkpoints, bytes]
    }

    fn checksum(&self, id: i64) -> Checksum {
        Hasher::new("extent")
            .numbers([id.cast_unsigned()])
            .numbers(self.numbers())
            .finish()
    }
}

pub(super) fn write_extent(connection: &Connection, id: i64, extent: &Extent) -> SqlResult<()> {
    let [first, last, newest, checkpoints, bytes] = extent.numbers().map(u64::cast_signed);
    let checksum = extent.checksum(id);
    connection
        .prepare_cached("INSERT OR REPLACE INTO extent VALUES (?, ?, ?, ?, ?, ?, ?)")?
        .execute(params![
            id,
            first,
            last,
            newest,
            checkpoints,
            bytes,
            checksum
        ])?;
    Ok(())
}

/// Reads the extent `id`; `None` if it is missing or damaged.
pub(super) fn read_extent(connection: &Connection, id: i64) -> SqlResult<Option<Extent>> {
    let found = connection
        .prepare_cached(
            "SELECT first, last, newest, checkpoints, bytes, seal FROM extent WHERE id = ?",
        )?
        .query_row([id], |record| {
            let extent = Extent {
                first: unsigned(record, 0)?,
                last: unsigned(record, 1)?,
                newest: unsigned(record, 2)?,
                checkpoints: unsigned(record, 3)?,
                bytes: unsigned(record, 4)?,
            };
            Ok((extent, record.get::<_, Vec<u8>>(5)?))
        });
    let found = decoded(found.optional())?.flatten();
    Ok(found
        .filter(|(extent, checksum)| *checksum == extent.checksum(id))
        .map(|(extent, _)| extent))
}

/// The id of a swarm and its extent, which is `None` if it is missing or damaged.
pub(super) fn find(
    connection: &Connection,
    swarm: &str,
) -> SqlResult<Option<(i64, Option<Extent>)>> {
    let id: Option<i64> = connection
        .prepare_cached("SELECT id FROM swarm WHERE name = ?")?
        .query_row([swarm], |record| record.get(0))
        .optional()?;
    id.map(|id| Ok((id, read_extent(connection, id)?)))
        .transpose()
}

pub(super) fn insert_swarm(
    connection: &Connection,
    name: &str,
    id: i64,
    about: &[u8],
) -> SqlResult<()> {
    connection
        .prepare_cached("INSERT INTO swarm (name, id, seal, about) VALUES (?, ?, ?, ?)")?
        .execute(params![name, id, swarm_checksum(name, id, about), about])?;
    Ok(())
}

pub(super) struct SwarmRecord {
    pub(super) name: String,
    pub(super) id: i64,
    pub(super) about: Vec<u8>,
    /// Whether the checksum fits.
    pub(super) is_intact: bool,
}

/// Decodes the columns `name, id, seal, about`; `None` if they are of other types.
pub(super) fn swarm(record: &SqlRow<'_>) -> SqlResult<Option<SwarmRecord>> {
    let decode = || {
        let (name, id) = (record.get::<_, String>(0)?, record.get(1)?);
        let (checksum, about) = (record.get::<_, Vec<u8>>(2)?, record.get::<_, Vec<u8>>(3)?);
        let is_intact = checksum == swarm_checksum(&name, id, &about);
        Ok(SwarmRecord {
            name,
            id,
            about,
            is_intact,
        })
    };
    decoded(decode())
}

/// Inserts a row; `insert` is the head of the statement, such as `INSERT INTO row`.
pub(super) fn insert_row(
    connection: &Connection,
    insert: &str,
    (swarm, id): (&str, i64),
    row: &Row,
) -> SqlResult<()> {
    let [number, epoch, step] = [row.number, row.epoch, row.step].map(u64::cast_signed);
    let checksum = row_checksum(swarm, id, row);
    connection
        .prepare_cached(&format!(
            "{insert} ({ROW}, swarm) VALUES (?, ?, ?, ?, ?, ?, ?)"
        ))?
        .execute(params![
            number, epoch, step, row.kind, checksum, row.body, id
        ])?;
    Ok(())
}

/// Decodes [`ROW`]; `None` if the row is damaged.
pub(super) fn row(record: &SqlRow<'_>, swarm: &str, id: i64) -> SqlResult<Option<Row>> {
    let decode = || {
        let row = Row {
            number: unsigned(record, 0)?,
            epoch: unsigned(record, 1)?,
            step: unsigned(record, 2)?,
            kind: record.get(3)?,
            body: record.get(5)?,
        };
        let is_intact = record.get::<_, Vec<u8>>(4)? == row_checksum(swarm, id, &row);
        Ok(is_intact.then_some(row))
    };
    Ok(decoded(decode())?.flatten())
}

/// Inserts a checkpoint; `insert` is the head of the statement.
pub(super) fn insert_checkpoint(
    connection: &Connection,
    insert: &str,
    (swarm, id): (&str, i64),
    checkpoint: &Checkpoint,
) -> SqlResult<()> {
    let info = checkpoint.info();
    let [number, epoch, step] = [info.number, info.epoch, info.step].map(u64::cast_signed);
    let digest = digest(&checkpoint.body);
    let checksum = checkpoint_checksum(swarm, id, &info, &digest);
    connection
        .prepare_cached(&format!(
            "{insert} ({CHECKPOINT}, swarm) VALUES (?, ?, ?, ?, ?, ?, ?)"
        ))?
        .execute(params![
            number,
            epoch,
            step,
            checksum,
            digest,
            checkpoint.body,
            id
        ])?;
    Ok(())
}

/// Decodes [`CHECKPOINT_INFO`] into the checkpoint without its body, and the digest of the body;
/// `None` if it is damaged.
pub(super) fn checkpoint_info(
    record: &SqlRow<'_>,
    swarm: &str,
    id: i64,
) -> SqlResult<Option<(CheckpointInfo, Vec<u8>)>> {
    let decode = || {
        let info = CheckpointInfo {
            number: unsigned(record, 0)?,
            epoch: unsigned(record, 1)?,
            step: unsigned(record, 2)?,
        };
        let digest: Vec<u8> = record.get(4)?;
        let checksum: Vec<u8> = record.get(3)?;
        let is_intact = checksum == checkpoint_checksum(swarm, id, &info, &digest);
        Ok(is_intact.then_some((info, digest)))
    };
    Ok(decoded(decode())?.flatten())
}

/// Decodes [`CHECKPOINT`]; `None` if the checkpoint is damaged.
pub(super) fn checkpoint(
    record: &SqlRow<'_>,
    swarm: &str,
    id: i64,
) -> SqlResult<Option<Checkpoint>> {
    let Some((info, expected)) = checkpoint_info(record, swarm, id)? else {
        return Ok(None);
    };
    let body = decoded(record.get::<_, Vec<u8>>(5))?.filter(|body| digest(body) == *expected);
    Ok(body.map(|body| Checkpoint {
        number: info.number,
        epoch: info.epoch,
        step: info.step,
        body,
    }))
}

pub(super) fn insert_reply(connection: &Connection, id: u64, reply: &StoredReply) -> SqlResult<()> {
    connection
        .prepare_cached(&format!(
            "INSERT INTO answer ({REPLY_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
        ))?
        .execute(params![
            id.cast_signed(),
            reply.client,
            reply.request_id,
            reply.digest,
            reply.swarm,
            reply.number.cast_signed(),
            reply.is_ok,
            reply.encoding,
            reply_checksum(id, reply),
            reply.body
        ])?;
    Ok(())
}

/// Decodes [`REPLY_COLUMNS`] into the id and the reply; `None` if the reply is damaged.
pub(super) fn reply(record: &SqlRow<'_>) -> SqlResult<Option<(u64, StoredReply)>> {
    let decode = || {
        let reply = StoredReply {
            client: record.get(1)?,
            request_id: record.get(2)?,
            digest: record.get(3)?,
            swarm: record.get(4)?,
            number: unsigned(record, 5)?,
            is_ok: record.get(6)?,
            encoding: record.get(7)?,
            body: record.get(9)?,
        };
        let id = unsigned(record, 0)?;
        let is_intact = record.get::<_, Vec<u8>>(8)? == reply_checksum(id, &reply);
        Ok(is_intact.then_some((id, reply)))
    };
    Ok(decoded(decode())?.flatten())
}

/// Inserts a line of the audit log, which counts for so many bytes.
pub(super) fn insert_audit_line(
    connection: &Connection,
    line: &AuditLine,
    bytes: usize,
) -> SqlResult<()> {
    let [number, first, last] = [line.number, line.first_ms, line.last_ms].map(u64::cast_signed);
    connection
        .prepare_cached(&format!(
            "INSERT INTO audit ({AUDIT}, bytes) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
        ))?
        .execute(params![
            number,
            line.user,
            line.client,
            line.verb,
            line.name,
            first,
            last,
            audit_checksum(line),
            line.body,
            bytes as i64
        ])?;
    Ok(())
}

/// Replaces the time and the body of a line of the audit log; whether it exists.
pub(super) fn update_audit_line(connection: &Connection, line: &AuditLine) -> SqlResult<bool> {
    let [number, last] = [line.number, line.last_ms].map(u64::cast_signed);
    let updated = connection
        .prepare_cached("UPDATE audit SET last_ms = ?, seal = ?, body = ? WHERE number = ?")?
        .execute(params![last, audit_checksum(line), line.body, number])?;
    Ok(updated > 0)
}

/// Decodes [`AUDIT`]; `None` if the line is damaged.
pub(super) fn audit_line(record: &SqlRow<'_>) -> SqlResult<Option<AuditLine>> {
    let decode = || {
        let line = AuditLine {
            number: unsigned(record, 0)?,
            user: record.get(1)?,
            client: record.get(2)?,
            verb: record.get(3)?,
            name: record.get(4)?,
            first_ms: unsigned(record, 5)?,
            last_ms: unsigned(record, 6)?,
            body: record.get(8)?,
        };
        let is_intact = record.get::<_, Vec<u8>>(7)? == audit_checksum(&line);
        Ok(is_intact.then_some(line))
    };
    Ok(decoded(decode())?.flatten())
}

/// Whether an error is a corrupt page.
pub(super) fn is_corrupt(error: &SqlError) -> bool {
    error.sqlite_error_code() == Some(ErrorCode::DatabaseCorrupt)
}

/// The next record; a corrupt page ends the list.
pub(super) fn next<'a>(cursor: &'a mut SqlRows<'_>) -> SqlResult<Option<&'a SqlRow<'a>>> {
    match cursor.next() {
        Err(error) if is_corrupt(&error) => Ok(None),
        next => next,
    }
}

/// A column of another type, or text that is not UTF-8, is damage and not an error of SQLite.
pub(super) fn decoded<T>(record: SqlResult<T>) -> SqlResult<Option<T>> {
    match record {
        Err(error @ SqlError::SqliteFailure(..)) => Err(error),
        Err(_) => Ok(None),
        Ok(record) => Ok(Some(record)),
    }
}

fn unsigned(record: &SqlRow<'_>, column: usize) -> SqlResult<u64> {
    record.get::<_, i64>(column).map(i64::cast_unsigned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moving_a_byte_from_one_field_to_the_next_changes_the_checksum() {
        let one = Hasher::new("row").bytes(b"ab").bytes(b"c").finish();
        let other = Hasher::new("row").bytes(b"a").bytes(b"bc").finish();
        assert_ne!(one, other);
        assert_ne!(
            Hasher::new("row").numbers([1, 2]).finish(),
            Hasher::new("row").numbers([2, 1]).finish()
        );
    }
}
