//! Where a swarm puts what is to be published: its newest frame, and its events in order.
//!
//! The swarm never waits here. Whoever publishes takes what is there when it gets round to it;
//! of two frames it finds the newer.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::meter::add;
use crate::swarm::frame::{Event, Frame};

/// Events kept for a publisher that lags; the oldest give way, and their numbers show it.
const MOST_EVENTS: usize = 4096;

/// The place between one swarm and whoever publishes it.
pub struct Outlet {
    /// The swarm's name.
    pub name: String,
    contents: Mutex<Contents>,
    frames: AtomicU64,
    dropped: AtomicU64,
    ring: Box<dyn Fn() + Send + Sync>,
    is_watched: Box<dyn Fn() -> bool + Send + Sync>,
}

#[derive(Default)]
struct Contents {
    frame: Option<Arc<Frame>>,
    events: VecDeque<Event>,
    rung: bool,
}

impl Outlet {
    /// An outlet that calls `ring` when it has something after having been emptied.
    pub fn new(
        name: String,
        ring: impl Fn() + Send + Sync + 'static,
        is_watched: impl Fn() -> bool + Send + Sync + 'static,
    ) -> Self {
        Outlet {
            name,
            contents: Mutex::default(),
            frames: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            ring: Box::new(ring),
            is_watched: Box::new(is_watched),
        }
    }

    /// Whether a frame would be read; without readers none need be made.
    pub fn is_watched(&self) -> bool {
        (self.is_watched)()
    }

    /// Puts the newest frame; one that was not taken yet gives way. Only the swarm's thread may.
    pub fn show(&self, frame: Arc<Frame>) {
        add(&self.frames, 1);
        self.put(|contents| {
            if contents.frame.replace(frame).is_some() {
                add(&self.dropped, 1);
            }
        });
    }

    /// How many frames were put, and how many of them gave way to a newer one.
    pub fn frames(&self) -> (u64, u64) {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        (read(&self.frames), read(&self.dropped))
    }

    /// Puts an event behind those not taken yet.
    pub fn tell(&self, event: Event) {
        self.put(|contents| {
            if contents.events.len() == MOST_EVENTS {
                contents.events.pop_front();
            }
            contents.events.push_back(event);
        });
    }

    /// Takes what is there.
    pub fn take(&self) -> (Option<Arc<Frame>>, VecDeque<Event>) {
        let mut contents = self.lock();
        contents.rung = false;
        (contents.frame.take(), std::mem::take(&mut contents.events))
    }

    fn put(&self, put: impl FnOnce(&mut Contents)) {
        let ring = {
            let mut contents = self.lock();
            put(&mut contents);
            !std::mem::replace(&mut contents.rung, true)
        };
        if ring {
            (self.ring)();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Contents> {
        // Every change of the contents is a single assignment, so a panic leaves them whole.
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
