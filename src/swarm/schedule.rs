//! Commands that wait for their step.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::swarm::command::Command;
use crate::swarm::error::SwarmError;
use crate::swarm::sender::Sender;

/// Commands that may wait at once, and the bytes of text they may have.
const MOST: (usize, usize) = (1024, 256 * 1024);

/// A command that waits for its step.
#[derive(Clone, Debug)]
pub struct Scheduled {
    /// The line of the journal that it stands on.
    pub input: u64,
    /// What to do.
    pub order: Command,
    /// Who sent it.
    pub sender: Arc<Sender>,
}

/// Commands that wait, by step and, at one step, in the order of arrival.
#[derive(Debug, Default)]
pub struct Schedule {
    waiting: BTreeMap<(u64, u64), Scheduled>,
    arrived: u64,
    bytes: usize,
}

impl Schedule {
    /// Takes in a command for `at_step`.
    ///
    /// # Errors
    ///
    /// [`SwarmError::TooManyScheduled`].
    pub fn add(&mut self, at_step: u64, command: Scheduled) -> Result<(), SwarmError> {
        let bytes = self.bytes + command.sender.bytes();
        let (limit, most_bytes) = MOST;
        if self.waiting.len() == limit || (bytes > most_bytes && !self.waiting.is_empty()) {
            let limit = self.waiting.len();
            return Err(SwarmError::TooManyScheduled { limit });
        }
        self.arrived += 1;
        self.bytes = bytes;
        self.waiting.insert((at_step, self.arrived), command);
        Ok(())
    }

    /// Takes out the first that is to be carried out at `step`.
    pub fn take(&mut self, step: u64) -> Option<Scheduled> {
        let first = self.waiting.first_entry()?;
        if first.key().0 > step {
            return None;
        }
        let command = first.remove();
        self.bytes -= command.sender.bytes();
        Some(command)
    }

    /// Takes out all, each with its step.
    pub fn clear(&mut self) -> Vec<(u64, Scheduled)> {
        self.bytes = 0;
        std::mem::take(&mut self.waiting)
            .into_iter()
            .map(|((at_step, _), command)| (at_step, command))
            .collect()
    }

    /// All, each with its step, in the order they come due.
    pub fn list(&self) -> Vec<(u64, Scheduled)> {
        let waiting = self.waiting.iter();
        waiting
            .map(|((at_step, _), command)| (*at_step, command.clone()))
            .collect()
    }

    /// How many wait.
    pub fn count(&self) -> usize {
        self.waiting.len()
    }
}
