//! A thread that only sleeps, with the priority of a swarm's thread: how late it wakes is the lateness
//! that the machine and its load cause, without the daemon's own work.

use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use jostled::swarm::scheduler;

/// Sleeps until it is dropped.
pub struct Sleeper {
    late_ms: Arc<Mutex<Vec<f64>>>,
    _stop: Sender<()>,
}

impl Sleeper {
    /// Wakes so often from now on.
    pub fn start(period: Duration) -> Self {
        let (stop, stopped) = channel::<()>();
        let late_ms = Arc::<Mutex<Vec<f64>>>::default();
        let woken = late_ms.clone();
        thread::spawn(move || {
            scheduler::lower_priority().unwrap();
            let mut next = Instant::now() + period;
            let until = |next: Instant| next.saturating_duration_since(Instant::now());
            while let Err(RecvTimeoutError::Timeout) = stopped.recv_timeout(until(next)) {
                let late = next.elapsed();
                let mut woken = woken.lock().unwrap_or_else(PoisonError::into_inner);
                woken.push(late.as_secs_f64() * 1e3);
                next += period;
            }
        });
        Sleeper {
            late_ms,
            _stop: stop,
        }
    }

    /// By how many milliseconds 99.9 % were late at most, since it was last asked.
    pub fn late_ms(&self) -> f64 {
        let mut late = self.late_ms.lock().unwrap_or_else(PoisonError::into_inner);
        let mut late = std::mem::take(&mut *late);
        late.sort_by(f64::total_cmp);
        late.get(late.len() * 999 / 1000)
            .copied()
            .unwrap_or_default()
    }
}
