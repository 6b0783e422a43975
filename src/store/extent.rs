//! What there must be of a swarm, so that what is missing is noticed.

use rusqlite::{Connection, OptionalExtension, Result as SqlResult, params};

use super::seal::{Seal, Sealer};

/// The extent under this number is that of the answers; swarms count from 1.
pub(super) const ANSWERS: i64 = 0;

/// Which rows and checkpoints of a swarm there are; of the answers, all but `newest`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Extent {
    /// Rows up to this one are gone: the oldest checkpoint's number.
    pub(super) first: u64,
    /// The last row.
    pub(super) last: u64,
    /// The newest checkpoint's number.
    pub(super) newest: u64,
    /// Checkpoints kept; of the answers, how many after `first` were deleted.
    pub(super) checkpoints: u64,
    /// What rows and checkpoints take, those included that are yet to be swept away.
    pub(super) bytes: u64,
}

impl Extent {
    fn seal(&self, id: i64) -> Seal {
        let Extent {
            first,
            last,
            newest,
            checkpoints,
            bytes,
        } = *self;
        Sealer::new("extent")
            .numbers([id.cast_unsigned(), first, last, newest, checkpoints, bytes])
            .seal()
    }
}

/// Writes the extent of `id`.
pub(super) fn write(connection: &Connection, id: i64, extent: &Extent) -> SqlResult<()> {
    let Extent {
        first,
        last,
        newest,
        checkpoints,
        bytes,
    } = *extent;
    let [first, last, newest] = [first, last, newest].map(u64::cast_signed);
    let [checkpoints, bytes] = [checkpoints, bytes].map(u64::cast_signed);
    connection
        .prepare_cached("INSERT OR REPLACE INTO extent VALUES (?, ?, ?, ?, ?, ?, ?)")?
        .execute(params![
            id,
            first,
            last,
            newest,
            checkpoints,
            bytes,
            extent.seal(id)
        ])?;
    Ok(())
}

/// Reads the extent of `id`; `None` when it is missing or damaged.
pub(super) fn read(connection: &Connection, id: i64) -> SqlResult<Option<Extent>> {
    let found = connection
        .prepare_cached(
            "SELECT first, last, newest, checkpoints, bytes, seal FROM extent WHERE id = ?",
        )?
        .query_row([id], |row| {
            let number = |column| row.get::<_, i64>(column).map(i64::cast_unsigned);
            let extent = Extent {
                first: number(0)?,
                last: number(1)?,
                newest: number(2)?,
                checkpoints: number(3)?,
                bytes: number(4)?,
            };
            Ok((extent, row.get::<_, Vec<u8>>(5)?))
        });
    match found.optional() {
        Ok(Some((extent, seal))) if seal == extent.seal(id) => Ok(Some(extent)),
        Ok(_) | Err(rusqlite::Error::InvalidColumnType(..)) => Ok(None),
        Err(error) => Err(error),
    }
}

/// The numbers of all extents but that of the answers.
pub(super) fn swarms(connection: &Connection) -> SqlResult<Vec<i64>> {
    connection
        .prepare_cached("SELECT id FROM extent WHERE id <> 0 ORDER BY id")?
        .query_map([], |row| row.get(0))?
        .collect()
}
