//! The bounded queues of frames and events between a swarm and the publisher.
//!
//! The thread of the swarm never waits here: when a queue is full, the oldest entries are dropped. A
//! recording subscribes to the output to receive every state, whether or not it is published.

use std::cell::OnceCell;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use crate::metrics::add;
use crate::swarm::frame::{Event, Frame};

/// Individuals in the queued frames, about a megabyte. Beyond it the oldest frames are dropped; the
/// newest stays whatever its size.
const MAX_INDIVIDUALS: usize = 16 * 1024;

/// Queued events. Beyond it the oldest are dropped, which subscribers see from the event numbers.
const MAX_EVENTS: usize = 4096;

/// Receives every state and event on the thread of the swarm; it must not block.
pub trait Subscriber: Send + Sync {
    /// The swarm has reached this epoch and step; `frame` copies its state.
    fn state(&self, at: (u64, u64), frame: &dyn Fn() -> Arc<Frame>);

    /// An event.
    fn event(&self, event: &Event);

    /// Whether the swarm may take another step. If not, the subscriber wakes its thread later.
    fn has_room(&self) -> bool;
}

/// The queues of one swarm.
pub struct Output {
    /// The swarm's name.
    pub name: String,
    contents: Mutex<Contents>,
    subscribers: Mutex<Vec<Weak<dyn Subscriber>>>,
    /// False only if there are no subscribers: a step without one takes no lock.
    has_subscribers: AtomicBool,
    frames: AtomicU64,
    dropped: AtomicU64,
    published: AtomicU64,
    notify: Box<dyn Fn() + Send + Sync>,
    is_watched: Box<dyn Fn(bool) -> bool + Send + Sync>,
}

#[derive(Default)]
struct Contents {
    frames: VecDeque<Arc<Frame>>,
    individuals: usize,
    events: VecDeque<Event>,
    is_notified: bool,
}

impl Output {
    /// An empty output. `notify` is called when it is no longer empty; `is_watched` as in
    /// [`Self::is_watched`].
    pub fn new(
        name: String,
        notify: impl Fn() + Send + Sync + 'static,
        is_watched: impl Fn(bool) -> bool + Send + Sync + 'static,
    ) -> Self {
        Output {
            name,
            contents: Mutex::default(),
            subscribers: Mutex::default(),
            has_subscribers: AtomicBool::new(false),
            frames: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            published: AtomicU64::new(0),
            notify: Box::new(notify),
            is_watched: Box::new(is_watched),
        }
    }

    /// Whether a frame would have a reader. For a moving swarm the answer may lag, since a new reader
    /// gets the next frame.
    pub fn is_watched(&self, is_moving: bool) -> bool {
        (self.is_watched)(is_moving)
    }

    /// Passes every later state and event to `subscriber`, until it is dropped.
    pub fn subscribe(&self, subscriber: &Arc<dyn Subscriber>) {
        self.subscribers
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(Arc::downgrade(subscriber));
        self.has_subscribers.store(true, Ordering::Release);
    }

    /// Passes the state at an epoch and step to the subscribers. Only for the thread of the swarm.
    pub fn state(&self, at: (u64, u64), frame: impl Fn() -> Arc<Frame>) {
        let copied = OnceCell::new();
        for subscriber in self.subscribers() {
            subscriber.state(at, &|| copied.get_or_init(&frame).clone());
        }
    }

    /// Whether every subscriber has room for another state. If not, the thread of the swarm is woken
    /// once it has.
    pub fn has_room(&self) -> bool {
        // No short-circuit: each full subscriber must know that the thread waits.
        let subscribers = self.subscribers();
        subscribers
            .iter()
            .filter(|subscriber| !subscriber.has_room())
            .count()
            == 0
    }

    /// Queues a frame. Only for the thread of the swarm.
    pub fn push_frame(&self, frame: Arc<Frame>) {
        add(&self.frames, 1);
        self.put(|contents| {
            contents.individuals += frame.configuration.n();
            contents.frames.push_back(frame);
            while contents.individuals > MAX_INDIVIDUALS && contents.frames.len() > 1 {
                if let Some(oldest) = contents.frames.pop_front() {
                    contents.individuals -= oldest.configuration.n();
                    self.dropped.fetch_add(1, Ordering::Relaxed);
                }
            }
        });
    }

    /// Counts frames that the publisher dropped for a newer one.
    pub fn count_dropped(&self, count: u64) {
        self.dropped.fetch_add(count, Ordering::Relaxed);
    }

    /// The number of states that were published.
    pub fn published(&self) -> u64 {
        self.published.load(Ordering::Relaxed)
    }

    /// Counts a published state, and returns its number.
    pub fn count_published(&self) -> u64 {
        self.published.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// How many frames were queued, and how many of them were dropped.
    pub fn frames(&self) -> (u64, u64) {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        (read(&self.frames), read(&self.dropped))
    }

    /// Queues an event.
    pub fn push_event(&self, event: Event) {
        for subscriber in self.subscribers() {
            subscriber.event(&event);
        }
        self.put(|contents| {
            if contents.events.len() == MAX_EVENTS {
                contents.events.pop_front();
            }
            contents.events.push_back(event);
        });
    }

    /// Takes all queued frames and events.
    pub fn take(&self) -> (VecDeque<Arc<Frame>>, VecDeque<Event>) {
        let Contents { frames, events, .. } = std::mem::take(&mut *self.lock());
        (frames, events)
    }

    fn put(&self, put: impl FnOnce(&mut Contents)) {
        let notify = {
            let mut contents = self.lock();
            put(&mut contents);
            !std::mem::replace(&mut contents.is_notified, true)
        };
        if notify {
            (self.notify)();
        }
    }

    /// The subscribers that still exist.
    fn subscribers(&self) -> Vec<Arc<dyn Subscriber>> {
        if !self.has_subscribers.load(Ordering::Acquire) {
            return Vec::new();
        }
        let mut subscribers = self
            .subscribers
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        subscribers.retain(|subscriber| subscriber.strong_count() > 0);
        self.has_subscribers
            .store(!subscribers.is_empty(), Ordering::Release);
        subscribers.iter().filter_map(Weak::upgrade).collect()
    }

    fn lock(&self) -> MutexGuard<'_, Contents> {
        // No change of the contents panics halfway.
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::swarm::frame::{EventKind, Stamp};
    use crate::swarm::phase::Phase;

    /// Sums the numbers of events and the steps of states.
    #[derive(Default)]
    struct Sum {
        events: AtomicU64,
        steps: AtomicU64,
    }

    impl Subscriber for Sum {
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
    fn a_subscriber_receives_every_state_and_event_until_it_is_dropped() {
        let output = Output::new("demo".to_owned(), || {}, |_| false);
        let push_event = |number| {
            let stamp = Stamp {
                epoch: 0,
                step: 0,
                time: 0.0,
                phase: Phase::Faulted("why".into()),
                seq: 0,
            };
            let kind = EventKind::Deleted;
            output.push_event(Event {
                number,
                stamp,
                unix_secs: None,
                kind,
            });
            output.state((0, number), || unreachable!("no subscriber wants a copy"));
        };
        push_event(1);
        let sum = Arc::new(Sum::default());
        let subscriber: Arc<dyn Subscriber> = sum.clone();
        output.subscribe(&subscriber);
        assert!(output.has_room());
        assert!(
            !output.is_watched(false),
            "a subscriber needs no published frame"
        );
        push_event(3);
        push_event(4);
        assert!(!output.has_room());
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        assert_eq!((read(&sum.events), read(&sum.steps)), (7, 7));
        drop((subscriber, sum));
        assert!(output.has_room());
        push_event(5);
        let (_, events) = output.take();
        assert_eq!(events.len(), 4, "the publisher has all of them, too");
    }
}
