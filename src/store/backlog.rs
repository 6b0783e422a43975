//! Lazy submits that could not be written: kept, in order, until they can.

use std::collections::VecDeque;

use super::Write;
use super::queue::Submit;

/// Writes kept, and their bytes. Beyond it checkpoints are given up, then answers.
const MOST_KEPT: (usize, usize) = (100_000, 64 * 1024 * 1024);

/// What could not be written yet.
#[derive(Default)]
pub(super) struct Backlog {
    submits: VecDeque<Submit>,
    size: (usize, usize),
    limits: Option<(usize, usize)>,
}

impl Backlog {
    /// Adds what nobody waits for.
    ///
    /// Rows are never given up: every later row of the swarm would follow a gap. Whoever submits
    /// them has to stop when [`Backlog::is_overrun`].
    pub(super) fn push(&mut self, submit: Submit) {
        self.grow(&submit);
        self.submits.push_back(submit);
        self.give_up(|write| matches!(write, Write::Keep { .. }));
        self.give_up(|write| matches!(write, Write::Answer(_) | Write::Forget { .. }));
    }

    /// The oldest of them that make a group of at most this size, and at least one.
    pub(super) fn front(&mut self, most: (usize, usize)) -> &[Submit] {
        let mut taken = (0, 0);
        let fitting = self.submits.iter().take_while(|submit| {
            let (writes, bytes) = submit.size();
            let is_first = taken == (0, 0);
            taken = (taken.0 + writes, taken.1 + bytes);
            is_first || (taken.0 <= most.0 && taken.1 <= most.1)
        });
        let count = fitting.count();
        &self.submits.make_contiguous()[..count]
    }

    /// Removes the `count` oldest.
    pub(super) fn pop(&mut self, count: usize) -> Vec<Submit> {
        let popped: Vec<Submit> = self.submits.drain(..count).collect();
        for submit in &popped {
            let (writes, bytes) = submit.size();
            self.size = (self.size.0 - writes, self.size.1 - bytes);
        }
        popped
    }

    /// Removes what was meant for a swarm that is deleted.
    pub(super) fn forget(&mut self, swarm: &str) {
        self.retain(|write| write.swarm() != Some(swarm));
    }

    /// Whether there is nothing to be written.
    pub(super) fn is_empty(&self) -> bool {
        self.submits.is_empty()
    }

    /// Whether more is kept than should be, though all that could be given up was.
    pub(super) fn is_overrun(&self) -> bool {
        let most = self.limits.unwrap_or(MOST_KEPT);
        self.size.0 > most.0 || self.size.1 > most.1
    }

    /// Writes kept.
    pub(super) fn writes(&self) -> usize {
        self.size.0
    }

    fn grow(&mut self, submit: &Submit) {
        let (writes, bytes) = submit.size();
        self.size = (self.size.0 + writes, self.size.1 + bytes);
    }

    fn give_up(&mut self, is_given_up: impl Fn(&Write) -> bool) {
        if self.is_overrun() {
            self.retain(|write| !is_given_up(write));
        }
    }

    fn retain(&mut self, is_kept: impl Fn(&Write) -> bool) {
        for mut submit in std::mem::take(&mut self.submits) {
            // Who writes nothing waits for all that is before.
            let only_waits = submit.writes.is_empty();
            submit.writes.retain(&is_kept);
            if only_waits || !submit.writes.is_empty() {
                self.submits.push_back(submit);
            }
        }
        self.size = (0, 0);
        for submit in &self.submits {
            let (writes, bytes) = submit.size();
            self.size = (self.size.0 + writes, self.size.1 + bytes);
        }
    }

    /// A backlog with other limits.
    #[cfg(test)]
    pub(super) fn with_limits(writes: usize, bytes: usize) -> Backlog {
        Backlog {
            limits: Some((writes, bytes)),
            ..Backlog::default()
        }
    }
}
