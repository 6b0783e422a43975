//! When a request is worth sending again: a pure function of what went wrong and of the time.

use std::hash::BuildHasher;
use std::time::{Duration, Instant};

use jostle_proto::ErrorCode;

use crate::failure::Failure;

/// The rest before the first repetition; each further one is twice as long.
const FIRST_REST: Duration = Duration::from_millis(50);
/// The longest rest.
const LONGEST_REST: Duration = Duration::from_secs(1);
/// How often silence is asked again that may mean "not there" and "not permitted" as well as
/// "lost".
const SILENCES: u32 = 2;

/// The repetitions of one request.
pub struct Again {
    deadline: Instant,
    is_command: bool,
    repetitions: u32,
    silences: u32,
    was_cut_off: bool,
}

impl Again {
    /// A request that is given up at `deadline`. A command is worth waiting for a lost connection,
    /// since nobody knows whether it was carried out; that a question was lost is told at once.
    pub fn until(deadline: Instant, is_command: bool) -> Self {
        Again {
            deadline,
            is_command,
            repetitions: 0,
            silences: 0,
            was_cut_off: false,
        }
    }

    /// How long to rest before sending the same request again; nothing if that cannot help or
    /// the time is over. `is_cut_off` tells whether a connection was lost since it was first sent.
    pub fn rest(&mut self, failure: &Failure, is_cut_off: bool, now: Instant) -> Option<Duration> {
        self.was_cut_off |= is_cut_off && self.is_command;
        let may_help = match failure {
            Failure::Refused { error, .. } => match error.code {
                ErrorCode::Busy => true,
                // The daemon holds a request for an hour at most; who waits longer asks again.
                ErrorCode::DeadlineExceeded => true,
                _ => false,
            },
            // There was a connection, or the session would not have opened.
            Failure::NoDaemon { .. } => self.is_command,
            Failure::Silent { .. } => self.is_short_silence(),
            // After a lost connection the tokens take a moment to be known again, and that it is
            // lost is known a moment later than that nobody answers.
            Failure::NoNode { .. } | Failure::NoSwarm { .. } | Failure::UnknownNode { .. } => {
                self.is_command && self.is_short_silence()
            }
            _ => false,
        };
        let rest = FIRST_REST
            .saturating_mul(1 << self.repetitions.min(8))
            .min(LONGEST_REST)
            .mul_f64(0.5 + share());
        self.repetitions += 1;
        (may_help && now + rest < self.deadline).then_some(rest)
    }

    /// Whether silence may still be a lost connection's.
    fn is_short_silence(&mut self) -> bool {
        self.silences += 1;
        self.was_cut_off || self.silences <= SILENCES
    }
}

/// A share from 0 to 1 that no two clients agree on, so that they do not all come back at once.
fn share() -> f64 {
    let bits = std::hash::RandomState::new().hash_one(0);
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use jostle_proto::Error;

    use super::*;

    fn refused(code: ErrorCode) -> Failure {
        Failure::refused(Error {
            code,
            message: String::new(),
            details: serde_json::Map::new(),
            step: None,
        })
    }

    fn cut_off() -> Failure {
        Failure::NoDaemon {
            endpoint: String::new(),
            cause: String::new(),
        }
    }

    fn no_swarm() -> Failure {
        Failure::NoSwarm {
            swarm: "demo".into(),
            there: Vec::new(),
        }
    }

    #[test]
    fn too_much_at_once_is_asked_again_until_the_time_is_over() {
        let (mut now, mut rests) = (Instant::now(), 0);
        let mut again = Again::until(now + Duration::from_secs(5), true);
        while let Some(rest) = again.rest(&refused(ErrorCode::Busy), false, now) {
            assert!(rest >= FIRST_REST / 2 && rest <= LONGEST_REST * 3 / 2);
            now += rest;
            rests += 1;
        }
        assert!((5..20).contains(&rests), "{rests}");
    }

    #[test]
    fn what_a_repetition_would_not_change_is_told_at_once() {
        let now = Instant::now();
        let mut again = Again::until(now + Duration::from_secs(5), true);
        for code in [
            ErrorCode::Conflict,
            ErrorCode::NotFound,
            ErrorCode::Internal,
        ] {
            assert_eq!(again.rest(&refused(code), false, now), None, "{code:?}");
        }
    }

    #[test]
    fn after_a_lost_connection_it_is_asked_until_everything_is_known_again() {
        let now = Instant::now();
        let mut again = Again::until(now + Duration::from_secs(5), true);
        assert!(again.rest(&cut_off(), true, now).is_some());
        assert!(again.rest(&no_swarm(), true, now).is_some());
        // That a connection was lost counts for all that follows.
        for _ in 0..=SILENCES {
            assert!(again.rest(&no_swarm(), false, now).is_some());
        }
        let late = now + Duration::from_secs(5);
        assert!(again.rest(&cut_off(), true, late).is_none());
    }

    #[test]
    fn that_a_question_was_lost_is_told_at_once() {
        let now = Instant::now();
        let mut again = Again::until(now + Duration::from_secs(5), false);
        assert_eq!(again.rest(&cut_off(), true, now), None);
        assert_eq!(again.rest(&no_swarm(), true, now), None);
        assert!(again.rest(&refused(ErrorCode::Busy), false, now).is_some());
    }

    #[test]
    fn silence_is_asked_again_twice() {
        let now = Instant::now();
        let whom = "demo".to_owned();
        for failure in [Failure::Silent { whom }, no_swarm()] {
            let mut again = Again::until(now + Duration::from_secs(5), true);
            let mut rest = || again.rest(&failure, false, now);
            assert!(rest().is_some() && rest().is_some());
            assert_eq!(rest(), None);
        }
    }

    #[test]
    fn no_two_rests_are_alike() {
        let (first, second) = (share(), share());
        assert!((0.0..1.0).contains(&first) && (0.0..1.0).contains(&second));
        assert_ne!(first.to_bits(), second.to_bits());
    }
}
