//! The bounded queue between a swarm and the thread that writes its recording.
//!
//! By default the swarm takes no step while the queue is full, so that no state is dropped. A
//! recording with `drop_when_behind` never blocks the swarm, and counts the states that it drops.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime};

use jostle_results::recording::Written;

use crate::swarm::frame::{Event, EventKind, Frame};
use crate::swarm::output::Subscriber;

/// Capacity of the queue in states.
const MAX_FRAMES: usize = 64;

/// Capacity of the queue in individuals of these states: some megabytes.
const MAX_INDIVIDUALS: usize = 128 * 1024;

/// A state that the swarm produces without a check of the queue, as after a reset, is enqueued up to
/// this multiple of the capacity.
const MAX_OVERFULL: usize = 2;

/// Capacity of the queue in events; later ones are dropped.
const MAX_EVENTS: usize = 4096;

/// The result of a wait for the next item.
pub enum Next {
    /// A state and when it was enqueued.
    Frame(Arc<Frame>, SystemTime),
    /// An event and when it was enqueued.
    Event(Box<Event>, SystemTime),
    /// The wait timed out.
    Timeout,
    /// The queue is closed and empty.
    End(End),
}

/// Why the queue is closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// A client stopped the recording.
    Stopped,
    /// The swarm was deleted.
    Deleted,
    /// The swarm has taken the requested number of steps.
    Complete,
    /// The recording has reached its maximum size.
    Full {
        /// The maximum.
        max_bytes: u64,
    },
    /// All recordings together have reached the quota.
    OverQuota {
        /// The quota.
        quota_bytes: u64,
    },
    /// The daemon is stopping; the recording resumes when it restarts.
    Closing,
}

impl End {
    /// Why the recording has ended; `None` if it resumes.
    pub fn reason(self) -> Option<String> {
        Some(match self {
            End::Closing => return None,
            End::Stopped => "stopped".to_owned(),
            End::Deleted => "its swarm was deleted".to_owned(),
            End::Complete => "all its steps are recorded".to_owned(),
            End::Full { max_bytes } => format!(
                "its next states could exceed max_bytes ({max_bytes}): record again with a higher \
                 limit"
            ),
            End::OverQuota { quota_bytes } => format!(
                "the daemon's recordings have reached their {} MiB (recordings_quota_mb)",
                quota_bytes >> 20
            ),
        })
    }
}

/// Which states are recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Those whose step is a multiple of this.
    pub every: u64,
    /// Whether a state is dropped while the queue is full; otherwise the swarm waits.
    pub drops: bool,
    /// The number of steps of the swarm after which the recording ends.
    pub steps: Option<u64>,
}

/// The queue, and the progress of the writer.
pub struct FrameQueue {
    choice: Choice,
    wake: Box<dyn Fn() + Send + Sync>,
    contents: Mutex<Contents>,
    changed: Condvar,
}

#[derive(Default)]
struct Contents {
    waiting: VecDeque<Next>,
    frames: usize,
    individuals: usize,
    /// Epoch and step of the last state, recorded or not.
    last: Option<(u64, u64)>,
    /// Steps that the swarm has taken.
    steps: u64,
    /// Whether the swarm waits for the queue.
    is_blocking: bool,
    missed: u64,
    written: Written,
    /// The bytes of all files, including the unfinished part.
    size: u64,
    end: Option<End>,
}

impl Contents {
    fn is_full(&self, times: usize) -> bool {
        self.frames >= times * MAX_FRAMES || self.individuals >= times * MAX_INDIVIDUALS
    }
}

impl FrameQueue {
    /// An empty queue; `wake` wakes the swarm's thread, and `missed` is the initial count.
    pub fn new(choice: Choice, missed: u64, wake: impl Fn() + Send + Sync + 'static) -> Self {
        FrameQueue {
            choice,
            wake: Box::new(wake),
            contents: Mutex::new(Contents {
                missed,
                ..Contents::default()
            }),
            changed: Condvar::new(),
        }
    }

    /// Waits for the next item, at most until then.
    pub fn next(&self, until: Option<Instant>) -> Next {
        let mut contents = self.lock();
        loop {
            if let Some(next) = contents.waiting.pop_front() {
                if let Next::Frame(frame, ..) = &next {
                    contents.frames -= 1;
                    contents.individuals -= frame.configuration.n();
                }
                // Half empty, so that the swarm is not woken for every single step.
                if 2 * contents.frames <= MAX_FRAMES && !contents.is_full(1) {
                    self.unblock(contents);
                }
                return next;
            }
            if let Some(end) = contents.end {
                return Next::End(end);
            }
            contents = match until.map(|until| until.saturating_duration_since(Instant::now())) {
                None => {
                    let waited = self.changed.wait(contents);
                    waited.unwrap_or_else(PoisonError::into_inner)
                }
                Some(left) if left.is_zero() => return Next::Timeout,
                Some(left) => {
                    let waited = self.changed.wait_timeout(contents, left);
                    waited.unwrap_or_else(PoisonError::into_inner).0
                }
            };
        }
    }

    /// Closes the queue: later states are ignored and the swarm no longer waits. The writer still
    /// writes the states in the queue.
    pub fn end(&self, end: End) {
        let mut contents = self.lock();
        contents.end.get_or_insert(end);
        self.unblock(contents);
        self.changed.notify_all();
    }

    /// Sets the progress of the writer, and the bytes of all files.
    pub fn set_progress(&self, written: Written, size: u64) {
        let mut contents = self.lock();
        (contents.written, contents.size) = (written, size);
    }

    /// The bytes of all files, including the unfinished part.
    pub fn size(&self) -> u64 {
        self.lock().size
    }

    /// The progress of the writer, and the number of dropped states.
    pub fn progress(&self) -> (Written, u64) {
        let contents = self.lock();
        (contents.written, contents.missed)
    }

    /// The remaining steps, if their number is limited.
    pub fn steps_left(&self) -> Option<u64> {
        let steps = self.lock().steps;
        self.choice.steps.map(|all| all.saturating_sub(steps))
    }

    fn enqueue(&self, contents: &mut Contents, next: Next) {
        contents.waiting.push_back(next);
        // The writing thread sleeps only while the queue is empty.
        if contents.waiting.len() == 1 {
            self.changed.notify_all();
        }
    }

    /// Wakes the swarm's thread if it waits for this queue.
    fn unblock(&self, mut contents: MutexGuard<'_, Contents>) {
        let is_blocking = std::mem::take(&mut contents.is_blocking);
        drop(contents);
        if is_blocking {
            (self.wake)();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Contents> {
        // Nothing between two changes can panic.
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Subscriber for FrameQueue {
    fn state(&self, at: (u64, u64), frame: &dyn Fn() -> Arc<Frame>) {
        let mut contents = self.lock();
        if contents.end.is_some() || contents.last == Some(at) {
            return;
        }
        if let Some((epoch, step)) = contents.last.replace(at)
            && epoch == at.0
        {
            contents.steps += at.1.saturating_sub(step);
        }
        if at.1.is_multiple_of(self.choice.every) {
            let times = if self.choice.drops { 1 } else { MAX_OVERFULL };
            if contents.is_full(times) {
                contents.missed += 1;
            } else {
                let frame = frame();
                contents.frames += 1;
                contents.individuals += frame.configuration.n();
                self.enqueue(&mut contents, Next::Frame(frame, SystemTime::now()));
            }
        }
        if self.choice.steps.is_some_and(|all| contents.steps >= all) {
            contents.end = Some(End::Complete);
            self.changed.notify_all();
        }
    }

    fn event(&self, event: &Event) {
        let mut contents = self.lock();
        if contents.end.is_some() {
            return;
        }
        if contents.waiting.len() - contents.frames < MAX_EVENTS {
            let next = Next::Event(Box::new(event.clone()), SystemTime::now());
            self.enqueue(&mut contents, next);
        }
        if matches!(event.kind, EventKind::Deleted) {
            contents.end = Some(End::Deleted);
            self.changed.notify_all();
        }
    }

    fn has_room(&self) -> bool {
        let mut contents = self.lock();
        let has_room = self.choice.drops || contents.end.is_some() || !contents.is_full(1);
        contents.is_blocking |= !has_room;
        has_room
    }
}
