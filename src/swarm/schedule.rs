//! Scheduled commands.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::swarm::command::Command;
use crate::swarm::sender::Sender;

/// Limits of the scheduled commands of an operator, or without users of everyone: their number and the
/// bytes of their text.
pub const MAX_SCHEDULED: (usize, usize) = (1024, 256 * 1024);

#[derive(Clone, Debug)]
pub struct Scheduled {
    pub input: u64,
    pub command: Command,
    pub sender: Arc<Sender>,
}

/// Scheduled commands, by step and order of arrival.
#[derive(Debug, Default)]
pub struct Schedule {
    waiting: BTreeMap<(u64, u64), Scheduled>,
    arrived: u64,
}

impl Schedule {
    /// Adds a command, whose sender has a place for it.
    pub fn add(&mut self, at_step: u64, command: Scheduled) {
        self.arrived += 1;
        self.waiting.insert((at_step, self.arrived), command);
    }

    /// Removes the first command that is due at `step`.
    pub fn take(&mut self, step: u64) -> Option<Scheduled> {
        let first = self.waiting.first_entry()?;
        if first.key().0 > step {
            return None;
        }
        Some(first.remove())
    }

    pub fn clear(&mut self) -> Vec<(u64, Scheduled)> {
        std::mem::take(self).list()
    }

    /// All, each with its step, in the order of execution.
    pub fn list(&self) -> Vec<(u64, Scheduled)> {
        let waiting = self.waiting.iter();
        waiting
            .map(|((at_step, _), command)| (*at_step, command.clone()))
            .collect()
    }

    /// All, in the order of execution.
    pub fn iter(&self) -> impl Iterator<Item = &Scheduled> {
        self.waiting.values()
    }

    pub fn count(&self) -> usize {
        self.waiting.len()
    }
}
