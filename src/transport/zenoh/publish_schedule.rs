//! Decides when the publisher thread publishes each swarm.
//!
//! A notification of a swarm that was published a moment ago is delayed, so that the frames in
//! between leave in one batch. Batching lowers the cost per subscriber and keeps the latency of
//! commands low: zenoh sends several messages in one write.

use std::collections::{BTreeSet, HashMap};
use std::time::{Duration, Instant};

/// The batching window of a swarm, as a multiple of the time that publishing it took: publishing then
/// takes at most an eighth of the thread's time per swarm.
const BATCH_FACTOR: u32 = 8;

/// The longest batching window.
pub const MAX_BATCH_WINDOW: Duration = Duration::from_millis(4);

/// When each swarm may be published again, and the swarms whose notification is delayed.
#[derive(Default)]
pub struct PublishScheduler {
    due: HashMap<String, Instant>,
    delayed: BTreeSet<(Instant, String)>,
}

impl PublishScheduler {
    /// Returns the swarm if it may be published now; otherwise delays it. Further notifications of a
    /// delayed swarm have no effect.
    pub fn notify(&mut self, swarm: String, now: Instant) -> Option<String> {
        let Some(&at) = self.due.get(&swarm) else {
            return Some(swarm);
        };
        let entry = (at, swarm);
        if at > now {
            self.delayed.insert(entry);
            return None;
        }
        self.delayed.remove(&entry);
        Some(entry.1)
    }

    /// The time until the first delayed swarm is due; zero if it is overdue.
    pub fn until_next(&self, now: Instant) -> Option<Duration> {
        let (at, _) = self.delayed.first()?;
        Some(at.saturating_duration_since(now))
    }

    /// Removes and returns the delayed swarm that is due first, whether or not it is due yet.
    pub fn pop(&mut self) -> Option<String> {
        self.delayed.pop_first().map(|(_, swarm)| swarm)
    }

    /// Records that a swarm was published from `began` until `now`, and opens its batching window.
    pub fn published(&mut self, swarm: String, began: Instant, now: Instant) {
        let window = ((now - began) * BATCH_FACTOR).min(MAX_BATCH_WINDOW);
        self.due.insert(swarm, began + window);
    }

    /// Removes a swarm that is no longer published.
    pub fn remove(&mut self, swarm: &str) {
        if let Some((swarm, at)) = self.due.remove_entry(swarm) {
            self.delayed.remove(&(at, swarm));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MICROSECOND: Duration = Duration::from_micros(1);

    fn notify(scheduler: &mut PublishScheduler, swarm: &str, now: Instant) -> bool {
        scheduler.notify(swarm.to_owned(), now).is_some()
    }

    fn publish(scheduler: &mut PublishScheduler, swarm: &str, began: Instant, took: Duration) {
        scheduler.published(swarm.to_owned(), began, began + took);
    }

    #[test]
    fn the_batching_window_is_eight_times_as_long_as_publishing() {
        let (mut scheduler, began) = (PublishScheduler::default(), Instant::now());
        assert!(notify(&mut scheduler, "a", began));
        publish(&mut scheduler, "a", began, 10 * MICROSECOND);
        for early in [10, 40, 79] {
            assert!(!notify(&mut scheduler, "a", began + early * MICROSECOND));
        }
        let now = began + 30 * MICROSECOND;
        assert_eq!(scheduler.until_next(now), Some(50 * MICROSECOND));
        assert!(
            notify(&mut scheduler, "b", now),
            "another swarm is not delayed"
        );
        // The swarm is delayed once, and not beyond its window.
        assert_eq!(scheduler.pop().as_deref(), Some("a"));
        assert_eq!(scheduler.pop(), None);
        assert!(notify(&mut scheduler, "a", began + 80 * MICROSECOND));
    }

    #[test]
    fn the_batching_window_is_at_most_four_milliseconds() {
        let (mut scheduler, began) = (PublishScheduler::default(), Instant::now());
        let four = Duration::from_millis(4);
        publish(&mut scheduler, "a", began, four - MICROSECOND);
        assert!(!notify(&mut scheduler, "a", began + four - MICROSECOND));
        assert_eq!(scheduler.until_next(began), Some(four));
        // A swarm whose publishing took longer than the window may be published again at once.
        publish(&mut scheduler, "b", began, Duration::from_secs(3));
        assert!(notify(&mut scheduler, "b", began + Duration::from_secs(3)));
    }

    #[test]
    fn delayed_swarms_are_due_in_order_and_none_is_lost() {
        let (mut scheduler, began) = (PublishScheduler::default(), Instant::now());
        assert_eq!(scheduler.until_next(began), None);
        for (swarm, took) in [("a", 90), ("b", 30), ("c", 60)] {
            publish(&mut scheduler, swarm, began, took * MICROSECOND);
            assert!(!notify(&mut scheduler, swarm, began + 100 * MICROSECOND));
        }
        let late = began + Duration::from_secs(1);
        assert_eq!(scheduler.until_next(late), Some(Duration::ZERO));
        // A notification after the window publishes at once and cancels the delayed one.
        assert!(notify(&mut scheduler, "c", late));
        let order: Vec<_> = std::iter::from_fn(|| scheduler.pop()).collect();
        assert_eq!(order, ["b", "a"]);
    }

    #[test]
    fn a_removed_swarm_is_neither_delayed_nor_kept() {
        let (mut scheduler, began) = (PublishScheduler::default(), Instant::now());
        publish(&mut scheduler, "a", began, 100 * MICROSECOND);
        assert!(!notify(&mut scheduler, "a", began + 200 * MICROSECOND));
        scheduler.remove("a");
        scheduler.remove("never seen");
        assert_eq!(scheduler.pop(), None);
        assert!(notify(&mut scheduler, "a", began + 200 * MICROSECOND));
    }
}
