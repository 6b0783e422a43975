//! Whether a swarm is reachable, from its and its daemon's liveliness tokens: a pure state machine.

use std::time::Duration;

use tokio::time::Instant;

/// How long after a swarm's token its daemon's token may disappear, if the daemon ends.
const DAEMON_TOKEN_TIMEOUT: Duration = Duration::from_secs(1);
/// How long after a daemon's token the tokens of its swarms may appear.
const SWARM_TOKEN_TIMEOUT: Duration = Duration::from_secs(3);

/// Whether a swarm and its daemon are reachable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Presence {
    /// Its token is declared.
    Present,
    /// Its token disappeared; its daemon's may do so too, until then.
    Missing { until: Instant },
    /// Its daemon's token disappeared too.
    Away,
    /// Its daemon is back; its own token may appear until then.
    Expected { until: Instant },
}

/// A change that followers are notified of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Change {
    /// The daemon became unreachable, and the swarm with it.
    Away,
    /// Both are reachable again.
    Back,
    /// The daemon is reachable, the swarm is not.
    Deleted,
    /// The daemon came back, the swarm did not.
    NotRecovered,
}

impl Presence {
    /// The swarm's token appeared or disappeared.
    pub fn swarm_token(&mut self, is_alive: bool, now: Instant) -> Option<Change> {
        match (*self, is_alive) {
            (Presence::Present, false) => {
                *self = Presence::Missing {
                    until: now + DAEMON_TOKEN_TIMEOUT,
                };
                None
            }
            (Presence::Missing { .. }, true) => {
                *self = Presence::Present;
                None
            }
            (Presence::Away | Presence::Expected { .. }, true) => {
                *self = Presence::Present;
                Some(Change::Back)
            }
            _ => None,
        }
    }

    /// Its daemon's token appeared or disappeared.
    pub fn node_token(&mut self, is_alive: bool, now: Instant) {
        match (*self, is_alive) {
            // No further token can change the verdict.
            (Presence::Missing { .. }, false) => *self = Presence::Missing { until: now },
            (Presence::Away, true) => {
                *self = Presence::Expected {
                    until: now + SWARM_TOKEN_TIMEOUT,
                }
            }
            (Presence::Expected { .. }, false) => *self = Presence::Away,
            _ => {}
        }
    }

    /// Whether its daemon became unreachable, and its own token has not appeared since.
    pub fn is_away(&self) -> bool {
        matches!(self, Presence::Away | Presence::Expected { .. })
    }

    /// When to call [`judge`](Self::judge), unless a token changes the state earlier.
    pub fn deadline(&self) -> Option<Instant> {
        match self {
            Presence::Missing { until } | Presence::Expected { until } => Some(*until),
            Presence::Present | Presence::Away => None,
        }
    }

    /// Returns the change of the swarm after the deadline has passed.
    pub fn judge(&mut self, is_node_there: bool) -> Option<Change> {
        match (*self, is_node_there) {
            (Presence::Missing { .. }, true) => Some(Change::Deleted),
            (Presence::Missing { .. }, false) => {
                *self = Presence::Away;
                Some(Change::Away)
            }
            (Presence::Expected { .. }, true) => Some(Change::NotRecovered),
            (Presence::Expected { .. }, false) => {
                *self = Presence::Away;
                None
            }
            (Presence::Present | Presence::Away, _) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swarm_whose_daemon_stays_was_deleted() {
        let mut swarm = Presence::Present;
        assert_eq!(swarm.swarm_token(false, Instant::now()), None);
        assert_eq!(swarm.judge(true), Some(Change::Deleted));
    }

    #[test]
    fn a_swarm_that_disappears_with_its_daemon_comes_back_with_it() {
        let now = Instant::now();
        let mut swarm = Presence::Present;
        assert_eq!(swarm.swarm_token(false, now), None);
        swarm.node_token(false, now);
        assert_eq!(
            swarm.deadline(),
            Some(now),
            "no further token can change the verdict"
        );
        assert_eq!(swarm.judge(false), Some(Change::Away));
        assert_eq!(
            swarm.deadline(),
            None,
            "there is no timeout while it is away"
        );
        swarm.node_token(true, now);
        assert_eq!(swarm.deadline(), Some(now + SWARM_TOKEN_TIMEOUT));
        assert_eq!(swarm.swarm_token(true, now), Some(Change::Back));
        assert_eq!(swarm, Presence::Present);
    }

    #[test]
    fn a_daemon_may_come_back_without_the_swarm() {
        let now = Instant::now();
        let mut swarm = Presence::Away;
        swarm.node_token(true, now);
        assert_eq!(swarm.judge(true), Some(Change::NotRecovered));
    }

    #[test]
    fn a_token_that_reappears_at_once_is_no_change() {
        let now = Instant::now();
        let mut swarm = Presence::Present;
        assert_eq!(swarm.swarm_token(true, now), None, "history");
        assert_eq!(swarm.swarm_token(false, now), None);
        assert_eq!(swarm.swarm_token(true, now), None);
        assert_eq!(swarm.deadline(), None);
    }
}
