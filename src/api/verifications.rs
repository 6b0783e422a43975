//! The verifications, or the exports, and their progress: at most `MAX_RUNNING` run at once, the next
//! ones are queued.

use std::collections::{BTreeMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread;

use parking_lot::Mutex;
use tracing::error;

use crate::convert::commands::CommandError;

/// Verifications at once. Each replays a history on one core.
const MAX_RUNNING: usize = 4;
/// Verifications that are queued behind those; further ones are rejected.
const MAX_QUEUED: usize = 64;

/// A verification to execute: replays a history and replies.
pub trait Work: Send + Sized + 'static {
    /// The name of the threads that execute it.
    const THREAD: &'static str;

    /// Executes it. `own` ends when it is dropped.
    fn run(self, own: Verification<Self>);
}

/// The verifications under way.
pub struct Verifications<W>(Mutex<State<W>>);

struct State<W> {
    /// Those that run and those that are queued, by their numbers: the swarm, and the share of its
    /// history that is replayed.
    entries: BTreeMap<u64, (Arc<str>, f64)>,
    /// Those that no thread has taken, the oldest first.
    queue: VecDeque<(Verification<W>, W)>,
    /// Threads that take from the queue.
    threads: usize,
    /// The number of the next one.
    number: u64,
}

/// A verification under way; it ends when this is dropped.
pub struct Verification<W> {
    all: Arc<Verifications<W>>,
    number: u64,
}

impl<W> Default for Verifications<W> {
    fn default() -> Self {
        Verifications(Mutex::new(State {
            entries: BTreeMap::new(),
            queue: VecDeque::new(),
            threads: 0,
            number: 0,
        }))
    }
}

impl<W: Work> Verifications<W> {
    /// Begins a verification on a thread of its own, or queues it if four are running.
    ///
    /// # Errors
    ///
    /// [`CommandError::Busy`] when the queue is full or no thread can be started.
    pub fn begin(self: &Arc<Self>, swarm: &Arc<str>, work: W) -> Result<(), CommandError> {
        let mut state = self.0.lock();
        if state.entries.len() >= MAX_RUNNING + MAX_QUEUED {
            return Err(CommandError::Busy);
        }
        if state.threads < MAX_RUNNING {
            let all = self.clone();
            let spawned = thread::Builder::new()
                .name(W::THREAD.into())
                .spawn(move || all.work());
            match spawned {
                Ok(_) => state.threads += 1,
                // Another thread takes it from the queue.
                Err(_) if state.threads > 0 => {}
                Err(_) => return Err(CommandError::Busy),
            }
        }
        let number = state.number;
        state.number += 1;
        state.entries.insert(number, (swarm.clone(), 0.0));
        let verification = Verification {
            all: self.clone(),
            number,
        };
        state.queue.push_back((verification, work));
        Ok(())
    }

    /// How far the verification of a swarm has come, from 0 to 1; the one that is furthest, if
    /// there are several.
    pub fn share(&self, swarm: &str) -> Option<f64> {
        let state = self.0.lock();
        let of_swarm = state.entries.values().filter(|(name, _)| &**name == swarm);
        of_swarm.map(|(_, share)| *share).max_by(f64::total_cmp)
    }

    /// Drops what is queued, because the daemon stops.
    pub fn stop(&self) {
        let queue = std::mem::take(&mut self.0.lock().queue);
        // Dropping a verification takes the lock.
        drop(queue);
    }

    /// Runs what is queued until nothing is.
    fn work(&self) {
        loop {
            let mut state = self.0.lock();
            let Some((verification, work)) = state.queue.pop_front() else {
                state.threads -= 1;
                return;
            };
            drop(state);
            if catch_unwind(AssertUnwindSafe(|| work.run(verification))).is_err() {
                error!(
                    thread = W::THREAD,
                    "a defect: a verification or an export panicked"
                );
            }
        }
    }
}

impl<W> Verification<W> {
    /// Records the share that is replayed.
    pub fn advance(&self, share: f64) {
        if let Some(entry) = self.all.0.lock().entries.get_mut(&self.number) {
            entry.1 = share;
        }
    }
}

impl<W> Drop for Verification<W> {
    fn drop(&mut self) {
        self.all.0.lock().entries.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::sync::mpsc::{Receiver, Sender, channel};
    use std::time::{Duration, Instant};

    use super::*;

    const TEST_TIMEOUT: Duration = Duration::from_secs(20);

    /// Advances to each share that is sent, and ends when the sender is dropped; sends its number when
    /// it runs. Without channels it panics.
    struct Probe(Option<(Sender<u64>, Receiver<f64>)>);

    impl Work for Probe {
        const THREAD: &'static str = "probe";

        fn run(self, own: Verification<Self>) {
            let (running, shares) = self.0.expect("a defect");
            // Some tests do not ask when it runs.
            let _ = running.send(own.number);
            while let Ok(share) = shares.recv() {
                own.advance(share);
            }
        }
    }

    fn begin(
        all: &Arc<Verifications<Probe>>,
        swarm: &Arc<str>,
    ) -> Option<(Sender<f64>, Receiver<u64>)> {
        let (shares, to_take) = channel();
        let (running, runs) = channel();
        let begun = all.begin(swarm, Probe(Some((running, to_take))));
        begun.is_ok().then_some((shares, runs))
    }

    fn until(what: &str, holds: impl Fn() -> bool) {
        let deadline = Instant::now() + TEST_TIMEOUT;
        while !holds() {
            assert!(Instant::now() < deadline, "{what}");
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn each_swarm_has_its_share_until_its_verification_ends() {
        let all = Arc::new(Verifications::default());
        let (a, b): (Arc<str>, Arc<str>) = ("a".into(), "b".into());
        assert_eq!(all.share("a"), None);
        let (first, _) = begin(&all, &a).unwrap();
        let (second, _) = begin(&all, &a).unwrap();
        let (other, _) = begin(&all, &b).unwrap();
        first.send(0.5).unwrap();
        other.send(0.25).unwrap();
        until("both advance", || {
            (all.share("a"), all.share("b")) == (Some(0.5), Some(0.25))
        });
        drop(first);
        until("the second one is under way", || {
            all.share("a") == Some(0.0)
        });
        drop((second, other));
        until("all end", || {
            (all.share("a"), all.share("b")) == (None, None)
        });
    }

    #[test]
    fn those_beyond_four_are_queued_and_run_in_their_order() {
        let all = Arc::new(Verifications::default());
        let a: Arc<str> = "a".into();
        let begun = std::iter::from_fn(|| begin(&all, &a));
        let mut begun: VecDeque<_> = begun.take(2 * (MAX_RUNNING + MAX_QUEUED)).collect();
        // No more than these: the queue is bounded.
        assert_eq!(begun.len(), MAX_RUNNING + MAX_QUEUED);
        let mut running: Vec<_> = begun.drain(..MAX_RUNNING).collect();
        for (_, runs) in &running {
            assert!(runs.recv_timeout(TEST_TIMEOUT).unwrap() < MAX_RUNNING as u64);
        }
        let mut expected = MAX_RUNNING as u64;
        while let Some(next) = begun.pop_front() {
            assert!(next.1.try_recv().is_err(), "more than {MAX_RUNNING} run");
            drop(running.pop());
            assert_eq!(next.1.recv_timeout(TEST_TIMEOUT), Ok(expected));
            expected += 1;
            running.push(next);
        }
        drop(running);
        until("all end", || all.share("a").is_none());
        assert!(begin(&all, &a).is_some(), "there is room again");
    }

    #[test]
    fn one_that_panics_keeps_its_place_from_nobody() {
        let all = Arc::new(Verifications::default());
        let a: Arc<str> = "a".into();
        for _ in 0..=MAX_RUNNING {
            let begun = all.begin(&a, Probe(None));
            assert!(begun.is_ok());
        }
        let (_shares, runs) = begin(&all, &a).unwrap();
        assert!(runs.recv_timeout(TEST_TIMEOUT).is_ok());
    }

    #[test]
    fn what_is_queued_is_dropped_at_the_end() {
        let all = Arc::new(Verifications::default());
        let a: Arc<str> = "a".into();
        let running: Vec<_> = (0..MAX_RUNNING).map(|_| begin(&all, &a).unwrap()).collect();
        let (_shares, queued) = begin(&all, &a).unwrap();
        for (_, runs) in &running {
            runs.recv_timeout(TEST_TIMEOUT).unwrap();
        }
        all.stop();
        drop(running);
        until("all end", || all.share("a").is_none());
        assert!(queued.recv().is_err(), "it was never run");
    }
}
