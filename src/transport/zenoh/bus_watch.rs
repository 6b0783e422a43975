//! Whether zenoh takes queries: while it removes the declarations of a session it takes none, and
//! with many subscriptions that takes long (docs/security.md).
//!
//! One thread sends a query each second to a key without a queryable: it passes through zenoh's
//! routing tables and ends there. A second thread checks how long the query has taken and which
//! sessions are being closed.

use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use tracing::{info, warn};
use zenoh::{Session, Wait};

use crate::health::Bus;
use crate::transport::zenoh::clients::{Client, Sessions};

/// The time between two queries.
const PROBE_PERIOD: Duration = Duration::from_secs(1);

/// The time after which a query that has not ended is a block.
const BLOCKED_AFTER: Duration = Duration::from_secs(2);

/// The time after which the sessions that are being closed are looked at, and the time between two
/// looks.
const LOOK_PERIOD: Duration = Duration::from_millis(100);

/// The clients that are named.
const MAX_NAMED: usize = 3;

/// Watches a session.
pub struct BusWatch {
    sessions: Arc<Sessions>,
    state: Mutex<State>,
    ended: Condvar,
}

#[derive(Default)]
struct State {
    /// Since when a query is under way.
    since: Option<Instant>,
    /// The sessions that were being closed when they were looked at first during this query.
    closing: Vec<Client>,
    /// Whether it has been counted as a block.
    is_counted: bool,
    blocks: u64,
    is_ended: bool,
}

impl BusWatch {
    /// Starts the threads; they send queries to `key`, which must have no queryable.
    ///
    /// # Errors
    ///
    /// When no thread can be started.
    pub fn start(session: Session, key: String, sessions: Arc<Sessions>) -> io::Result<Arc<Self>> {
        let watch = Arc::new(BusWatch {
            sessions,
            state: Mutex::default(),
            ended: Condvar::new(),
        });
        let (probing, looking) = (watch.clone(), watch.clone());
        thread::Builder::new()
            .name("bus-probe".into())
            .spawn(move || probing.probe(&session, &key))?;
        thread::Builder::new()
            .name("bus-watch".into())
            .spawn(move || looking.look())?;
        Ok(watch)
    }

    /// Ends it.
    pub fn stop(&self) {
        self.lock().is_ended = true;
        self.ended.notify_all();
    }

    /// What there is to report.
    pub fn report(&self) -> Bus {
        let mut state = self.lock();
        // A block that is reported is counted, though the watching thread may see it later.
        self.look_now(&mut state);
        let age = state.since.map(|since| since.elapsed());
        Bus {
            blocked: age.filter(|_| state.is_counted),
            closing: named(&state.closing),
            blocks: state.blocks,
        }
    }

    fn probe(&self, session: &Session, key: &str) {
        loop {
            self.lock().since = Some(Instant::now());
            let replies = session.get(key).wait();
            if let Ok(replies) = replies {
                while replies.recv().is_ok() {}
            }
            let mut state = self.lock();
            if let Some(since) = state.since.take()
                && state.is_counted
            {
                let secs = since.elapsed().as_secs_f64();
                log_end(secs, &state.closing);
            }
            (state.closing, state.is_counted) = (Vec::new(), false);
            if self.wait(state, PROBE_PERIOD) {
                return;
            }
        }
    }

    fn look(&self) {
        loop {
            let mut state = self.lock();
            self.look_now(&mut state);
            if self.wait(state, LOOK_PERIOD) {
                return;
            }
        }
    }

    /// Reads which sessions are being closed, and counts a block once.
    fn look_now(&self, state: &mut State) {
        let age = state.since.map_or(Duration::ZERO, |since| since.elapsed());
        if age >= LOOK_PERIOD && state.closing.is_empty() {
            let closing = self.sessions.closing();
            state.closing = closing.into_iter().map(|(client, _)| client).collect();
        }
        if age >= BLOCKED_AFTER && !state.is_counted {
            state.is_counted = true;
            state.blocks += 1;
            let closing = named(&state.closing);
            warn!(
                closing,
                "zenoh takes no commands and queries: it is closing a session"
            );
        }
    }

    /// Waits; whether it has ended.
    fn wait(&self, state: MutexGuard<'_, State>, period: Duration) -> bool {
        let waited = self
            .ended
            .wait_timeout_while(state, period, |state| !state.is_ended);
        waited.unwrap_or_else(PoisonError::into_inner).0.is_ended
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn log_end(secs: f64, closing: &[Client]) {
    match closing {
        [] => info!("commands were blocked for {secs:.1} s; no session was being closed"),
        [client] => warn!(
            "commands were blocked for {secs:.1} s while zenoh closed the session of {client}"
        ),
        several => warn!(
            "commands were blocked for {secs:.1} s while zenoh closed sessions, first that of {}",
            named(several)
        ),
    }
}

fn named(clients: &[Client]) -> String {
    let names = clients.iter().take(MAX_NAMED).map(ToString::to_string);
    let mut names = names.collect::<Vec<_>>().join(", then ");
    if clients.len() > MAX_NAMED {
        names += &format!(", and {} more", clients.len() - MAX_NAMED);
    }
    names
}
