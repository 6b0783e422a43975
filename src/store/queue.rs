//! What waits to be written: bounded, in order, and taken in groups.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant};

use super::error::StoreFault;
use super::{Wanted, Write};

/// Writes that may wait, and the bytes they may take; who comes on top waits for room.
const MOST_WAITING: (usize, usize) = (8192, 64 * 1024 * 1024);

/// The same of what nobody waits for: a swarm that steps is not held up by those who flood
/// another with commands.
const MOST_LAZY: (usize, usize) = (1 << 17, 256 * 1024 * 1024);

/// Writes of one group, and their bytes: a commit of this size takes a few milliseconds.
pub(super) const GROUP: (usize, usize) = (1024, 4 * 1024 * 1024);

/// How long something nobody waits for is held back, so that others share its sync.
const LAZY_WAIT: Duration = Duration::from_millis(5);

/// Writes that are committed together, and whom to tell.
pub(super) struct Submit {
    /// In the order in which they apply.
    pub(super) writes: Vec<Write>,
    /// When they are to be written, and whom to tell.
    pub(super) wanted: Wanted,
}

impl Submit {
    /// How many writes, and bytes, it counts for.
    pub(super) fn size(&self) -> (usize, usize) {
        let bytes = self.writes.iter().map(Write::bytes).sum();
        (self.writes.len().max(1), bytes)
    }
}

/// Why the queue takes nothing more.
#[derive(Clone)]
pub(super) enum End {
    /// It was asked to stop.
    Stop,
    /// The store failed for good.
    Fatal(String),
}

impl End {
    /// What a submit is told.
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
    durable: usize,
    end: Option<End>,
    writer: Option<ThreadId>,
    /// When the writer wakes by itself, while it sleeps.
    wakes_at: Option<Instant>,
    /// Whether everything was written, once the writer has ended.
    outcome: Option<bool>,
}

/// The queue between those who submit and the writer.
#[derive(Default)]
pub(super) struct Queue {
    state: Mutex<State>,
    filled: Condvar,
    drained: Condvar,
}

impl Queue {
    /// Puts `submit` at the end, waiting while there is no room.
    ///
    /// The writer's own thread never waits: it would wait for itself.
    ///
    /// # Errors
    ///
    /// Gives `submit` back when the queue has ended.
    pub(super) fn push(&self, submit: Submit) -> Result<(), (Submit, End)> {
        let (writes, bytes) = submit.size();
        let most = match submit.wanted.is_now() {
            true => MOST_WAITING,
            false => MOST_LAZY,
        };
        let mut state = self.lock();
        while state.end.is_none()
            && !state.submits.is_empty()
            && (state.size.0 + writes > most.0 || state.size.1 + bytes > most.1)
            && state.writer != Some(thread::current().id())
        {
            state = self
                .drained
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
        self.put(state, submit)
    }

    /// Puts `submit` at the end, where there is room or not: its sender has no more than one there.
    ///
    /// # Errors
    ///
    /// Gives `submit` back when the queue has ended.
    pub(super) fn push_at_once(&self, submit: Submit) -> Result<(), (Submit, End)> {
        self.put(self.lock(), submit)
    }

    fn put(&self, mut state: MutexGuard<'_, State>, submit: Submit) -> Result<(), (Submit, End)> {
        let (writes, bytes) = submit.size();
        if let Some(end) = state.end.clone() {
            return Err((submit, end));
        }
        state.size = (state.size.0 + writes, state.size.1 + bytes);
        state.durable += usize::from(submit.wanted.is_now());
        let now = Instant::now();
        state.submits.push_back((submit, now));
        // Waking it takes as long as a step: those who follow share its sleep.
        let is_sooner = |wakes_at| due(&state, now).is_some_and(|due| due < wakes_at);
        if state.wakes_at.is_some_and(is_sooner) {
            state.wakes_at = None;
            self.filled.notify_one();
        }
        Ok(())
    }

    /// Takes the next group: as soon as somebody waits for it, there is enough for a group, or
    /// the oldest has been held back long enough. Nothing within `patience` gives an empty group.
    ///
    /// The end, if it has come, is told only with an empty group.
    pub(super) fn take(&self, patience: Duration) -> (Vec<Submit>, Option<End>) {
        let until = Instant::now() + patience;
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

    /// Takes no more from now on; the first reason stands unless a worse one comes.
    pub(super) fn end(&self, end: End) {
        let mut state = self.lock();
        if state.end.is_none() || matches!(end, End::Fatal(_)) {
            state.end = Some(end);
        }
        self.filled.notify_all();
        self.drained.notify_all();
    }

    /// Says whose thread the writer is.
    pub(super) fn is_written_here(&self) {
        self.lock().writer = Some(thread::current().id());
    }

    /// Whether this is the writer's thread.
    pub(super) fn is_writer(&self) -> bool {
        self.lock().writer == Some(thread::current().id())
    }

    /// Says that the writer has ended, and whether it wrote everything.
    pub(super) fn finish(&self, is_all_written: bool) {
        self.lock().outcome = Some(is_all_written);
        self.drained.notify_all();
    }

    /// Waits for the writer's end; `None` when `patience` is over before.
    pub(super) fn wait_for_end(&self, patience: Duration) -> Option<bool> {
        let (state, _) = self
            .drained
            .wait_timeout_while(self.lock(), patience, |state| state.outcome.is_none())
            .unwrap_or_else(PoisonError::into_inner);
        state.outcome
    }

    /// Writes that wait.
    pub(super) fn waiting(&self) -> usize {
        self.lock().size.0
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// When the next group is to be taken, if anything waits.
fn due(state: &State, now: Instant) -> Option<Instant> {
    let (_, since) = state.submits.front()?;
    let is_enough = state.size.0 >= GROUP.0 || state.size.1 >= GROUP.1;
    if state.durable > 0 || state.end.is_some() || is_enough {
        return Some(now);
    }
    Some(*since + LAZY_WAIT)
}

/// Takes what fits into one group, and at least one.
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
            state.durable -= usize::from(submit.wanted.is_now());
            group.push(submit);
        }
    }
    state.size = (state.size.0 - taken.0, state.size.1 - taken.1);
    group
}
