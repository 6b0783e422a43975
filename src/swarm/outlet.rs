//! Where a swarm puts what is to be published: its newest frames and its events, in order.
//!
//! The swarm never waits here. Whoever publishes takes what is there when it gets round to it; of
//! more frames than there is room for it finds the newest. A recording taps the outlet: it receives
//! every state that the swarm steps to, whether or not that is published.

use std::cell::OnceCell;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use crate::metrics::add;
use crate::swarm::frame::{Event, Frame};

/// Individuals in the frames kept for a publisher that lags: a megabyte of them. The oldest frames
/// give way, and the newest stays whatever its size.
const MOST_INDIVIDUALS: usize = 16 * 1024;

/// Events kept for a publisher that lags; the oldest give way, and their numbers show it.
const MOST_EVENTS: usize = 4096;

/// Receives every state and event of a swarm, on the swarm's thread: it must not block.
pub trait Tap: Send + Sync {
    /// The swarm is at this epoch and step; `frame` copies its state, if that is wanted.
    fn state(&self, at: (u64, u64), frame: &dyn Fn() -> Arc<Frame>);

    /// Something happened.
    fn event(&self, event: &Event);

    /// Whether the swarm may step on. If not, the tap wakes the swarm's thread once it may.
    fn has_room(&self) -> bool;
}

/// The place between one swarm and whoever publishes it.
pub struct Outlet {
    /// The swarm's name.
    pub name: String,
    contents: Mutex<Contents>,
    taps: Mutex<Vec<Weak<dyn Tap>>>,
    /// Whether there may be a tap, so that a step without one takes no lock.
    is_tapped: AtomicBool,
    frames: AtomicU64,
    dropped: AtomicU64,
    published: AtomicU64,
    ring: Box<dyn Fn() + Send + Sync>,
    is_watched: Box<dyn Fn(bool) -> bool + Send + Sync>,
}

#[derive(Default)]
struct Contents {
    frames: VecDeque<Arc<Frame>>,
    individuals: usize,
    events: VecDeque<Event>,
    rung: bool,
}

impl Outlet {
    /// An outlet that calls `ring` when it has something after having been emptied.
    pub fn new(
        name: String,
        ring: impl Fn() + Send + Sync + 'static,
        is_watched: impl Fn(bool) -> bool + Send + Sync + 'static,
    ) -> Self {
        Outlet {
            name,
            contents: Mutex::default(),
            taps: Mutex::default(),
            is_tapped: AtomicBool::new(false),
            frames: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            published: AtomicU64::new(0),
            ring: Box::new(ring),
            is_watched: Box::new(is_watched),
        }
    }

    /// Whether a frame would be read; without readers none need be made. Of a moving swarm the next
    /// ones tell whoever has come this moment.
    pub fn is_watched(&self, is_moving: bool) -> bool {
        (self.is_watched)(is_moving)
    }

    /// Passes every state and event from now on to `tap`, until that is dropped.
    pub fn tap(&self, tap: &Arc<dyn Tap>) {
        self.taps
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(Arc::downgrade(tap));
        self.is_tapped.store(true, Ordering::Release);
    }

    /// Passes the state at an epoch and step to the taps. Only the swarm's thread may.
    pub fn state(&self, at: (u64, u64), frame: impl Fn() -> Arc<Frame>) {
        let copied = OnceCell::new();
        for tap in self.taps() {
            tap.state(at, &|| copied.get_or_init(&frame).clone());
        }
    }

    /// Whether every tap has room for another state. If not, the swarm's thread is woken once it
    /// has.
    pub fn has_room(&self) -> bool {
        // Query every tap without short-circuit, so that each full one wakes the thread.
        let taps = self.taps();
        taps.iter().filter(|tap| !tap.has_room()).count() == 0
    }

    /// Puts the newest frame behind those not taken yet. Only the swarm's thread may.
    pub fn show(&self, frame: Arc<Frame>) {
        add(&self.frames, 1);
        self.put(|contents| {
            contents.individuals += frame.configuration.n();
            contents.frames.push_back(frame);
            while contents.individuals > MOST_INDIVIDUALS && contents.frames.len() > 1 {
                if let Some(oldest) = contents.frames.pop_front() {
                    contents.individuals -= oldest.configuration.n();
                    self.dropped.fetch_add(1, Ordering::Relaxed);
                }
            }
        });
    }

    /// Counts frames that were taken and gave way to a newer one all the same.
    pub fn passed_over(&self, count: u64) {
        self.dropped.fetch_add(count, Ordering::Relaxed);
    }

    /// The number of states that were published.
    pub fn published(&self) -> u64 {
        self.published.load(Ordering::Relaxed)
    }

    /// Counts a state that is published, and returns its number.
    pub fn count_published(&self) -> u64 {
        self.published.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// How many frames were put, and how many of them gave way to a newer one.
    pub fn frames(&self) -> (u64, u64) {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        (read(&self.frames), read(&self.dropped))
    }

    /// Puts an event behind those not taken yet.
    pub fn tell(&self, event: Event) {
        for tap in self.taps() {
            tap.event(&event);
        }
        self.put(|contents| {
            if contents.events.len() == MOST_EVENTS {
                contents.events.pop_front();
            }
            contents.events.push_back(event);
        });
    }

    /// Takes what is there.
    pub fn take(&self) -> (VecDeque<Arc<Frame>>, VecDeque<Event>) {
        let Contents { frames, events, .. } = std::mem::take(&mut *self.lock());
        (frames, events)
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

    /// The taps that there are.
    fn taps(&self) -> Vec<Arc<dyn Tap>> {
        if !self.is_tapped.load(Ordering::Acquire) {
            return Vec::new();
        }
        let mut taps = self.taps.lock().unwrap_or_else(PoisonError::into_inner);
        taps.retain(|tap| tap.strong_count() > 0);
        self.is_tapped.store(!taps.is_empty(), Ordering::Release);
        taps.iter().filter_map(Weak::upgrade).collect()
    }

    fn lock(&self) -> MutexGuard<'_, Contents> {
        // Nothing that changes the contents can panic in between.
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::swarm::frame::{EventKind, Place};
    use crate::swarm::phase::Phase;

    /// Adds up the numbers of events, and the steps of states.
    #[derive(Default)]
    struct Sum {
        events: AtomicU64,
        steps: AtomicU64,
    }

    impl Tap for Sum {
        fn state(&self, (_, step): (u64, u64), _: &dyn Fn() -> Arc<Frame>) {
            add(&self.steps, step);
        }

        fn event(&self, event: &Event) {
            add(&self.events, event.number);
        }

        fn has_room(&self) -> bool {
            self.steps.load(Ordering::Relaxed) < 7
        }
    }

    #[test]
    fn a_tap_receives_every_state_and_event_until_it_is_dropped() {
        let outlet = Outlet::new("demo".to_owned(), || {}, |_| false);
        let tell = |number| {
            let place = Place {
                epoch: 0,
                step: 0,
                time: 0.0,
                phase: Phase::Faulted("why".into()),
                seq: 0,
            };
            let kind = EventKind::Deleted;
            outlet.tell(Event {
                number,
                place,
                unix_secs: None,
                kind,
            });
            outlet.state((0, number), || unreachable!("no tap wants a copy"));
        };
        tell(1);
        let sum = Arc::new(Sum::default());
        let tap: Arc<dyn Tap> = sum.clone();
        outlet.tap(&tap);
        assert!(outlet.has_room());
        assert!(!outlet.is_watched(false), "it needs no published frame");
        tell(3);
        tell(4);
        assert!(!outlet.has_room());
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        assert_eq!((read(&sum.events), read(&sum.steps)), (7, 7));
        drop((tap, sum));
        assert!(outlet.has_room());
        tell(5);
        let (_, events) = outlet.take();
        assert_eq!(events.len(), 4, "the publisher has all of them, too");
    }
}
