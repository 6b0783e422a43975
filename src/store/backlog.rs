//! Deferred submits that could not be written, in order of submission.

use std::collections::VecDeque;

use super::Write;
use super::queue::{Submit, group_len};

/// Writes in the backlog, and their bytes.
pub(super) const MAX_BACKLOG: (usize, usize) = (100_000, 64 * 1024 * 1024);

/// The submits that are still to be written.
#[derive(Default)]
pub(super) struct Backlog {
    submits: VecDeque<Submit>,
    size: (usize, usize),
    max: (usize, usize),
}

impl Backlog {
    /// An empty backlog. Beyond `max`, writes and bytes, lines of the audit log are dropped, then
    /// checkpoints, then replies.
    pub(super) fn new(max: (usize, usize)) -> Backlog {
        Backlog {
            max,
            ..Backlog::default()
        }
    }

    /// Adds a deferred submit.
    ///
    /// Rows are never dropped: every later row of the swarm would follow a gap. The submitter has to
    /// stop when [`Backlog::is_overrun`].
    pub(super) fn push(&mut self, submit: Submit) {
        self.add(submit);
        self.drop_if_overrun(|write| matches!(write, Write::Audit(_)));
        self.drop_if_overrun(|write| matches!(write, Write::SaveCheckpoint { .. }));
        self.drop_if_overrun(|write| {
            matches!(write, Write::InsertReply(_) | Write::DeleteReply { .. })
        });
    }

    /// The oldest submits that fit into one group, at least one.
    pub(super) fn front(&mut self) -> &[Submit] {
        let count = group_len(self.submits.iter());
        &self.submits.make_contiguous()[..count]
    }

    pub(super) fn pop(&mut self, count: usize) -> Vec<Submit> {
        let popped: Vec<Submit> = self.submits.drain(..count).collect();
        for submit in &popped {
            let (writes, bytes) = submit.size();
            self.size = (self.size.0 - writes, self.size.1 - bytes);
        }
        popped
    }

    /// Removes the writes of a deleted swarm.
    pub(super) fn remove_swarm(&mut self, swarm: &str) {
        self.retain(|write| write.swarm() != Some(swarm));
    }

    pub(super) fn is_empty(&self) -> bool {
        self.submits.is_empty()
    }

    /// Whether it exceeds its limits although everything that can be dropped was.
    pub(super) fn is_overrun(&self) -> bool {
        self.size.0 > self.max.0 || self.size.1 > self.max.1
    }

    pub(super) fn writes(&self) -> usize {
        self.size.0
    }

    fn add(&mut self, submit: Submit) {
        let (writes, bytes) = submit.size();
        self.size = (self.size.0 + writes, self.size.1 + bytes);
        self.submits.push_back(submit);
    }

    fn drop_if_overrun(&mut self, is_dropped: impl Fn(&Write) -> bool) {
        if self.is_overrun() {
            self.retain(|write| !is_dropped(write));
        }
    }

    fn retain(&mut self, is_retained: impl Fn(&Write) -> bool) {
        self.size = (0, 0);
        for mut submit in std::mem::take(&mut self.submits) {
            // A submit without writes waits for those before it: keep it.
            let only_waits = submit.writes.is_empty();
            submit.writes.retain(&is_retained);
            if only_waits || !submit.writes.is_empty() {
                self.add(submit);
            }
        }
    }
}
