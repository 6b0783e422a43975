//! What the writer knows of the file without asking it.

use std::collections::{BTreeMap, BTreeSet};

use rusqlite::{Connection, Result as SqlResult};

use super::Write;
use super::extent::{self, Extent};
use super::record::Checkpoint;

/// A swarm that is stored.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    /// Its number in the file, never given twice.
    pub(super) id: i64,
    /// What there is of it.
    pub(super) extent: Extent,
}

/// The swarms, and how far the answers go. Kept equal to what is committed.
#[derive(Debug, Default)]
pub(super) struct Catalog {
    /// The swarms by name.
    pub(super) swarms: BTreeMap<String, Entry>,
    /// Swarms whose extent is damaged: they can be deleted, and nothing else.
    pub(super) damaged: BTreeMap<String, i64>,
    /// Which answers there are; `None` when that is damaged.
    pub(super) answers: Option<Extent>,
    /// Deleted swarms whose rows are not all gone yet.
    pub(super) gone: BTreeSet<i64>,
    /// The number of the next swarm.
    pub(super) next_id: i64,
}

impl Catalog {
    /// Reads the catalog.
    pub(super) fn read(connection: &Connection) -> SqlResult<Catalog> {
        let mut catalog = Catalog {
            answers: extent::read(connection, extent::ANSWERS)?,
            ..Catalog::default()
        };
        let names: Vec<(String, i64)> = connection
            .prepare("SELECT name, id FROM swarm")?
            .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?
            .collect::<SqlResult<_>>()?;
        for (name, id) in names {
            match extent::read(connection, id)? {
                Some(extent) => _ = catalog.swarms.insert(name, Entry { id, extent }),
                None => _ = catalog.damaged.insert(name, id),
            }
        }
        catalog.gone = connection
            .prepare("SELECT swarm FROM gone")?
            .query_map([], |row| row.get(0))?
            .collect::<SqlResult<_>>()?;
        // Whatever is damaged, no new swarm gets a number under which anything is left.
        let last: i64 = connection.query_row(
            "SELECT max(
                 (SELECT coalesce(max(id), 0) FROM swarm), (SELECT coalesce(max(id), 0) FROM extent),
                 (SELECT coalesce(max(swarm), 0) FROM row), (SELECT coalesce(max(swarm), 0) FROM gone),
                 (SELECT coalesce(max(swarm), 0) FROM checkpoint))",
            [],
            |row| row.get(0),
        )?;
        catalog.next_id = last.saturating_add(1);
        Ok(catalog)
    }

    /// Whether `writes` can follow what is there; if not, why.
    ///
    /// `pending` is what the group changed before them.
    ///
    /// # Errors
    ///
    /// What they contradict, for people.
    pub(super) fn check(
        &self,
        pending: &BTreeMap<String, Option<Entry>>,
        writes: &[Write],
    ) -> Result<(), String> {
        let now = |name| {
            let entry = match pending.get(name) {
                Some(entry) => entry.as_ref(),
                None => self.swarms.get(name),
            };
            entry.map(|Entry { extent, .. }| (extent.first, extent.last, extent.newest))
        };
        // What each write leaves of its swarm; the last one counts.
        let mut after: Vec<(&str, Ends)> = Vec::new();
        for write in writes {
            let Some(name) = write.swarm() else { continue };
            let before = after.iter().rev().find(|(other, _)| *other == name);
            let is_untouched = before.is_none() && !pending.contains_key(name);
            let is_damaged = is_untouched && self.damaged.contains_key(name);
            let found = before.map_or_else(|| now(name), |(_, found)| *found);
            after.push((name, follow(write, found, is_damaged)?));
        }
        Ok(())
    }
}

/// First and last row and newest checkpoint of a swarm that exists.
type Ends = Option<(u64, u64, u64)>;

/// What a swarm is after `write`.
fn follow(write: &Write, found: Ends, is_damaged: bool) -> Result<Ends, String> {
    let is_numbered = |number: u64| i64::try_from(number).is_ok();
    match (write, found) {
        (Write::Answer(_) | Write::Forget { .. }, _) => Ok(found),
        (Write::Delete { .. }, _) if is_damaged => Ok(None),
        (_, _) if is_damaged => {
            Err("the swarm's record is damaged; it can only be deleted".to_string())
        }
        (
            Write::Create {
                first: Checkpoint { number, .. },
                ..
            },
            None,
        ) if is_numbered(*number) => Ok(Some((*number, *number, *number))),
        (Write::Create { .. }, _) => Err("the swarm exists".to_string()),
        (_, None) => Err("there is no such swarm".to_string()),
        (Write::Append { row, .. }, Some((first, last, newest))) => {
            if row.number != last + 1 || !is_numbered(row.number) {
                return Err(format!("row {} does not follow row {last}", row.number));
            }
            Ok(Some((first, row.number, newest)))
        }
        (
            Write::Keep {
                checkpoint: Checkpoint { number, .. },
                ..
            },
            Some((first, last, newest)),
        ) => {
            if *number < newest || *number > last {
                return Err(format!(
                    "checkpoint {number} is not within {newest} to {last}"
                ));
            }
            Ok(Some((first, last, *number)))
        }
        (Write::Cut { after, .. }, Some((first, last, newest))) => {
            if *after < first || *after > last {
                return Err(format!("row {after} is not within {first} to {last}"));
            }
            Ok(Some((first, *after, newest.min(*after))))
        }
        (Write::Delete { .. }, Some(_)) => Ok(None),
    }
}
