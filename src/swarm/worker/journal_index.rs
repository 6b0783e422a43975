//! What a replay needs to know of all lines of a journal before the first one is replayed.

use std::collections::{BTreeMap, BTreeSet};

use crate::swarm::command::Command;
use crate::swarm::journal::{Line, Record};

/// A line of a journal, and its command if it records one.
pub type ReplayEntry = (Line, Option<Command>);

/// An index of the lines to replay.
#[derive(Default)]
pub struct JournalIndex {
    /// Lines whose commands were rejected.
    pub(super) rejected: BTreeSet<u64>,
    /// Lines of commands whose outcome is on a later line, with the wall-clock time of the outcome.
    pub(super) settled: BTreeMap<u64, Option<f64>>,
    /// The hashes by epoch and step.
    pub(super) hashes: BTreeMap<(u64, u64), [u8; 32]>,
    /// The epoch and step of the last hash.
    pub(super) last_hash: Option<(u64, u64)>,
    /// The line of the last reset.
    pub(super) last_reset: u64,
    /// The last line.
    last: Option<u64>,
}

impl JournalIndex {
    /// Adds the next line.
    pub fn add(&mut self, (line, command): &ReplayEntry) {
        self.last = Some(line.number);
        if matches!(command, Some(Command::Reset(_))) {
            self.last_reset = line.number;
        }
        match line.record {
            Record::Became {
                input,
                seq,
                unix_secs,
            } => {
                self.settled.insert(input, unix_secs);
                if seq.is_none() {
                    self.rejected.insert(input);
                }
            }
            Record::Hash(hash) => {
                let at = (line.epoch, line.step);
                self.hashes.insert(at, hash);
                self.last_hash = Some(at);
            }
            _ => {}
        }
    }

    /// The number of the last line; `None` without lines.
    pub fn last(&self) -> Option<u64> {
        self.last
    }
}

impl<'a> FromIterator<&'a ReplayEntry> for JournalIndex {
    fn from_iter<I: IntoIterator<Item = &'a ReplayEntry>>(lines: I) -> Self {
        let mut index = JournalIndex::default();
        lines.into_iter().for_each(|line| index.add(line));
        index
    }
}

/// The state and the results of a replay.
#[derive(Default)]
pub struct ReplayState {
    pub(super) rejected: BTreeSet<u64>,
    /// When the command on each line was applied, by the wall clock.
    pub(super) unix_secs: BTreeMap<u64, f64>,
    pub(super) hashes: BTreeMap<(u64, u64), [u8; 32]>,
    /// How many hashes are the same.
    pub same: u64,
    /// The first epoch and step whose hash differs.
    pub differs_at: Option<(u64, u64)>,
    /// Why the replay ended before its target.
    pub aborted: Option<String>,
}

impl ReplayState {
    /// Whether the command on this line was rejected.
    pub fn was_rejected(&self, input: u64) -> bool {
        self.rejected.contains(&input)
    }

    /// When the command on this line was applied, by the wall clock, in seconds since 1970.
    pub fn unix_secs_of(&self, input: u64) -> Option<f64> {
        self.unix_secs.get(&input).copied()
    }

    /// Whether a step has the journaled hash; `None` if there is none.
    pub fn check_hash(&mut self, at: (u64, u64), hash: [u8; 32]) -> Option<bool> {
        let is_same = *self.hashes.get(&at)? == hash;
        self.same += u64::from(is_same);
        if !is_same {
            self.differs_at.get_or_insert(at);
        }
        Some(is_same)
    }

    /// Frees the index after the replay; the results stay.
    pub(super) fn clear(&mut self) {
        self.rejected.clear();
        self.unix_secs.clear();
        self.hashes.clear();
    }
}
