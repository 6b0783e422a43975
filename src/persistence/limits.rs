//! The limits of users: how often a user may write notes into a swarm, join and leave it, and how much
//! their notes may take. What they write would otherwise take the history of others.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use thiserror::Error;

use crate::auth::split_signed;
use crate::persistence::journal_reader::parse_line;
use crate::persistence::writer::record;
use crate::store::{Store, StoreError, note_bytes};
use crate::swarm::command::ANNOTATE;
use crate::swarm::frame::unix_secs;
use crate::swarm::handle::CommandMessage;
use crate::swarm::journal::Record;

/// Notes that a user may write into a swarm.
const NOTES: Rate = Rate {
    per_sec: 10.0,
    at_once: 50.0,
};

/// Bytes of the journal that the joins of a user may take in a swarm, and those that the leaves may. A
/// learner that joins for each episode takes about 350 for each command.
const MEMBERSHIP_BYTES: Rate = Rate {
    per_sec: 32.0 * 1024.0,
    at_once: 1024.0 * 1024.0,
};

/// Bytes that the notes of a user may take in a swarm.
const USER_BYTES: u64 = 1 << 20;

/// The part of a swarm's quota that notes may take besides it.
const QUOTA_PART: u64 = 8;

/// How often the stored notes of a swarm are counted again once a limit is reached: they go with their
/// part of the history.
const RECOUNT_INTERVAL: Duration = Duration::from_secs(60);

/// Swarms whose commands are counted; beyond it those that no longer exist are forgotten.
const MAX_SWARMS: usize = 1024;

/// Why a note, a `join` or a `leave` is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum LimitError {
    /// The user writes too many.
    #[error(
        "you write more than 10 notes a second into this swarm: write it again in {retry_secs:.1} s"
    )]
    Rate {
        /// When it is accepted.
        retry_secs: f64,
    },
    /// The user joins or leaves too often.
    #[error(
        "you send more than 32 KiB of {verb} a second into this swarm: send it again in {retry_secs:.1} s"
    )]
    Membership {
        /// The verb.
        verb: &'static str,
        /// When it is accepted.
        retry_secs: f64,
    },
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

/// What each user has sent to each swarm. Clones are the same.
#[derive(Clone)]
pub struct UserLimits(Arc<Inner>);

struct Inner {
    store: Store,
    max_bytes: u64,
    has_users: bool,
    /// By swarm, as are the notes.
    rates: Mutex<BTreeMap<String, Rates>>,
    /// Not locked while the notes of a swarm are read.
    notes: Mutex<BTreeMap<String, Notes>>,
}

/// The notes in a swarm.
struct Notes {
    counted_at: Instant,
    /// Bytes of those of each user.
    bytes: BTreeMap<String, u64>,
}

/// How much may be sent each second, and at once.
#[derive(Clone, Copy)]
struct Rate {
    per_sec: f64,
    at_once: f64,
}

/// How much of each verb each user may send now, and when that was counted.
#[derive(Default)]
struct Rates(BTreeMap<(&'static str, String), (f64, Instant)>);

impl Rates {
    /// Counts `amount`, unless it exceeds the rate: then it returns when it does not, in seconds.
    fn take(
        &mut self,
        (verb, user): (&'static str, &str),
        rate: Rate,
        amount: f64,
        now: Instant,
    ) -> Result<(), f64> {
        let allowed = self.0.entry((verb, user.to_owned()));
        let (allowed, at) = allowed.or_insert((rate.at_once, now));
        let passed = now.saturating_duration_since(*at).as_secs_f64();
        *allowed = rate.at_once.min(*allowed + passed * rate.per_sec);
        *at = now;
        // More than may ever be sent at once is accepted if nothing was sent before.
        let needed = amount.min(rate.at_once);
        if *allowed < needed {
            return Err((needed - *allowed) / rate.per_sec);
        }
        *allowed -= amount;
        Ok(())
    }
}

impl UserLimits {
    /// The limits of swarms with this quota. Without users everyone is the same one.
    pub fn new(store: Store, quota_bytes: u64, has_users: bool) -> Self {
        UserLimits(Arc::new(Inner {
            store,
            max_bytes: quota_bytes / QUOTA_PART,
            has_users,
            rates: Mutex::default(),
            notes: Mutex::default(),
        }))
    }

    /// Counts a note, a `join` or a `leave` of a user, `""` without users, unless it exceeds a limit.
    /// `exists` says whether there is a swarm of a name.
    ///
    /// # Errors
    ///
    /// [`LimitError`]; the outer error if the notes of the swarm cannot be read.
    pub fn admit(
        &self,
        swarm: &str,
        user: &str,
        command: &CommandMessage,
        exists: impl Fn(&str) -> bool,
    ) -> Result<Result<(), LimitError>, StoreError> {
        let stored = Record::Input {
            at_step: command.when.at_step,
            sender: command.sender.clone(),
            seq: None,
            unix_secs: unix_secs(),
        };
        let bytes = note_bytes(record(&stored).1.len());
        let (verb, now) = (command.sender.verb, Instant::now());
        let is_note = verb == ANNOTATE;
        let taken = {
            let mut swarms = self.0.rates.lock();
            let rates = entry(&mut swarms, swarm, &exists, Rates::default);
            let (rate, amount) = match is_note {
                true => (NOTES, 1.0),
                false => (MEMBERSHIP_BYTES, bytes as f64),
            };
            rates.take((verb, user), rate, amount, now)
        };
        match taken {
            Err(retry_secs) if is_note => Ok(Err(LimitError::Rate { retry_secs })),
            Err(retry_secs) => Ok(Err(LimitError::Membership { verb, retry_secs })),
            Ok(()) if is_note => self.admit_note(swarm, user, bytes, exists),
            Ok(()) => Ok(Ok(())),
        }
    }

    fn admit_note(
        &self,
        swarm: &str,
        user: &str,
        bytes: u64,
        exists: impl Fn(&str) -> bool,
    ) -> Result<Result<(), LimitError>, StoreError> {
        let is_known = self.0.notes.lock().contains_key(swarm);
        let mut counted = match is_known {
            true => None,
            false => Some(self.read(swarm)?),
        };
        loop {
            let mut swarms = self.0.notes.lock();
            let read = counted.take();
            let notes = entry(&mut swarms, swarm, &exists, || read.unwrap_or_default());
            let checked = notes.check(user, bytes, self.0.max_bytes);
            if checked.is_ok() {
                *notes.bytes.entry(user.to_owned()).or_default() += bytes;
            }
            if checked.is_ok() || notes.counted_at.elapsed() <= RECOUNT_INTERVAL {
                return Ok(checked);
            }
            // No other thread counts them meanwhile.
            notes.counted_at = Instant::now();
            drop(swarms);
            let read = self.read(swarm)?;
            self.0.notes.lock().insert(swarm.to_owned(), read);
        }
    }

    /// Counts the stored notes of a swarm.
    fn read(&self, swarm: &str) -> Result<Notes, StoreError> {
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
        Ok(Notes {
            bytes,
            ..Notes::default()
        })
    }
}

/// What is counted of a swarm; at [`MAX_SWARMS`] those that no longer exist are forgotten.
fn entry<'a, Count>(
    swarms: &'a mut BTreeMap<String, Count>,
    swarm: &str,
    exists: impl Fn(&str) -> bool,
    begin: impl FnOnce() -> Count,
) -> &'a mut Count {
    if !swarms.contains_key(swarm) && swarms.len() >= MAX_SWARMS {
        swarms.retain(|name, _| exists(name));
    }
    swarms.entry(swarm.to_owned()).or_insert_with(begin)
}

impl Default for Notes {
    fn default() -> Self {
        Notes {
            counted_at: Instant::now(),
            bytes: BTreeMap::new(),
        }
    }
}

impl Notes {
    fn check(&self, user: &str, bytes: u64, max_bytes: u64) -> Result<(), LimitError> {
        let of_user = self.bytes.get(user).copied().unwrap_or(0);
        let all: u64 = self.bytes.values().sum();
        if of_user + bytes > USER_BYTES {
            return Err(LimitError::User);
        }
        if all + bytes > max_bytes {
            return Err(LimitError::Swarm { max_bytes });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_user_writes_fifty_notes_at_once_and_then_ten_a_second() {
        let mut rates = Rates::default();
        let begin = Instant::now();
        let mut count = |user: &str, at: Instant| {
            let is_taken = |_: &i32| rates.take((ANNOTATE, user), NOTES, 1.0, at).is_ok();
            (0..200).filter(is_taken).count()
        };
        assert_eq!(count("ada", begin), 50);
        assert_eq!(count("ben", begin), 50, "of another user");
        let later = begin + Duration::from_millis(1050);
        assert_eq!(count("ada", later), 10);
        let much_later = begin + Duration::from_secs(3600);
        assert_eq!(count("ada", much_later), 50);
        // A clock that stands still.
        assert_eq!(count("ada", begin), 0);
    }

    #[test]
    fn joins_and_leaves_are_limited_by_their_bytes_each() {
        let mut rates = Rates::default();
        let begin = Instant::now();
        let mut take = |verb, user, kibibytes: f64, secs: u64| {
            let at = begin + Duration::from_secs(secs);
            rates.take((verb, user), MEMBERSHIP_BYTES, kibibytes * 1024.0, at)
        };
        assert_eq!(take("join", "ada", 1000.0, 0), Ok(()));
        assert_eq!(take("join", "ada", 25.0, 0), Err(1.0 / 32.0));
        assert_eq!(take("join", "ada", 24.0, 0), Ok(()));
        assert_eq!(take("join", "ada", 64.0, 1), Err(1.0));
        assert_eq!(take("join", "ada", 64.0, 2), Ok(()));
        // Others, and the way out, are not taken from.
        assert_eq!(take("leave", "ada", 1.0, 2), Ok(()));
        assert_eq!(take("join", "ben", 1000.0, 2), Ok(()));
        // A join that is longer than the limit is accepted once in a while.
        assert_eq!(take("join", "cleo", 2048.0, 2), Ok(()));
        assert_eq!(take("join", "cleo", 1.0, 3), Err(31.0 + 1.0 / 32.0));
    }

    #[test]
    fn the_notes_of_a_user_take_a_mebibyte_and_all_an_eighth_of_the_quota() {
        let mut counted = Notes::default();
        counted.bytes.insert("ada".to_owned(), USER_BYTES - 100);
        assert_eq!(counted.check("ada", 100, u64::MAX), Ok(()));
        assert_eq!(counted.check("ada", 101, u64::MAX), Err(LimitError::User));
        assert_eq!(counted.check("ben", USER_BYTES, u64::MAX), Ok(()));
        let max_bytes = USER_BYTES + 400;
        assert_eq!(counted.check("ben", 500, max_bytes), Ok(()));
        let full = Err(LimitError::Swarm { max_bytes });
        assert_eq!(counted.check("ben", 501, max_bytes), full);
    }
}
