//! When to retry a request: a function of the error and of the time. `tests/outages.toml` of the
//! repository defines the numbers for all clients.

use std::hash::BuildHasher;
use std::time::{Duration, Instant};

use jostle_proto::ErrorCode;

use crate::error::Error;

/// The delay before the first retry.
pub(crate) const FIRST_DELAY: Duration = Duration::from_millis(50);
/// The factor from each delay to the next.
const GROWTH: f64 = 2.0;
/// The longest delay.
const MAX_DELAY: Duration = Duration::from_secs(1);
/// A delay is multiplied by a random number from `1 - JITTER` to `1 + JITTER`, so that clients do not
/// retry at the same moment.
const JITTER: f64 = 0.5;
/// The number of retries after errors that may mean "does not exist" or "not permitted" as well
/// as a lost request.
const MAX_SILENT_RETRIES: u32 = 2;

/// The delays before retries.
pub(crate) struct Delays(Duration);

impl Default for Delays {
    fn default() -> Self {
        Delays(FIRST_DELAY)
    }
}

impl Delays {
    /// The delay before the next retry.
    pub fn next(&mut self) -> Duration {
        self.next_with(random_share())
    }

    /// [`next`](Self::next) with a random number from 0 to 1.
    fn next_with(&mut self, share: f64) -> Duration {
        let delay = self.0.mul_f64(1.0 - JITTER + 2.0 * JITTER * share);
        self.0 = self.0.mul_f64(GROWTH).min(MAX_DELAY);
        delay
    }
}

/// The retries of one request.
pub(crate) struct RetryPolicy {
    deadline: Instant,
    failing: Duration,
    give_up_at: Option<Instant>,
    delays: Delays,
    silent: u32,
    was_interrupted: bool,
}

impl RetryPolicy {
    /// Retries until `deadline`, or until every attempt failed for the time `failing`.
    pub fn new(deadline: Instant, failing: Duration) -> Self {
        RetryPolicy {
            deadline,
            failing,
            give_up_at: None,
            delays: Delays::default(),
            silent: 0,
            was_interrupted: false,
        }
    }

    /// Starts over with the shortest delay, since an attempt did not fail.
    pub fn reset(&mut self) {
        *self = RetryPolicy::new(self.deadline, self.failing);
    }

    /// Whether so many replies are missing that no connection that breaks can be the cause.
    pub fn is_settled(&self) -> bool {
        self.silent > MAX_SILENT_RETRIES && !self.was_interrupted
    }

    /// When attempts end, if the next ones fail, too.
    pub fn give_up_at(&self) -> Instant {
        self.give_up_at.unwrap_or(self.deadline)
    }

    /// The delay before the next retry; `None` if a retry cannot help or would exceed the limits.
    /// `is_interrupted` is whether the daemon was not reachable since the first attempt.
    pub fn delay(&mut self, error: &Error, is_interrupted: bool, now: Instant) -> Option<Duration> {
        let give_up_at = self
            .give_up_at
            .get_or_insert_with(|| self.deadline.min(now + self.failing));
        let give_up_at = *give_up_at;
        self.was_interrupted |= is_interrupted;
        let may_help = match error {
            Error::Rejected(error) => match error.code {
                // The daemon holds a request for an hour at most.
                ErrorCode::Busy | ErrorCode::DeadlineExceeded => true,
                // A daemon that is back waits for the claims of others.
                ErrorCode::Contested => self.was_interrupted,
                _ => false,
            },
            // The connection existed, or the session would not have opened. Without a reply it may be
            // about to be lost.
            Error::NoDaemon { .. } | Error::TimedOut { .. } => {
                self.was_interrupted = true;
                true
            }
            // After a lost connection tokens are declared again with a delay, and the loss is
            // noticed after the missing reply.
            _ if error.is_silence() => {
                self.silent += 1;
                !self.is_settled()
            }
            _ => false,
        };
        let delay = self.delays.next();
        (may_help && now + delay < give_up_at).then_some(delay)
    }
}

/// A random number from 0 to 1.
fn random_share() -> f64 {
    let bits = std::hash::RandomState::new().hash_one(0);
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    const SECS_5: Duration = Duration::from_secs(5);

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

    fn timed_out() -> Error {
        Error::TimedOut {
            target: "demo".into(),
            secs: 2.0,
        }
    }

    #[test]
    fn the_delays_are_those_of_the_table() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/outages.toml");
        let table: toml::Table = std::fs::read_to_string(path).unwrap().parse().unwrap();
        let number = |name: &str| table["retries"][name].as_float().unwrap();
        let jitter = number("jitter");
        for share in [0.0, 1.0] {
            let mut delays = Delays::default();
            let mut expected = number("first_delay_secs");
            for _ in 0..8 {
                let delay = delays.next_with(share);
                let factor = 1.0 - jitter + 2.0 * jitter * share;
                let difference = delay.as_secs_f64() - factor * expected;
                assert!(difference.abs() < 1e-6, "{delay:?} is not {expected} s");
                expected = (number("growth") * expected).min(number("max_delay_secs"));
            }
        }
        let silent = table["retries"]["max_silent_retries"].as_integer();
        assert_eq!(silent, Some(i64::from(MAX_SILENT_RETRIES)));
    }

    #[test]
    fn attempts_end_at_the_deadline_or_after_failing_for_long() {
        let began = Instant::now();
        for (deadline, failing, least, most) in [(5, 60, 3, 5), (60, 5, 3, 5), (60, 60, 58, 60)] {
            let mut now = began;
            let failing = Duration::from_secs(failing);
            let mut policy = RetryPolicy::new(now + Duration::from_secs(deadline), failing);
            while let Some(delay) = policy.delay(&no_daemon(), false, now) {
                now += delay;
            }
            let took = (now - began).as_secs();
            assert!((least..most).contains(&took), "{took} s");
        }
    }

    #[test]
    fn an_attempt_that_does_not_fail_starts_the_delays_over() {
        let now = Instant::now();
        let mut policy = RetryPolicy::new(now + 2 * SECS_5, SECS_5);
        let busy = rejected(ErrorCode::Busy);
        while policy.delay(&busy, false, now).unwrap() < MAX_DELAY / 2 {}
        assert_eq!(policy.delay(&busy, false, now + SECS_5), None);
        policy.reset();
        let delay = policy.delay(&busy, false, now + SECS_5).unwrap();
        assert!(delay < 2 * FIRST_DELAY, "{delay:?}");
        assert_eq!(policy.delay(&busy, false, now + 2 * SECS_5), None);
    }

    #[test]
    fn a_permanent_error_is_not_retried() {
        let now = Instant::now();
        let mut policy = RetryPolicy::new(now + SECS_5, SECS_5);
        for code in [
            ErrorCode::Conflict,
            ErrorCode::Contested,
            ErrorCode::NotFound,
            ErrorCode::Internal,
        ] {
            assert_eq!(policy.delay(&rejected(code), false, now), None, "{code:?}");
        }
    }

    #[test]
    fn a_request_is_retried_after_a_lost_connection_until_tokens_are_declared_again() {
        let now = Instant::now();
        for lost in [no_daemon(), timed_out()] {
            let mut policy = RetryPolicy::new(now + SECS_5, SECS_5);
            assert!(policy.delay(&lost, false, now).is_some());
            // The lost connection counts for all further retries.
            for _ in 0..=MAX_SILENT_RETRIES {
                assert!(policy.delay(&no_swarm(), false, now).is_some());
            }
            let contested = rejected(ErrorCode::Contested);
            assert!(policy.delay(&contested, false, now).is_some());
            assert!(policy.delay(&no_daemon(), true, now + SECS_5).is_none());
        }
    }

    #[test]
    fn a_missing_reply_is_retried_twice() {
        let now = Instant::now();
        let target = "demo".to_owned();
        for error in [Error::Silent { target }, no_swarm()] {
            let mut policy = RetryPolicy::new(now + SECS_5, SECS_5);
            for _ in 0..MAX_SILENT_RETRIES {
                assert!(policy.delay(&error, false, now).is_some());
                assert!(!policy.is_settled());
            }
            assert_eq!(policy.delay(&error, false, now), None);
            assert!(policy.is_settled());
        }
    }

    #[test]
    fn delays_are_random() {
        let (first, second) = (random_share(), random_share());
        assert!((0.0..1.0).contains(&first) && (0.0..1.0).contains(&second));
        assert_ne!(first.to_bits(), second.to_bits());
    }
}
