//! Between a swarm and the thread that writes its recording: what waits to be written.
//!
//! The swarm never waits here. What there is no room for is left out, and counted.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime};

use jostle_results::recording::Written;

use crate::swarm::frame::{Event, EventKind, Frame};
use crate::swarm::outlet::{Outlet, Tap, Tapped};

/// Frames that may wait: more than a second of them.
const MOST_FRAMES: usize = 64;

/// Individuals that may wait in frames, beside those of a first one: some megabytes.
const MOST_INDIVIDUALS: usize = 128 * 1024;

/// Events that may wait.
const MOST_EVENTS: usize = 4096;

/// What comes next.
pub enum Next {
    /// A frame, its number and when it was taken.
    Frame(Arc<Frame>, u64, SystemTime),
    /// An event and when it was taken.
    Event(Box<Event>, SystemTime),
    /// Nothing came until then.
    Nothing,
    /// Nothing more comes.
    End(End),
}

/// Why nothing more comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Somebody stopped it.
    Stopped,
    /// The swarm was deleted.
    Deleted,
    /// The daemon stops.
    Closing,
}

/// What waits to be written, and how far the writing is.
pub struct Intake {
    every: Option<u64>,
    contents: Mutex<Contents>,
    changed: Condvar,
}

#[derive(Default)]
struct Contents {
    waiting: VecDeque<Next>,
    frames: usize,
    individuals: usize,
    /// Epoch and step of the last frame that was taken.
    taken: Option<(u64, u64)>,
    missed: u64,
    written: Written,
    end: Option<End>,
}

impl Intake {
    /// Takes frames at least so many steps apart, or all; `missed` are missed already.
    pub fn new(every: Option<u64>, missed: u64) -> Self {
        Intake {
            every,
            contents: Mutex::new(Contents {
                missed,
                ..Contents::default()
            }),
            changed: Condvar::new(),
        }
    }

    /// Takes the frame that is there, and all that comes until what is returned is dropped. To be
    /// called between two steps.
    pub fn tap(self: &Arc<Self>, outlet: &Outlet, now: &Arc<Frame>) -> Arc<Tap> {
        let (number, _) = outlet.frames();
        self.take(Tapped::Frame(now, number));
        let intake = self.clone();
        let tap: Arc<Tap> = Arc::new(move |tapped: Tapped<'_>| intake.take(tapped));
        outlet.tap(&tap);
        tap
    }

    fn take(&self, tapped: Tapped<'_>) {
        let mut contents = self.lock();
        if contents.end.is_some() {
            return;
        }
        let now = SystemTime::now();
        match tapped {
            Tapped::Frame(frame, number) => {
                let place = (frame.place.epoch, frame.place.step);
                let is_near = match (self.every, contents.taken) {
                    (Some(every), Some((epoch, step))) => {
                        epoch == place.0 && place.1.saturating_sub(step) < every
                    }
                    _ => false,
                };
                if is_near {
                    return;
                }
                let n = frame.configuration.n();
                let is_much = contents.frames > 0 && contents.individuals + n > MOST_INDIVIDUALS;
                if is_much || contents.frames >= MOST_FRAMES {
                    contents.missed += 1;
                    return;
                }
                contents.taken = Some(place);
                contents.frames += 1;
                contents.individuals += n;
                let next = Next::Frame(frame.clone(), number, now);
                contents.waiting.push_back(next);
            }
            Tapped::Event(event) => {
                if matches!(event.kind, EventKind::Deleted) {
                    contents.end = Some(End::Deleted);
                }
                if contents.waiting.len() - contents.frames < MOST_EVENTS {
                    let next = Next::Event(Box::new(event.clone()), now);
                    contents.waiting.push_back(next);
                }
            }
        }
        drop(contents);
        self.changed.notify_all();
    }

    /// Waits for what comes next, at most until then.
    pub fn next(&self, until: Option<Instant>) -> Next {
        let mut contents = self.lock();
        loop {
            if let Some(next) = contents.waiting.pop_front() {
                if let Next::Frame(frame, ..) = &next {
                    contents.frames -= 1;
                    contents.individuals -= frame.configuration.n();
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
                Some(left) if left.is_zero() => return Next::Nothing,
                Some(left) => {
                    let waited = self.changed.wait_timeout(contents, left);
                    waited.unwrap_or_else(PoisonError::into_inner).0
                }
            };
        }
    }

    /// Takes nothing more; what waits is still to be written.
    pub fn end(&self, end: End) {
        self.lock().end.get_or_insert(end);
        self.changed.notify_all();
    }

    /// Says how much is written.
    pub fn note(&self, written: Written) {
        self.lock().written = written;
    }

    /// How much is written, and how many frames were missed.
    pub fn progress(&self) -> (Written, u64) {
        let contents = self.lock();
        (contents.written, contents.missed)
    }

    fn lock(&self) -> MutexGuard<'_, Contents> {
        // What changes together is numbers and a queue, which nothing in between can tear apart.
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
