//! The queue between submitters and the writer thread: bounded, in order of submission, taken in groups.
//!
//! Sync and deferred submits share one queue, since a sync submit of a swarm follows its deferred
//! ones. Their limits differ, in writes and in bytes, which no channel offers.

use std::collections::VecDeque;
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};

use super::error::StoreFault;
use super::{Durability, Write};

/// Writes and bytes in the queue beyond which a sync submit blocks.
const MAX_QUEUED: (usize, usize) = (8192, 64 * 1024 * 1024);

/// The same for deferred submits: a swarm that steps is not blocked by a flood of commands to another.
const MAX_QUEUED_DEFERRED: (usize, usize) = (1 << 17, 256 * 1024 * 1024);

/// Writes and bytes of one group: a commit of this size takes a few milliseconds.
const GROUP: (usize, usize) = (1024, 4 * 1024 * 1024);

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

#[derive(Default)]
struct State {
    submits: VecDeque<(Submit, Instant)>,
    size: (usize, usize),
    sync_submits: usize,
    /// Why the queue accepts no more submits.
    end: Option<StoreFault>,
    writer: Option<ThreadId>,
    /// When the timeout of the sleeping writer ends.
    wakes_at: Option<Instant>,
    /// Set when the writer has ended: whether everything was written.
    outcome: Option<bool>,
}

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
        let mut state = self.state.lock();
        while state.end.is_none()
            && !state.submits.is_empty()
            && (state.size.0 + writes > max.0 || state.size.1 + bytes > max.1)
            && state.writer != Some(thread::current().id())
        {
            self.drained.wait(&mut state);
        }
        if let Some(end) = state.end.clone() {
            drop(state);
            if let Durability::Sync(done) = submit.durability {
                done.committed(Err(end));
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
    /// has been held back long enough; an empty group after `timeout`. The flag: whether the queue has ended
    /// and is empty.
    pub(super) fn take(&self, timeout: Duration) -> (Vec<Submit>, bool) {
        let until = Instant::now() + timeout;
        let mut state = self.state.lock();
        loop {
            let now = Instant::now();
            let due = due(&state, now);
            if due.is_some_and(|due| due <= now) {
                let group = take_group(&mut state);
                self.drained.notify_all();
                return (group, false);
            }
            if state.end.is_some() || until <= now {
                return (Vec::new(), state.end.is_some());
            }
            let wake = due.map_or(until, |due| due.min(until));
            state.wakes_at = Some(wake);
            self.filled.wait_for(&mut state, wake - now);
            state.wakes_at = None;
        }
    }

    /// Ends the queue: sync submits get `fault` from now on. `Fatal` replaces an earlier one.
    pub(super) fn end(&self, fault: StoreFault) {
        let mut state = self.state.lock();
        if state.end.is_none() || matches!(fault, StoreFault::Fatal(_)) {
            state.end = Some(fault);
        }
        self.filled.notify_all();
        self.drained.notify_all();
    }

    pub(super) fn set_writer_thread(&self) {
        self.state.lock().writer = Some(thread::current().id());
    }

    pub(super) fn is_writer(&self) -> bool {
        self.state.lock().writer == Some(thread::current().id())
    }

    /// Records that the writer has ended, and whether it wrote everything.
    pub(super) fn finish(&self, is_all_written: bool) {
        self.state.lock().outcome = Some(is_all_written);
        self.drained.notify_all();
    }

    /// Waits for the end of the writer; `None` after `timeout`.
    pub(super) fn wait_for_end(&self, timeout: Duration) -> Option<bool> {
        let mut state = self.state.lock();
        let is_running = |state: &mut State| state.outcome.is_none();
        self.drained.wait_while_for(&mut state, is_running, timeout);
        state.outcome
    }

    pub(super) fn waiting(&self) -> usize {
        self.state.lock().size.0
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

/// How many of these submits fit into one group, at least one.
pub(super) fn group_len<'a>(submits: impl Iterator<Item = &'a Submit>) -> usize {
    let mut taken = (0, 0);
    let fitting = submits.take_while(|submit| {
        let (writes, bytes) = submit.size();
        let is_first = taken == (0, 0);
        taken = (taken.0 + writes, taken.1 + bytes);
        is_first || (taken.0 <= GROUP.0 && taken.1 <= GROUP.1)
    });
    fitting.count()
}

fn take_group(state: &mut State) -> Vec<Submit> {
    let count = group_len(state.submits.iter().map(|(submit, _)| submit));
    let taken = state.submits.drain(..count).map(|(submit, _)| submit);
    let group: Vec<Submit> = taken.collect();
    for submit in &group {
        let (writes, bytes) = submit.size();
        state.size = (state.size.0 - writes, state.size.1 - bytes);
        state.sync_submits -= usize::from(submit.durability.is_sync());
    }
    group
}
