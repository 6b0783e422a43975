//! When to retry a request: a function of the error and of the time.

use std::hash::BuildHasher;
use std::time::{Duration, Instant};

use jostle_proto::ErrorCode;

use crate::error::Error;

/// The delay before the first retry; it doubles with each further one.
const MIN_DELAY: Duration = Duration::from_millis(50);
/// The longest delay.
const MAX_DELAY: Duration = Duration::from_secs(1);
/// The number of retries after errors that may mean "does not exist" or "not permitted" as well
/// as a lost request.
const MAX_SILENT_RETRIES: u32 = 2;

/// The retries of one request.
pub(crate) struct RetryPolicy {
    deadline: Instant,
    is_command: bool,
    retries: u32,
    silent: u32,
    was_interrupted: bool,
}

impl RetryPolicy {
    /// Retries until `deadline`. After a lost connection only a command is retried, because it may
    /// have been executed; the error of a query is returned at once.
    pub fn new(deadline: Instant, is_command: bool) -> Self {
        RetryPolicy {
            deadline,
            is_command,
            retries: 0,
            silent: 0,
            was_interrupted: false,
        }
    }

    /// The delay before the next retry; `None` if a retry cannot help or would exceed the deadline.
    /// `is_interrupted` is whether a connection was lost since the first attempt.
    pub fn delay(&mut self, error: &Error, is_interrupted: bool, now: Instant) -> Option<Duration> {
        self.was_interrupted |= is_interrupted && self.is_command;
        let may_help = match error {
            // The daemon holds a request for an hour at most.
            Error::Rejected(error) => {
                matches!(error.code, ErrorCode::Busy | ErrorCode::DeadlineExceeded)
            }
            // The connection existed, or the session would not have opened.
            Error::NoDaemon { .. } => self.is_command,
            Error::Silent { .. } => self.is_silence_short(),
            // After a lost connection tokens are declared again with a delay, and the loss is
            // noticed after the missing reply.
            Error::NoNode { .. } | Error::NoSwarm { .. } | Error::UnknownNode { .. } => {
                self.is_command && self.is_silence_short()
            }
            _ => false,
        };
        let delay = MIN_DELAY
            .saturating_mul(1 << self.retries.min(8))
            .min(MAX_DELAY)
            .mul_f64(0.5 + random_share());
        self.retries += 1;
        (may_help && now + delay < self.deadline).then_some(delay)
    }

    /// Whether a missing reply may still be due to a lost connection.
    fn is_silence_short(&mut self) -> bool {
        self.silent += 1;
        self.was_interrupted || self.silent <= MAX_SILENT_RETRIES
    }
}

/// A random number from 0 to 1, so that clients do not retry at the same moment.
fn random_share() -> f64 {
    let bits = std::hash::RandomState::new().hash_one(0);
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rejected(code: ErrorCode) -> Error {
        Error::rejected(jostle_proto::Error {
            code,
            message: String::new(),
            details: serde_json::Map::new(),
            step: None,
        })
    }

    fn no_daemon() -> Error {
        Error::NoDaemon {
            endpoint: String::new(),
            cause: String::new(),
        }
    }

    fn no_swarm() -> Error {
        Error::NoSwarm {
            swarm: "demo".into(),
            there: Vec::new(),
        }
    }

    #[test]
    fn busy_is_retried_until_the_deadline() {
        let (mut now, mut delays) = (Instant::now(), 0);
        let mut policy = RetryPolicy::new(now + Duration::from_secs(5), true);
        while let Some(delay) = policy.delay(&rejected(ErrorCode::Busy), false, now) {
            assert!(delay >= MIN_DELAY / 2 && delay <= MAX_DELAY * 3 / 2);
            now += delay;
            delays += 1;
        }
        assert!((5..20).contains(&delays), "{delays}");
    }

    #[test]
    fn a_permanent_error_is_not_retried() {
        let now = Instant::now();
        let mut policy = RetryPolicy::new(now + Duration::from_secs(5), true);
        for code in [
            ErrorCode::Conflict,
            ErrorCode::NotFound,
            ErrorCode::Internal,
        ] {
            assert_eq!(policy.delay(&rejected(code), false, now), None, "{code:?}");
        }
    }

    #[test]
    fn a_command_is_retried_after_a_lost_connection_until_tokens_are_declared_again() {
        let now = Instant::now();
        let mut policy = RetryPolicy::new(now + Duration::from_secs(5), true);
        assert!(policy.delay(&no_daemon(), true, now).is_some());
        assert!(policy.delay(&no_swarm(), true, now).is_some());
        // The lost connection counts for all further retries.
        for _ in 0..=MAX_SILENT_RETRIES {
            assert!(policy.delay(&no_swarm(), false, now).is_some());
        }
        let late = now + Duration::from_secs(5);
        assert!(policy.delay(&no_daemon(), true, late).is_none());
    }

    #[test]
    fn a_query_is_not_retried_after_a_lost_connection() {
        let now = Instant::now();
        let mut policy = RetryPolicy::new(now + Duration::from_secs(5), false);
        assert_eq!(policy.delay(&no_daemon(), true, now), None);
        assert_eq!(policy.delay(&no_swarm(), true, now), None);
        assert!(
            policy
                .delay(&rejected(ErrorCode::Busy), false, now)
                .is_some()
        );
    }

    #[test]
    fn a_missing_reply_is_retried_twice() {
        let now = Instant::now();
        let target = "demo".to_owned();
        for error in [Error::Silent { target }, no_swarm()] {
            let mut policy = RetryPolicy::new(now + Duration::from_secs(5), true);
            let mut delay = || policy.delay(&error, false, now);
            assert!(delay().is_some() && delay().is_some());
            assert_eq!(delay(), None);
        }
    }

    #[test]
    fn delays_are_random() {
        let (first, second) = (random_share(), random_share());
        assert!((0.0..1.0).contains(&first) && (0.0..1.0).contains(&second));
        assert_ne!(first.to_bits(), second.to_bits());
    }
}
