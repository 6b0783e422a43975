//! Whose turn it is to be published.

use std::collections::{BTreeSet, HashMap};
use std::time::{Duration, Instant};

/// How many times as long as publishing took a swarm's next frames are gathered. Who publishes often
/// to many has the bus send several at once, which costs everybody less, and whoever commands
/// meanwhile does not wait for those that follow.
const TIMES_GATHERED: u32 = 8;

/// How long frames are gathered at most.
pub const MOST_GATHERED: Duration = Duration::from_millis(4);

/// When each swarm may be published again, and who has rung before.
#[derive(Default)]
pub struct Turns {
    due: HashMap<String, Instant>,
    waiting: BTreeSet<(Instant, String)>,
}

impl Turns {
    /// The swarm that has rung, if it is its turn. If not it waits, once however often it rings.
    pub fn ring(&mut self, swarm: String, now: Instant) -> Option<String> {
        let Some(&at) = self.due.get(&swarm) else {
            return Some(swarm);
        };
        let turn = (at, swarm);
        if at > now {
            self.waiting.insert(turn);
            return None;
        }
        self.waiting.remove(&turn);
        Some(turn.1)
    }

    /// How long until it is the turn of somebody who waits: no time where it has come.
    pub fn until_next(&self, now: Instant) -> Option<Duration> {
        let (at, _) = self.waiting.first()?;
        Some(at.saturating_duration_since(now))
    }

    /// Whoever waits and is next, whether or not their turn has come.
    pub fn next(&mut self) -> Option<String> {
        self.waiting.pop_first().map(|(_, swarm)| swarm)
    }

    /// A swarm was published, from `began` until now.
    pub fn published(&mut self, swarm: String, began: Instant, now: Instant) {
        let gathered = ((now - began) * TIMES_GATHERED).min(MOST_GATHERED);
        self.due.insert(swarm, began + gathered);
    }

    /// Forgets a swarm that is no longer published.
    pub fn forget(&mut self, swarm: &str) {
        if let Some((swarm, at)) = self.due.remove_entry(swarm) {
            self.waiting.remove(&(at, swarm));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MICROSECOND: Duration = Duration::from_micros(1);

    fn ring(turns: &mut Turns, swarm: &str, now: Instant) -> bool {
        turns.ring(swarm.to_owned(), now).is_some()
    }

    fn publish(turns: &mut Turns, swarm: &str, began: Instant, took: Duration) {
        turns.published(swarm.to_owned(), began, began + took);
    }

    #[test]
    fn what_follows_is_gathered_for_eight_times_what_publishing_took() {
        let (mut turns, began) = (Turns::default(), Instant::now());
        assert!(ring(&mut turns, "a", began));
        publish(&mut turns, "a", began, 10 * MICROSECOND);
        for early in [10, 40, 79] {
            assert!(!ring(&mut turns, "a", began + early * MICROSECOND));
        }
        let now = began + 30 * MICROSECOND;
        assert_eq!(turns.until_next(now), Some(50 * MICROSECOND));
        assert!(ring(&mut turns, "b", now), "others are held up");
        // It waits once, and no longer than until its turn.
        assert_eq!(turns.next().as_deref(), Some("a"));
        assert_eq!(turns.next(), None);
        assert!(ring(&mut turns, "a", began + 80 * MICROSECOND));
    }

    #[test]
    fn nothing_is_gathered_for_more_than_four_milliseconds() {
        let (mut turns, began) = (Turns::default(), Instant::now());
        let four = Duration::from_millis(4);
        publish(&mut turns, "a", began, four - MICROSECOND);
        assert!(!ring(&mut turns, "a", began + four - MICROSECOND));
        assert_eq!(turns.until_next(began), Some(four));
        // What took as long as that has its next turn at once.
        publish(&mut turns, "b", began, Duration::from_secs(3));
        assert!(ring(&mut turns, "b", began + Duration::from_secs(3)));
    }

    #[test]
    fn who_waits_has_their_turn_in_its_order_and_none_is_left_out() {
        let (mut turns, began) = (Turns::default(), Instant::now());
        assert_eq!(turns.until_next(began), None);
        for (swarm, took) in [("a", 90), ("b", 30), ("c", 60)] {
            publish(&mut turns, swarm, began, took * MICROSECOND);
            assert!(!ring(&mut turns, swarm, began + 100 * MICROSECOND));
        }
        let late = began + Duration::from_secs(1);
        assert_eq!(turns.until_next(late), Some(Duration::ZERO));
        // Who rings when their turn has come has had it, and does not wait for it too.
        assert!(ring(&mut turns, "c", late));
        let order: Vec<_> = std::iter::from_fn(|| turns.next()).collect();
        assert_eq!(order, ["b", "a"]);
    }

    #[test]
    fn who_is_forgotten_waits_no_longer_and_begins_anew() {
        let (mut turns, began) = (Turns::default(), Instant::now());
        publish(&mut turns, "a", began, 100 * MICROSECOND);
        assert!(!ring(&mut turns, "a", began + 200 * MICROSECOND));
        turns.forget("a");
        turns.forget("never seen");
        assert_eq!(turns.next(), None);
        assert!(ring(&mut turns, "a", began + 200 * MICROSECOND));
    }
}
