//! Detects when zenoh is blocked. zenoh routes no query while it removes the declarations of a closed
//! session, which takes long if there are many (docs/security.md).
//!
//! The thread `bus-probe` sends a query each second to a key without a queryable: it passes through
//! zenoh's routing tables and ends there. The thread `bus-watch` checks how long the query has taken
//! and which sessions are being closed.

use std::io;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex, MutexGuard};
use tracing::{info, warn};
use zenoh::{Session, Wait};

use crate::health::Bus;
use crate::transport::zenoh::clients::{Client, Sessions};

/// The time between two probes.
const PROBE_INTERVAL: Duration = Duration::from_secs(1);

/// zenoh is blocked if a probe has not ended after this time.
const PROBE_TIMEOUT: Duration = Duration::from_secs(2);

/// The time between two checks of a probe, and the age at which a probe causes the first look at the
/// sessions that are being closed.
const CHECK_INTERVAL: Duration = Duration::from_millis(100);

/// The most clients that are named in a message.
const MAX_NAMED: usize = 3;

/// Probes a zenoh session.
pub struct BusWatch {
    sessions: Arc<Sessions>,
    state: Mutex<State>,
    ended: Condvar,
}

#[derive(Default)]
struct State {
    /// When the probe that has not ended was sent.
    since: Option<Instant>,
    /// The sessions that were being closed at the first look during this probe.
    closing: Vec<Client>,
    /// Whether this probe has been counted as a block.
    is_counted: bool,
    blocks: u64,
    is_ended: bool,
}

impl BusWatch {
    /// Starts the threads. `key` is the key of the probes and must have no queryable.
    pub fn start(session: Session, key: String, sessions: Arc<Sessions>) -> io::Result<Arc<Self>> {
        let watch = Arc::new(BusWatch {
            sessions,
            state: Mutex::default(),
            ended: Condvar::new(),
        });
        let (probing, checking) = (watch.clone(), watch.clone());
        thread::Builder::new()
            .name("bus-probe".into())
            .spawn(move || probing.probe(&session, &key))?;
        thread::Builder::new()
            .name("bus-watch".into())
            .spawn(move || checking.check())?;
        Ok(watch)
    }

    /// Ends the threads.
    pub fn stop(&self) {
        self.state.lock().is_ended = true;
        self.ended.notify_all();
    }

    /// The state for the health report.
    pub fn report(&self) -> Bus {
        let mut state = self.state.lock();
        // The other thread may not have counted a block that this report contains.
        self.check_now(&mut state);
        let age = state.since.map(|since| since.elapsed());
        Bus {
            blocked: age.filter(|_| state.is_counted),
            closing: named(&state.closing),
            blocks: state.blocks,
        }
    }

    fn probe(&self, session: &Session, key: &str) {
        loop {
            self.state.lock().since = Some(Instant::now());
            let replies = session.get(key).wait();
            if let Ok(replies) = replies {
                while replies.recv().is_ok() {}
            }
            let mut state = self.state.lock();
            if let Some(since) = state.since.take()
                && state.is_counted
            {
                let secs = since.elapsed().as_secs_f64();
                log_end(secs, &state.closing);
            }
            (state.closing, state.is_counted) = (Vec::new(), false);
            if self.wait(state, PROBE_INTERVAL) {
                return;
            }
        }
    }

    fn check(&self) {
        loop {
            let mut state = self.state.lock();
            self.check_now(&mut state);
            if self.wait(state, CHECK_INTERVAL) {
                return;
            }
        }
    }

    /// Reads which sessions are being closed, and counts a block once.
    fn check_now(&self, state: &mut State) {
        let age = state.since.map_or(Duration::ZERO, |since| since.elapsed());
        if age >= CHECK_INTERVAL && state.closing.is_empty() {
            state.closing = self.sessions.closing();
        }
        if age >= PROBE_TIMEOUT && !state.is_counted {
            state.is_counted = true;
            state.blocks += 1;
            let closing = named(&state.closing);
            warn!(
                closing,
                "zenoh is blocked: commands and queries wait until it has closed a session"
            );
        }
    }

    /// Waits for `period`, or until the threads are to end; returns whether they are.
    fn wait(&self, mut state: MutexGuard<'_, State>, period: Duration) -> bool {
        let is_on = |state: &mut State| !state.is_ended;
        self.ended.wait_while_for(&mut state, is_on, period);
        state.is_ended
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
