//! Deferred submits that could not be written, in order of submission.

use std::collections::VecDeque;

use super::Write;
use super::queue::Submit;

/// Writes in the backlog, and their bytes. Beyond it checkpoints are dropped, then answers.
const MAX_BACKLOG: (usize, usize) = (100_000, 64 * 1024 * 1024);

/// The submits that are still to be written.
#[derive(Default)]
pub(super) struct Backlog {
    submits: VecDeque<Submit>,
    size: (usize, usize),
    limits: Option<(usize, usize)>,
}

impl Backlog {
    /// Adds a deferred submit.
    ///
    /// Rows are never dropped: every later row of the swarm would follow a gap. The submitter has to
    /// stop when [`Backlog::is_overrun`].
    pub(super) fn push(&mut self, submit: Submit) {
        self.grow(&submit);
        self.submits.push_back(submit);
        self.drop_if_overrun(|write| matches!(write, Write::Keep { .. }));
        self.drop_if_overrun(|write| matches!(write, Write::Answer(_) | Write::Forget { .. }));
    }

    /// The oldest submits that fit into a group of this size, at least one.
    pub(super) fn front(&mut self, max: (usize, usize)) -> &[Submit] {
        let mut taken = (0, 0);
        let fitting = self.submits.iter().take_while(|submit| {
            let (writes, bytes) = submit.size();
            let is_first = taken == (0, 0);
            taken = (taken.0 + writes, taken.1 + bytes);
            is_first || (taken.0 <= max.0 && taken.1 <= max.1)
        });
        let count = fitting.count();
        &self.submits.make_contiguous()[..count]
    }

    /// Removes the `count` oldest submits.
    pub(super) fn pop(&mut self, count: usize) -> Vec<Submit> {
        let popped: Vec<Submit> = self.submits.drain(..count).collect();
        for submit in &popped {
            let (writes, bytes) = submit.size();
            self.size = (self.size.0 - writes, self.size.1 - bytes);
        }
        popped
    }

    /// Removes the writes of a deleted swarm.
    pub(super) fn forget(&mut self, swarm: &str) {
        self.retain(|write| write.swarm() != Some(swarm));
    }

    /// Whether there is no submit.
    pub(super) fn is_empty(&self) -> bool {
        self.submits.is_empty()
    }

    /// Whether it exceeds its limits although everything that can be dropped was.
    pub(super) fn is_overrun(&self) -> bool {
        let max = self.limits.unwrap_or(MAX_BACKLOG);
        self.size.0 > max.0 || self.size.1 > max.1
    }

    /// Number of writes.
    pub(super) fn writes(&self) -> usize {
        self.size.0
    }

    fn grow(&mut self, submit: &Submit) {
        let (writes, bytes) = submit.size();
        self.size = (self.size.0 + writes, self.size.1 + bytes);
    }

    fn drop_if_overrun(&mut self, is_dropped: impl Fn(&Write) -> bool) {
        if self.is_overrun() {
            self.retain(|write| !is_dropped(write));
        }
    }

    fn retain(&mut self, is_retained: impl Fn(&Write) -> bool) {
        for mut submit in std::mem::take(&mut self.submits) {
            // A submit without writes waits for those before it: keep it.
            let only_waits = submit.writes.is_empty();
            submit.writes.retain(&is_retained);
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
