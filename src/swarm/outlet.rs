//! Where a swarm puts what is to be published: its newest frames and its events, in order.
//!
//! The swarm never waits here. Whoever publishes takes what is there when it gets round to it; of
//! more frames than there is room for it finds the newest. Whoever has to have all of them taps the
//! outlet.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use crate::meter::add;
use crate::swarm::frame::{Event, Frame};

/// Individuals in the frames kept for a publisher that lags: a megabyte of them. The oldest frames
/// give way, and the newest stays whatever its size.
const MOST_INDIVIDUALS: usize = 16 * 1024;

/// Events kept for a publisher that lags; the oldest give way, and their numbers show it.
const MOST_EVENTS: usize = 4096;

/// Takes all that is put into an outlet, on the swarm's thread: it must not wait.
pub type Tap = dyn Fn(Tapped<'_>) + Send + Sync;

/// What a tap takes.
#[derive(Clone, Copy)]
pub enum Tapped<'a> {
    /// A frame, and how many there were with it.
    Frame(&'a Arc<Frame>, u64),
    /// An event.
    Event(&'a Event),
}

/// The place between one swarm and whoever publishes it.
pub struct Outlet {
    /// The swarm's name.
    pub name: String,
    contents: Mutex<Contents>,
    taps: Mutex<Vec<Weak<Tap>>>,
    frames: AtomicU64,
    dropped: AtomicU64,
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
            frames: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            ring: Box::new(ring),
            is_watched: Box::new(is_watched),
        }
    }

    /// Whether a frame would be read; without readers none need be made. Of a moving swarm the next
    /// ones tell whoever has come this moment.
    pub fn is_watched(&self, is_moving: bool) -> bool {
        (self.is_watched)(is_moving) || self.taps().iter().any(|tap| tap.strong_count() > 0)
    }

    /// Has all that is put here from now on go to `tap` too, until that is dropped.
    pub fn tap(&self, tap: &Arc<Tap>) {
        let mut taps = self.taps();
        taps.retain(|tap| tap.strong_count() > 0);
        taps.push(Arc::downgrade(tap));
    }

    /// Puts the newest frame behind those not taken yet. Only the swarm's thread may.
    pub fn show(&self, frame: Arc<Frame>) {
        add(&self.frames, 1);
        self.pass(|number| Tapped::Frame(&frame, number));
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

    /// How many frames were put, and how many of them gave way to a newer one.
    pub fn frames(&self) -> (u64, u64) {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        (read(&self.frames), read(&self.dropped))
    }

    /// Puts an event behind those not taken yet.
    pub fn tell(&self, event: Event) {
        self.pass(|_| Tapped::Event(&event));
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

    /// Does something that puts more than one thing here, and something else besides that is waited
    /// for: rings when all of it is done.
    pub fn ring_after<T>(&self, work: impl FnOnce() -> T) -> T {
        let is_rung = std::mem::replace(&mut self.lock().rung, true);
        let _ring = (!is_rung).then(|| RingAfter(self));
        work()
    }

    /// Passes to the taps what `of` makes of the number of frames so far.
    fn pass<'a>(&self, of: impl Fn(u64) -> Tapped<'a>) {
        let number = self.frames.load(Ordering::Relaxed);
        for tap in self.taps().iter().filter_map(Weak::upgrade) {
            tap(of(number));
        }
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

    fn taps(&self) -> MutexGuard<'_, Vec<Weak<Tap>>> {
        // A tap that panics takes nothing from the list.
        self.taps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn lock(&self) -> MutexGuard<'_, Contents> {
        // Nothing that changes the contents can panic in between.
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Rings when dropped, if something is there.
struct RingAfter<'a>(&'a Outlet);

impl Drop for RingAfter<'_> {
    fn drop(&mut self) {
        let Outlet { ring, .. } = self.0;
        let has_any = {
            let mut contents = self.0.lock();
            contents.rung = !contents.frames.is_empty() || !contents.events.is_empty();
            contents.rung
        };
        if has_any {
            ring();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::swarm::frame::{EventKind, Place};
    use crate::swarm::phase::Phase;

    #[test]
    fn a_tap_takes_all_that_is_told_until_it_is_dropped() {
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
                kind,
            });
        };
        tell(1);
        let taken = Arc::new(AtomicU64::new(0));
        let sum = taken.clone();
        let tap: Arc<Tap> = Arc::new(move |tapped: Tapped<'_>| {
            if let Tapped::Event(event) = tapped {
                add(&sum, event.number);
            }
        });
        assert!(!outlet.is_watched(false));
        outlet.tap(&tap);
        assert!(outlet.is_watched(false));
        tell(2);
        tell(3);
        drop(tap);
        assert!(!outlet.is_watched(false));
        tell(4);
        assert_eq!(taken.load(Ordering::Relaxed), 5);
        let (_, events) = outlet.take();
        assert_eq!(events.len(), 4, "whoever publishes has all of them, too");
    }
}
