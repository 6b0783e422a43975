//! The states and events of a swarm, in one bounded queue for each subscription.
//!
//! | subscription | topic | queue | what is dropped | rate |
//! |---|---|---|---|---|
//! | publisher | `state`, `order` | 16,384 individuals | the oldest frames, if the publisher lags; all without a subscriber | each `publish_every`-th step, at most `max_hz`, and each change of a swarm that does not move |
//! | publisher | `event` | 4,096 events | the oldest events, if the publisher lags | each event, with or without a subscriber |
//! | recording | states | 64 states, 131,072 individuals | nothing: the swarm takes no step; with `drop_when_behind` the newest states, which are counted | each step that is a multiple of `every` |
//! | recording | events | 4,096 events | the newest events | each event |
//!
//! The thread of the swarm never waits for the publisher. A tab of the page is a subscriber of the
//! publisher: it receives encoded samples from the bus, which all tabs of a swarm share, through the
//! asynchronous channels of `src/transport/http/feed.rs`.

use std::cell::LazyCell;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock, Weak};
use std::time::{Duration, Instant, SystemTime};

use parking_lot::{Condvar, Mutex, MutexGuard};

use crate::swarm::frame::{Event, EventKind, Frame};

/// Individuals in the frames that are queued for the publisher, about a megabyte. The newest frame
/// stays whatever its size.
const MAX_PUBLISHED_INDIVIDUALS: usize = 16 * 1024;

/// Capacity of each queue in events. Subscribers see from the event numbers that some are missing.
const MAX_EVENTS: usize = 4096;

/// Multiple of its capacity up to which a blocking queue accepts the states that the swarm produces
/// without checking it, as after a reset.
const MAX_OVERFULL: usize = 2;

/// What a subscription receives, and the bounds of its queue.
pub struct Limits {
    /// The states whose step is a multiple of this.
    pub every: u64,
    /// The steps of the swarm after which the subscription ends.
    pub steps: Option<u64>,
    /// Capacity in states.
    pub frames: usize,
    /// Capacity in individuals of these states.
    pub individuals: usize,
    /// What happens to a state beyond the capacity.
    pub overflow: Overflow,
}

/// What happens to a state for which a queue has no room.
pub enum Overflow {
    /// The oldest states are dropped for it.
    DropOldest,
    DropNewest,
    /// The swarm takes no step while the queue is full; the callback wakes its thread.
    Block(Box<dyn Fn() + Send + Sync>),
}

pub enum Item {
    /// A state, when it was enqueued, and what the subscription had passed by then.
    Frame(Arc<Frame>, SystemTime, Passed),
    /// An event and when it was enqueued.
    Event(Box<Event>, SystemTime),
}

/// What a subscription has passed, up to a state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Passed {
    /// Epoch and step of the state, enqueued or not.
    pub at: (u64, u64),
    /// The number of dropped states.
    pub dropped: u64,
    /// The steps that the swarm has taken since the first state.
    pub steps: u64,
}

#[derive(Clone)]
pub enum End {
    Deleted,
    /// The swarm has taken the number of steps in the limits.
    Complete,
    /// [`Subscription::end`] was called with this reason.
    Closed(Option<String>),
}

/// The publisher of a swarm, as the thread of the swarm calls it.
pub trait Publish: Send + Sync {
    /// The queue of the publisher was empty and no longer is.
    fn notify(&self);

    /// Whether a frame would have a reader. For a moving swarm the answer may lag, since a new reader
    /// gets the next frame.
    fn is_watched(&self, is_moving: bool) -> bool;
}

pub struct Output {
    pub name: String,
    /// The subscription of the publisher. It exists before the publisher opens the swarm, so that no
    /// event is missing.
    pub to_publish: Subscription,
    publisher: OnceLock<Weak<dyn Publish>>,
    published: AtomicU64,
    subscriptions: Mutex<Vec<Weak<Subscription>>>,
    /// False only if there are no subscriptions: a step without one takes no lock.
    is_subscribed: AtomicBool,
}

impl Output {
    pub fn new(name: String) -> Self {
        Output {
            name,
            to_publish: Subscription::new(Limits {
                every: 1,
                steps: None,
                frames: usize::MAX,
                individuals: MAX_PUBLISHED_INDIVIDUALS,
                overflow: Overflow::DropOldest,
            }),
            publisher: OnceLock::new(),
            published: AtomicU64::new(0),
            subscriptions: Mutex::default(),
            is_subscribed: AtomicBool::new(false),
        }
    }

    /// Sets the publisher, and notifies it of what was queued before.
    pub fn set_publisher<P: Publish + 'static>(&self, publisher: &Arc<P>) {
        let weak: Weak<P> = Arc::downgrade(publisher);
        let _ = self.publisher.set(weak);
        publisher.notify();
    }

    /// Subscribes to every later state and event, until the subscription is dropped.
    pub fn subscribe(&self, limits: Limits) -> Arc<Subscription> {
        let subscription = Arc::new(Subscription::new(limits));
        let weak = Arc::downgrade(&subscription);
        self.subscriptions.lock().push(weak);
        self.is_subscribed.store(true, Ordering::Release);
        subscription
    }

    /// Passes the state at an epoch and step to the subscriptions other than the publisher's. Only for
    /// the thread of the swarm.
    pub fn push_state(&self, at: (u64, u64), frame: impl FnOnce() -> Arc<Frame>) {
        let frame = LazyCell::new(frame);
        for subscription in self.subscriptions() {
            subscription.push_state(at, || Arc::clone(&frame));
        }
    }

    /// Whether every subscription has room for another state. If not, the thread of the swarm is woken
    /// once it has.
    pub fn has_room(&self) -> bool {
        // No short-circuit: each full subscription must know that the thread waits.
        let mut has_room = true;
        for subscription in self.subscriptions() {
            has_room &= subscription.has_room();
        }
        has_room
    }

    /// Queues a frame for the publisher if it has a reader. Only for the thread of the swarm.
    pub fn push_frame(&self, is_moving: bool, frame: impl FnOnce() -> Arc<Frame>) {
        if let Some(publisher) = self.publisher()
            && publisher.is_watched(is_moving)
        {
            let (frame, queue) = (frame(), &self.to_publish);
            if queue.put_frame(&mut queue.contents.lock(), || frame) {
                publisher.notify();
            }
        }
    }

    pub fn push_event(&self, event: &Event) {
        for subscription in self.subscriptions() {
            subscription.push_event(event);
        }
        if self.to_publish.push_event(event)
            && let Some(publisher) = self.publisher()
        {
            publisher.notify();
        }
    }

    pub fn published(&self) -> u64 {
        self.published.load(Ordering::Relaxed)
    }

    /// Counts a published state, and returns its number.
    pub fn count_published(&self) -> u64 {
        self.published.fetch_add(1, Ordering::Relaxed) + 1
    }

    fn publisher(&self) -> Option<Arc<dyn Publish>> {
        self.publisher.get()?.upgrade()
    }

    /// The subscriptions that still exist, other than the publisher's.
    fn subscriptions(&self) -> Vec<Arc<Subscription>> {
        if !self.is_subscribed.load(Ordering::Acquire) {
            return Vec::new();
        }
        let mut subscriptions = self.subscriptions.lock();
        subscriptions.retain(|it| it.strong_count() > 0);
        self.is_subscribed
            .store(!subscriptions.is_empty(), Ordering::Release);
        subscriptions.iter().filter_map(Weak::upgrade).collect()
    }
}

/// A bounded queue of the states and events of a swarm, with one reader.
pub struct Subscription {
    limits: Limits,
    /// No change of the contents panics halfway.
    contents: Mutex<Contents>,
    changed: Condvar,
}

#[derive(Default)]
struct Contents {
    waiting: VecDeque<Item>,
    /// The frames among them, and their individuals.
    frames: usize,
    individuals: usize,
    /// States that were enqueued or dropped.
    states: u64,
    /// Whether there was a state, and what was passed up to the last one.
    has_begun: bool,
    passed: Passed,
    /// The steps after which the subscription ends.
    max_steps: Option<u64>,
    is_reader_waiting: bool,
    is_swarm_waiting: bool,
    end: Option<End>,
}

impl Contents {
    fn is_full(&self, limits: &Limits, times: usize) -> bool {
        self.frames >= times.saturating_mul(limits.frames)
            || self.individuals >= times * limits.individuals
    }

    fn remove(&mut self, index: usize) -> Option<Item> {
        let item = self.waiting.remove(index)?;
        if let Item::Frame(frame, ..) = &item {
            self.frames -= 1;
            self.individuals -= frame.configuration.n();
        }
        Some(item)
    }

    fn remove_oldest(&mut self, is_kind: fn(&Item) -> bool) {
        let oldest = self.waiting.iter().position(is_kind);
        oldest.and_then(|index| self.remove(index));
    }
}

impl Subscription {
    fn new(limits: Limits) -> Self {
        let contents = Contents {
            max_steps: limits.steps,
            ..Contents::default()
        };
        Subscription {
            limits,
            contents: Mutex::new(contents),
            changed: Condvar::new(),
        }
    }

    /// Waits for the next item, at most until `until`. Returns [`End`] once the queue is empty and the
    /// subscription has ended.
    pub fn next(&self, until: Option<Instant>) -> Result<Option<Item>, End> {
        let mut contents = self.contents.lock();
        loop {
            if let Some(item) = contents.remove(0) {
                // Half empty, so that the swarm is not woken for every single step.
                let is_half_empty = 2 * contents.frames <= self.limits.frames;
                if is_half_empty && !contents.is_full(&self.limits, 1) {
                    self.unblock(contents);
                }
                return Ok(Some(item));
            }
            if let Some(end) = &contents.end {
                return Err(end.clone());
            }
            // `wait_for` with the longest duration has no timeout.
            let left = until.map_or(Duration::MAX, |until| {
                until.saturating_duration_since(Instant::now())
            });
            if left.is_zero() {
                return Ok(None);
            }
            contents.is_reader_waiting = true;
            self.changed.wait_for(&mut contents, left);
        }
    }

    pub fn take(&self) -> (VecDeque<Arc<Frame>>, Vec<Event>) {
        let waiting = {
            let mut contents = self.contents.lock();
            (contents.frames, contents.individuals) = (0, 0);
            std::mem::take(&mut contents.waiting)
        };
        let (mut frames, mut events) = (VecDeque::new(), Vec::new());
        for item in waiting {
            match item {
                Item::Frame(frame, ..) => frames.push_back(frame),
                Item::Event(event, _) => events.push(*event),
            }
        }
        (frames, events)
    }

    /// Ends the subscription unless it has ended: later states are ignored and the swarm does not wait.
    /// The reader still receives what is in the queue.
    pub fn end(&self, reason: Option<String>) {
        let mut contents = self.contents.lock();
        contents.end.get_or_insert(End::Closed(reason));
        self.notify_reader(&mut contents);
        self.unblock(contents);
    }

    /// The number of states that were enqueued or dropped, and of those that were dropped.
    pub fn frames(&self) -> (u64, u64) {
        let contents = self.contents.lock();
        (contents.states, contents.passed.dropped)
    }

    /// What it has passed, up to the last state; nothing before the first.
    pub fn passed(&self) -> Passed {
        self.contents.lock().passed
    }

    pub fn count_dropped(&self, count: u64) {
        self.contents.lock().passed.dropped += count;
    }

    /// The remaining steps, if their number is limited.
    pub fn steps_left(&self) -> Option<u64> {
        let contents = self.contents.lock();
        let steps = contents.passed.steps;
        contents.max_steps.map(|all| all.saturating_sub(steps))
    }

    /// Ends the subscription after this number of steps since its first state. The queue may contain
    /// later states, if the swarm has taken more.
    pub fn limit_steps(&self, steps: u64) {
        let mut contents = self.contents.lock();
        contents.max_steps = Some(steps);
        self.end_if_complete(&mut contents);
        self.unblock(contents);
    }

    /// The swarm has reached this epoch and step. Only for the thread of the swarm.
    pub fn push_state(&self, at: (u64, u64), frame: impl FnOnce() -> Arc<Frame>) {
        let mut contents = self.contents.lock();
        let has_begun = std::mem::replace(&mut contents.has_begun, true);
        let (epoch, step) = contents.passed.at;
        if contents.end.is_some() || (has_begun && contents.passed.at == at) {
            return;
        }
        if has_begun && epoch == at.0 {
            contents.passed.steps += at.1.saturating_sub(step);
        }
        contents.passed.at = at;
        if at.1.is_multiple_of(self.limits.every) {
            self.put_frame(&mut contents, frame);
        }
        self.end_if_complete(&mut contents);
    }

    fn end_if_complete(&self, contents: &mut Contents) {
        let steps = contents.passed.steps;
        if contents.max_steps.is_some_and(|all| steps >= all) {
            contents.end.get_or_insert(End::Complete);
            self.notify_reader(contents);
        }
    }

    /// Enqueues an event. Returns whether the queue was empty.
    fn push_event(&self, event: &Event) -> bool {
        let mut contents = self.contents.lock();
        if contents.end.is_some() {
            return false;
        }
        let was_empty = contents.waiting.is_empty();
        let is_full = contents.waiting.len() - contents.frames == MAX_EVENTS;
        let drops_oldest = matches!(self.limits.overflow, Overflow::DropOldest);
        if is_full && drops_oldest {
            contents.remove_oldest(|it| matches!(it, Item::Event(..)));
        }
        if !is_full || drops_oldest {
            let item = Item::Event(Box::new(event.clone()), SystemTime::now());
            contents.waiting.push_back(item);
        }
        if matches!(event.kind, EventKind::Deleted(_)) {
            contents.end = Some(End::Deleted);
        }
        self.notify_reader(&mut contents);
        was_empty
    }

    /// Enqueues or drops a frame. Returns whether the queue was empty.
    fn put_frame(&self, contents: &mut Contents, frame: impl FnOnce() -> Arc<Frame>) -> bool {
        let (limits, was_empty) = (&self.limits, contents.waiting.is_empty());
        contents.states += 1;
        let is_dropped = match limits.overflow {
            Overflow::DropOldest => false,
            Overflow::DropNewest => contents.is_full(limits, 1),
            Overflow::Block(_) => contents.is_full(limits, MAX_OVERFULL),
        };
        if is_dropped {
            contents.passed.dropped += 1;
            return was_empty;
        }
        let frame = frame();
        contents.frames += 1;
        contents.individuals += frame.configuration.n();
        let item = Item::Frame(frame, SystemTime::now(), contents.passed);
        contents.waiting.push_back(item);
        while matches!(limits.overflow, Overflow::DropOldest)
            && contents.individuals > limits.individuals
            && contents.frames > 1
        {
            contents.remove_oldest(|it| matches!(it, Item::Frame(..)));
            contents.passed.dropped += 1;
        }
        self.notify_reader(contents);
        was_empty
    }

    /// Whether the swarm may take another step.
    fn has_room(&self) -> bool {
        let mut contents = self.contents.lock();
        let may_block = matches!(self.limits.overflow, Overflow::Block(_));
        let is_full = contents.is_full(&self.limits, 1);
        let has_room = !may_block || contents.end.is_some() || !is_full;
        contents.is_swarm_waiting |= !has_room;
        has_room
    }

    fn notify_reader(&self, contents: &mut Contents) {
        if std::mem::take(&mut contents.is_reader_waiting) {
            self.changed.notify_one();
        }
    }

    /// Wakes the thread of the swarm if it waits for this queue.
    fn unblock(&self, mut contents: MutexGuard<'_, Contents>) {
        let is_waiting = std::mem::take(&mut contents.is_swarm_waiting);
        drop(contents);
        if let Overflow::Block(wake) = &self.limits.overflow
            && is_waiting
        {
            wake();
        }
    }
}

impl Drop for Subscription {
    /// Wakes a swarm that waits for a queue which no longer has a reader.
    fn drop(&mut self) {
        if let Overflow::Block(wake) = &self.limits.overflow
            && self.contents.get_mut().is_swarm_waiting
        {
            wake();
        }
    }
}

#[cfg(test)]
mod tests;
