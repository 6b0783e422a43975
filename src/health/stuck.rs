//! Who has been at one piece of work for long.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::health::Reason;

/// Who works.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Who {
    /// A swarm's thread.
    Swarm(String),
    /// One of the daemon's own.
    Thread(&'static str),
}

/// Who was at which piece of work, and since when it is seen.
#[derive(Default)]
pub struct Stuck(BTreeMap<Who, (u64, Instant)>);

impl Stuck {
    /// Looks at all pieces of work under way, and tells of those that are for longer than
    /// `patience`.
    pub fn look(&mut self, pieces: &[(Who, u64)], now: Instant, patience: Duration) -> Vec<Reason> {
        let mut before = std::mem::take(&mut self.0);
        let mut reasons = Vec::new();
        for (who, number) in pieces {
            let since = match before.remove(who) {
                Some((same, since)) if same == *number => since,
                _ => now,
            };
            let lasted = now.saturating_duration_since(since);
            if lasted > patience {
                reasons.push(reason(who, lasted.as_secs_f64()));
            }
            self.0.insert(who.clone(), (*number, since));
        }
        reasons
    }
}

fn reason(who: &Who, secs: f64) -> Reason {
    match who {
        Who::Swarm(swarm) => Reason::SwarmStuck {
            swarm: swarm.clone(),
            secs,
        },
        Who::Thread(thread) => Reason::ThreadStuck { thread, secs },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_who_stays_at_the_same_piece_is_stuck_and_whoever_is_gone_is_forgotten() {
        let start = Instant::now();
        let mut stuck = Stuck::default();
        let mut look = |secs, pieces: &[(&str, u64)]| {
            let pieces: Vec<_> = pieces
                .iter()
                .map(|(name, number)| (Who::Swarm((*name).to_owned()), *number))
                .collect();
            let now = start + Duration::from_secs(secs);
            let reasons = stuck.look(&pieces, now, Duration::from_secs(5));
            let reasons = reasons.into_iter().map(|it| it.to_string());
            reasons.collect::<Vec<_>>()
        };
        assert_eq!(look(0, &[("a", 1), ("b", 1)]), [""; 0]);
        assert_eq!(look(4, &[("a", 1), ("b", 3)]), [""; 0]);
        assert_eq!(
            look(6, &[("a", 1), ("b", 3)]),
            ["swarm a has been in one step or command for 6 s"]
        );
        assert_eq!(look(7, &[("b", 3)]), [""; 0]);
        assert_eq!(look(8, &[("a", 1), ("b", 5)]), [""; 0], "a began anew");
    }
}
