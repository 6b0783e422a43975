//! Detects threads that execute one task for too long.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::health::reason::Reason;

/// A thread that executes tasks.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Worker {
    /// The thread of a swarm.
    Swarm(String),
    /// Another thread of the daemon.
    Thread(&'static str),
}

/// The task of each worker at the last check, and when that task was first seen.
#[derive(Default)]
pub struct Watchdog(BTreeMap<Worker, (u64, Instant)>);

impl Watchdog {
    /// Returns a reason for each worker whose task number has not changed for `timeout`.
    pub fn check(
        &mut self,
        tasks: &[(Worker, u64)],
        now: Instant,
        timeout: Duration,
    ) -> Vec<Reason> {
        let mut before = std::mem::take(&mut self.0);
        let mut reasons = Vec::new();
        for (worker, task) in tasks {
            let since = match before.remove(worker) {
                Some((same, since)) if same == *task => since,
                _ => now,
            };
            let lasted = now.saturating_duration_since(since);
            if lasted > timeout {
                reasons.push(reason(worker, lasted.as_secs_f64()));
            }
            self.0.insert(worker.clone(), (*task, since));
        }
        reasons
    }
}

fn reason(worker: &Worker, secs: f64) -> Reason {
    match worker {
        Worker::Swarm(swarm) => Reason::SwarmStuck {
            swarm: swarm.clone(),
            secs,
        },
        Worker::Thread(thread) => Reason::ThreadStuck { thread, secs },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_worker_that_stays_at_the_same_task_is_stuck() {
        let start = Instant::now();
        let mut watchdog = Watchdog::default();
        let mut check = |secs, tasks: &[(&str, u64)]| {
            let tasks: Vec<_> = tasks
                .iter()
                .map(|(name, number)| (Worker::Swarm((*name).to_owned()), *number))
                .collect();
            let now = start + Duration::from_secs(secs);
            let reasons = watchdog.check(&tasks, now, Duration::from_secs(5));
            let reasons = reasons.into_iter().map(|it| it.to_string());
            reasons.collect::<Vec<_>>()
        };
        assert_eq!(check(0, &[("a", 1), ("b", 1)]), [""; 0]);
        assert_eq!(check(4, &[("a", 1), ("b", 3)]), [""; 0]);
        assert_eq!(
            check(6, &[("a", 1), ("b", 3)]),
            ["swarm a has been in one step or command for 6 s"]
        );
        assert_eq!(check(7, &[("b", 3)]), [""; 0]);
        assert_eq!(
            check(8, &[("a", 1), ("b", 5)]),
            [""; 0],
            "a started a new task"
        );
    }
}
