//! What became of a swarm, as its and its node's liveliness tokens tell; a pure state machine.

use std::time::Duration;

use tokio::time::Instant;

/// How long after a swarm's token its node's token may fall, if the whole node goes.
const FALL: Duration = Duration::from_secs(1);
/// How long after a node's token its swarms' tokens may rise.
pub const RISE: Duration = Duration::from_secs(3);

/// Where a swarm is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Whereabouts {
    /// Its token stands.
    Here,
    /// Its token fell; whether its node's falls too is to be seen by then.
    Missing {
        /// By when.
        until: Instant,
    },
    /// Its node is away too.
    Away,
    /// Its node is back; whether it is there too is to be seen by then.
    Due {
        /// By when.
        until: Instant,
    },
}

/// What is worth telling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum News {
    /// The node went away, and the swarm with it.
    Gone,
    /// It is there again.
    Back,
    /// The node is there, the swarm is not.
    Deleted,
    /// The node came back, the swarm did not.
    LeftBehind,
}

impl Whereabouts {
    /// The swarm's token rose or fell.
    pub fn swarm_token(&mut self, is_alive: bool, now: Instant) -> Option<News> {
        match (*self, is_alive) {
            (Whereabouts::Here, false) => {
                *self = Whereabouts::Missing { until: now + FALL };
                None
            }
            (Whereabouts::Missing { .. }, true) => {
                *self = Whereabouts::Here;
                None
            }
            (Whereabouts::Away | Whereabouts::Due { .. }, true) => {
                *self = Whereabouts::Here;
                Some(News::Back)
            }
            _ => None,
        }
    }

    /// Its node's token rose or fell.
    pub fn node_token(&mut self, is_alive: bool, now: Instant) {
        match (*self, is_alive) {
            // Nothing more will come; the judgement need not wait.
            (Whereabouts::Missing { .. }, false) => *self = Whereabouts::Missing { until: now },
            (Whereabouts::Away, true) => *self = Whereabouts::Due { until: now + RISE },
            (Whereabouts::Due { .. }, false) => *self = Whereabouts::Away,
            _ => {}
        }
    }

    /// When to [`judge`](Self::judge), unless a token says more before.
    pub fn deadline(&self) -> Option<Instant> {
        match self {
            Whereabouts::Missing { until } | Whereabouts::Due { until } => Some(*until),
            Whereabouts::Here | Whereabouts::Away => None,
        }
    }

    /// The time is over: what became of it?
    pub fn judge(&mut self, is_node_there: bool) -> Option<News> {
        match (*self, is_node_there) {
            (Whereabouts::Missing { .. }, true) => Some(News::Deleted),
            (Whereabouts::Missing { .. }, false) => {
                *self = Whereabouts::Away;
                Some(News::Gone)
            }
            (Whereabouts::Due { .. }, true) => Some(News::LeftBehind),
            (Whereabouts::Due { .. }, false) => {
                *self = Whereabouts::Away;
                None
            }
            (Whereabouts::Here | Whereabouts::Away, _) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swarm_whose_node_stands_was_deleted() {
        let mut swarm = Whereabouts::Here;
        assert_eq!(swarm.swarm_token(false, Instant::now()), None);
        assert_eq!(swarm.judge(true), Some(News::Deleted));
    }

    #[test]
    fn a_swarm_that_goes_with_its_node_comes_back_with_it() {
        let now = Instant::now();
        let mut swarm = Whereabouts::Here;
        assert_eq!(swarm.swarm_token(false, now), None);
        swarm.node_token(false, now);
        assert_eq!(swarm.deadline(), Some(now), "there is nothing to wait for");
        assert_eq!(swarm.judge(false), Some(News::Gone));
        assert_eq!(swarm.deadline(), None, "it is waited for without an end");
        swarm.node_token(true, now);
        assert_eq!(swarm.deadline(), Some(now + RISE));
        assert_eq!(swarm.swarm_token(true, now), Some(News::Back));
        assert_eq!(swarm, Whereabouts::Here);
    }

    #[test]
    fn a_node_may_come_back_without_the_swarm() {
        let now = Instant::now();
        let mut swarm = Whereabouts::Away;
        swarm.node_token(true, now);
        assert_eq!(swarm.judge(true), Some(News::LeftBehind));
    }

    #[test]
    fn a_token_that_only_flickers_is_no_news() {
        let now = Instant::now();
        let mut swarm = Whereabouts::Here;
        assert_eq!(swarm.swarm_token(true, now), None, "history");
        assert_eq!(swarm.swarm_token(false, now), None);
        assert_eq!(swarm.swarm_token(true, now), None);
        assert_eq!(swarm.deadline(), None);
    }
}
