//! The queue between submitters and the writer thread: bounded, in order of submission, taken in groups.
//!
//! Sync and deferred submits share one queue, since a sync submit of a swarm follows its deferred
//! ones. Their limits differ, in writes and in bytes, which no channel offers.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant};

use super::error::StoreFault;
use super::{Durability, Write};

/// Writes and bytes in the queue beyond which a sync submit blocks.
const MAX_QUEUED: (usize, usize) = (8192, 64 * 1024 * 1024);

/// The same for deferred submits: a swarm that steps is not blocked by a flood of commands to another.
const MAX_QUEUED_DEFERRED: (usize, usize) = (1 << 17, 256 * 1024 * 1024);

/// Writes and bytes of one group: a commit of this size takes a few milliseconds.
pub(super) const GROUP: (usize, usize) = (1024, 4 * 1024 * 1024);

/// How long a deferred submit is held back, so that others share its sync.
const DEFERRED_DELAY: Duration = Duration::from_millis(5);

/// Writes that are committed together.
pub(super) struct Submit {
    /// In the order in which they apply.
    pub(super) writes: Vec<Write>,
    /// When they are written, and the callback.
    pub(super) durability: Durability,
}

impl Submit {
    /// The writes and bytes that it counts for.
    pub(super) fn size(&self) -> (usize, usize) {
        let bytes = self.writes.iter().map(Write::bytes).sum();
        (self.writes.len().max(1), bytes)
    }
}

/// Why the queue accepts no more submits.
#[derive(Clone)]
pub(super) enum End {
    /// The store was stopped.
    Stop,
    /// The store failed.
    Fatal(String),
}

impl End {
    /// The fault that later submits get.
    pub(super) fn fault(&self) -> StoreFault {
        match self {
            End::Stop => StoreFault::Stopped,
            End::Fatal(reason) => StoreFault::Fatal(reason.clone()),
        }
    }
}

#[derive(Default)]
struct State {
    submits: VecDeque<(Submit, Instant)>,
    size: (usize, usize),
    sync_submits: usize,
    end: Option<End>,
    writer: Option<ThreadId>,
    /// When the timeout of the sleeping writer ends.
    wakes_at: Option<Instant>,
    /// Set when the writer has ended: whether everything was written.
    outcome: Option<bool>,
}

/// The queue.
#[derive(Default)]
pub(super) struct Queue {
    state: Mutex<State>,
    filled: Condvar,
    drained: Condvar,
}

impl Queue {
    /// Appends `submit`, and waits while the queue is full, except on the writer thread, which would
    /// deadlock. If the queue has ended, a sync submit is completed with the reason.
    pub(super) fn push(&self, submit: Submit) {
        let (writes, bytes) = submit.size();
        let max = match submit.durability.is_sync() {
            true => MAX_QUEUED,
            false => MAX_QUEUED_DEFERRED,
        };
        let mut state = self.lock();
        while state.end.is_none()
            && !state.submits.is_empty()
            && (state.size.0 + writes > max.0 || state.size.1 + bytes > max.1)
            && state.writer != Some(thread::current().id())
        {
            state = self
                .drained
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
        if let Some(end) = state.end.clone() {
            drop(state);
            if let Durability::Sync(done) = submit.durability {
                done.committed(Err(end.fault()));
            }
            return;
        }
        state.size = (state.size.0 + writes, state.size.1 + bytes);
        state.sync_submits += usize::from(submit.durability.is_sync());
        let now = Instant::now();
        state.submits.push_back((submit, now));
        // Waking the writer takes as long as a step: wake it only if this submit is due sooner.
        let is_sooner = |wakes_at| due(&state, now).is_some_and(|due| due < wakes_at);
        if state.wakes_at.is_some_and(is_sooner) {
            state.wakes_at = None;
            self.filled.notify_one();
        }
    }

    /// Takes the next group as soon as a sync submit is queued, a group is full, or the oldest submit
    /// has been held back long enough; an empty group after `timeout`.
    ///
    /// The end of the queue is returned only with an empty group.
    pub(super) fn take(&self, timeout: Duration) -> (Vec<Submit>, Option<End>) {
        let until = Instant::now() + timeout;
        let mut state = self.lock();
        loop {
            let now = Instant::now();
            let due = due(&state, now);
            if due.is_some_and(|due| due <= now) {
                let group = take_group(&mut state);
                self.drained.notify_all();
                return (group, None);
            }
            if state.end.is_some() || until <= now {
                return (Vec::new(), state.end.clone());
            }
            let wake = due.map_or(until, |due| due.min(until));
            state.wakes_at = Some(wake);
            (state, _) = self
                .filled
                .wait_timeout(state, wake - now)
                .unwrap_or_else(PoisonError::into_inner);
            state.wakes_at = None;
        }
    }

    /// Ends the queue; `Fatal` replaces an earlier reason.
    pub(super) fn end(&self, end: End) {
        let mut state = self.lock();
        if state.end.is_none() || matches!(end, End::Fatal(_)) {
            state.end = Some(end);
        }
        self.filled.notify_all();
        self.drained.notify_all();
    }

    /// Marks the calling thread as the writer.
    pub(super) fn set_writer_thread(&self) {
        self.lock().writer = Some(thread::current().id());
    }

    /// Whether the calling thread is the writer.
    pub(super) fn is_writer(&self) -> bool {
        self.lock().writer == Some(thread::current().id())
    }

    /// Records that the writer has ended, and whether it wrote everything.
    pub(super) fn finish(&self, is_all_written: bool) {
        self.lock().outcome = Some(is_all_written);
        self.drained.notify_all();
    }

    /// Waits for the end of the writer; `None` after `timeout`.
    pub(super) fn wait_for_end(&self, timeout: Duration) -> Option<bool> {
        let (state, _) = self
            .drained
            .wait_timeout_while(self.lock(), timeout, |state| state.outcome.is_none())
            .unwrap_or_else(PoisonError::into_inner);
        state.outcome
    }

    /// Writes in the queue.
    pub(super) fn waiting(&self) -> usize {
        self.lock().size.0
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// When the next group is to be taken, if the queue is not empty.
fn due(state: &State, now: Instant) -> Option<Instant> {
    let (_, since) = state.submits.front()?;
    let is_enough = state.size.0 >= GROUP.0 || state.size.1 >= GROUP.1;
    if state.sync_submits > 0 || state.end.is_some() || is_enough {
        return Some(now);
    }
    Some(*since + DEFERRED_DELAY)
}

/// Takes the submits that fit into one group, at least one.
fn take_group(state: &mut State) -> Vec<Submit> {
    let mut group = Vec::new();
    let mut taken = (0, 0);
    while let Some((submit, _)) = state.submits.front() {
        let (writes, bytes) = submit.size();
        if !group.is_empty() && (taken.0 + writes > GROUP.0 || taken.1 + bytes > GROUP.1) {
            break;
        }
        taken = (taken.0 + writes, taken.1 + bytes);
        if let Some((submit, _)) = state.submits.pop_front() {
            state.sync_submits -= usize::from(submit.durability.is_sync());
            group.push(submit);
        }
    }
    state.size = (state.size.0 - taken.0, state.size.1 - taken.1);
    group
}
