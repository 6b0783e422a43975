//! The limits of notes: how many a user may write into a swarm, and how much they may take.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use thiserror::Error;

use crate::auth::split_signed;
use crate::persistence::journal_reader::parse_line;
use crate::persistence::writer::record;
use crate::store::{Store, StoreError, note_bytes};
use crate::swarm::frame::unix_secs;
use crate::swarm::handle::CommandMessage;
use crate::swarm::journal::Record;

/// Notes that a user may write into a swarm each second.
const RATE: f64 = 10.0;

/// Notes that a user may write at once.
const BURST: f64 = 50.0;

/// Bytes that the notes of a user may take in a swarm.
const USER_BYTES: u64 = 1 << 20;

/// The part of a swarm's quota that notes may take besides it.
const QUOTA_PART: u64 = 8;

/// How often the stored notes of a swarm are counted again once a limit is reached: they go with their
/// part of the history.
const RECOUNT_INTERVAL: Duration = Duration::from_secs(60);

/// Swarms whose notes are counted; beyond it those that no longer exist are forgotten.
const MAX_SWARMS: usize = 1024;

/// Why a note is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum NoteError {
    /// The user writes too many.
    #[error("you write more than 10 notes a second into this swarm: wait a second")]
    Rate,
    /// The notes of the user take too much.
    #[error(
        "your notes in this swarm take 1 MiB, which is the most: they are deleted with the history \
         around them; until then write into another swarm, such as a fork of this one"
    )]
    User,
    /// The notes of all users take too much.
    #[error(
        "the notes in this swarm take {} KiB, an eighth of quota_mb: they are deleted with the history \
         around them; until then write into another swarm, or raise quota_mb",
        .max_bytes / 1024
    )]
    Swarm {
        /// The limit.
        max_bytes: u64,
    },
}

/// The notes of each swarm and user. Clones are the same.
#[derive(Clone)]
pub struct NoteLimits(Arc<Inner>);

struct Inner {
    store: Store,
    max_bytes: u64,
    has_users: bool,
    swarms: Mutex<BTreeMap<String, Counted>>,
}

/// The notes of a swarm.
struct Counted {
    counted_at: Instant,
    /// Bytes of the notes of each user.
    bytes: BTreeMap<String, u64>,
    /// How many notes each user may write now, and when that was counted.
    allowed: BTreeMap<String, (f64, Instant)>,
}

impl NoteLimits {
    /// The limits of swarms with this quota. Without users everyone is the same one.
    pub fn new(store: Store, quota_bytes: u64, has_users: bool) -> Self {
        NoteLimits(Arc::new(Inner {
            store,
            max_bytes: quota_bytes / QUOTA_PART,
            has_users,
            swarms: Mutex::default(),
        }))
    }

    /// Counts a note of a user, `""` without users, unless it exceeds a limit. `exists` says whether
    /// there is a swarm of a name.
    ///
    /// # Errors
    ///
    /// [`NoteError`]; the outer error if the notes of the swarm cannot be read.
    pub fn admit(
        &self,
        swarm: &str,
        user: &str,
        note: &CommandMessage,
        exists: impl Fn(&str) -> bool,
    ) -> Result<Result<(), NoteError>, StoreError> {
        let max_bytes = self.0.max_bytes;
        let mut swarms = self.0.swarms.lock();
        if !swarms.contains_key(swarm) {
            if swarms.len() >= MAX_SWARMS {
                swarms.retain(|name, _| exists(name));
            }
            swarms.insert(swarm.to_owned(), self.read(swarm)?);
        }
        let Some(counted) = swarms.get_mut(swarm) else {
            return Ok(Ok(()));
        };
        if !counted.take_turn(user, Instant::now()) {
            return Ok(Err(NoteError::Rate));
        }
        let stored = Record::Input {
            at_step: note.when.at_step,
            sender: note.sender.clone(),
            seq: None,
            unix_secs: unix_secs(),
        };
        let bytes = note_bytes(record(&stored).1.len());
        let mut checked = counted.check(user, bytes, max_bytes);
        if checked.is_err() && counted.counted_at.elapsed() > RECOUNT_INTERVAL {
            let allowed = std::mem::take(&mut counted.allowed);
            *counted = Counted {
                allowed,
                ..self.read(swarm)?
            };
            checked = counted.check(user, bytes, max_bytes);
        }
        if checked.is_ok() {
            *counted.bytes.entry(user.to_owned()).or_default() += bytes;
        }
        Ok(checked)
    }

    /// Counts the stored notes of a swarm.
    fn read(&self, swarm: &str) -> Result<Counted, StoreError> {
        let mut bytes = BTreeMap::<String, u64>::new();
        let notes = match self.0.store.notes(swarm) {
            // A playback has no journal, and rejects notes.
            Err(StoreError::NoSwarm(_)) => Vec::new(),
            notes => notes?,
        };
        for row in notes {
            let client = match parse_line(&row).map(|line| line.record) {
                Ok(Record::Input { sender, .. }) => sender.client.clone(),
                _ => None,
            };
            let user = match &client {
                Some(client) if self.0.has_users => split_signed(client).0,
                _ => None,
            };
            let user = user.unwrap_or_default().to_owned();
            *bytes.entry(user).or_default() += note_bytes(row.body.len());
        }
        Ok(Counted {
            counted_at: Instant::now(),
            bytes,
            allowed: BTreeMap::new(),
        })
    }
}

impl Counted {
    /// Whether the user may write a note now.
    fn take_turn(&mut self, user: &str, now: Instant) -> bool {
        let (allowed, at) = self.allowed.entry(user.to_owned()).or_insert((BURST, now));
        let passed = now.saturating_duration_since(*at).as_secs_f64();
        *allowed = BURST.min(*allowed + passed * RATE);
        *at = now;
        let may = *allowed >= 1.0;
        if may {
            *allowed -= 1.0;
        }
        may
    }

    fn check(&self, user: &str, bytes: u64, max_bytes: u64) -> Result<(), NoteError> {
        let of_user = self.bytes.get(user).copied().unwrap_or(0);
        let all: u64 = self.bytes.values().sum();
        if of_user + bytes > USER_BYTES {
            return Err(NoteError::User);
        }
        if all + bytes > max_bytes {
            return Err(NoteError::Swarm { max_bytes });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted() -> Counted {
        Counted {
            counted_at: Instant::now(),
            bytes: BTreeMap::new(),
            allowed: BTreeMap::new(),
        }
    }

    #[test]
    fn a_user_writes_fifty_notes_at_once_and_then_ten_a_second() {
        let mut counted = counted();
        let begin = Instant::now();
        let count = |counted: &mut Counted, user: &str, at: Instant| {
            (0..200).filter(|_| counted.take_turn(user, at)).count()
        };
        assert_eq!(count(&mut counted, "ada", begin), 50);
        assert_eq!(count(&mut counted, "ben", begin), 50, "of another user");
        let later = begin + Duration::from_millis(1050);
        assert_eq!(count(&mut counted, "ada", later), 10);
        let much_later = begin + Duration::from_secs(3600);
        assert_eq!(count(&mut counted, "ada", much_later), 50);
        // A clock that stands still.
        assert_eq!(count(&mut counted, "ada", begin), 0);
    }

    #[test]
    fn the_notes_of_a_user_take_a_mebibyte_and_all_an_eighth_of_the_quota() {
        let mut counted = counted();
        counted.bytes.insert("ada".to_owned(), USER_BYTES - 100);
        assert_eq!(counted.check("ada", 100, u64::MAX), Ok(()));
        assert_eq!(counted.check("ada", 101, u64::MAX), Err(NoteError::User));
        assert_eq!(counted.check("ben", USER_BYTES, u64::MAX), Ok(()));
        let max_bytes = USER_BYTES + 400;
        assert_eq!(counted.check("ben", 500, max_bytes), Ok(()));
        let full = Err(NoteError::Swarm { max_bytes });
        assert_eq!(counted.check("ben", 501, max_bytes), full);
    }
}
