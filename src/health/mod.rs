//! Whether all is well: threads that are stuck, a store that cannot write, a listener that is deaf.
//!
//! One thread looks every second. Those it watches only say when they begin and end a piece of
//! work ([`Pulse`]); the clock is here. Nobody is asked anything, so what is stuck holds up
//! neither the watch nor its verdict.

pub mod figures;
pub mod probe;

mod stuck;

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use thiserror::Error;
use tracing::{info, warn};

use crate::health::probe::{Hearing, Probe};
use crate::health::stuck::Stuck;
use crate::host::Host;
use crate::meter::Pulse;
use crate::store::Store;

/// How often is looked.
const PERIOD: Duration = Duration::from_secs(1);

/// A piece of work that takes longer is stuck; so is the watch if it has not looked for so long.
/// The longest steps there are, of thousands of packed individuals, take less than a second.
const PATIENCE: Duration = Duration::from_secs(5);

/// How often the listener is tried, and how soon again when it did not answer: that it is deaf is
/// known within half a minute.
const PROBE_PERIOD: Duration = Duration::from_secs(20);
const PROBE_AGAIN: Duration = Duration::from_secs(5);

/// Failures in a row that are none by chance.
const FAILURES: u32 = 2;

/// Why not all is well.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Reason {
    /// A swarm's thread is in one step or command for long.
    #[error("swarm {swarm} has been in one step or command for {secs:.0} s")]
    SwarmStuck {
        /// Which.
        swarm: String,
        /// For how long.
        secs: f64,
    },
    /// A thread of the daemon's own is at one thing for long.
    #[error("the thread {thread} has been at one thing for {secs:.0} s")]
    ThreadStuck {
        /// Which.
        thread: &'static str,
        /// For how long.
        secs: f64,
    },
    /// There is no space to write to.
    #[error("the disk is full: free some space, and the journal goes on by itself")]
    StoreFull,
    /// Writing fails otherwise.
    #[error("the journal cannot be written; the log says why")]
    StoreFailing,
    /// More waits to be written than should be kept in memory.
    #[error("more waits to be written than should be kept in memory")]
    StoreOverrun,
    /// The daemon does not hear who connects to it.
    #[error("{endpoint} does not answer: {problem}")]
    Deaf {
        /// Where.
        endpoint: String,
        /// How.
        problem: String,
    },
    /// Nobody gets in any more.
    #[error(
        "the daemon's certificate held until {day}: `jostled auth init --host NAME` with each of its \
         names makes a new one, for the daemon's next start"
    )]
    CertificateEnded {
        /// The last day of it.
        day: String,
    },
    /// Nobody has looked for long.
    #[error("the watch itself has not looked for {secs:.0} s")]
    WatchStuck {
        /// For how long.
        secs: f64,
    },
}

impl Reason {
    /// What it is in a word, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Reason::SwarmStuck { .. } => "swarm_stuck",
            Reason::ThreadStuck { .. } => "thread_stuck",
            Reason::StoreFull => "store_full",
            Reason::StoreFailing => "store_failing",
            Reason::StoreOverrun => "store_overrun",
            Reason::Deaf { .. } => "listener_deaf",
            Reason::CertificateEnded { .. } => "certificate_ended",
            Reason::WatchStuck { .. } => "watch_stuck",
        }
    }

    /// Whether another start of the daemon mends it. What hangs goes on by no other means; a disk
    /// is as full after a start as before.
    pub fn asks_for_restart(&self) -> bool {
        match self {
            Reason::SwarmStuck { .. }
            | Reason::ThreadStuck { .. }
            | Reason::Deaf { .. }
            | Reason::WatchStuck { .. } => true,
            Reason::StoreFull
            | Reason::StoreFailing
            | Reason::StoreOverrun
            | Reason::CertificateEnded { .. } => false,
        }
    }
}

/// What is watched.
pub struct Watched {
    /// The swarms.
    pub host: Arc<Host>,
    /// What outlives the daemon.
    pub store: Store,
    /// The daemon's own threads.
    pub threads: Vec<(&'static str, Arc<Pulse>)>,
    /// Where it listens.
    pub endpoints: Vec<String>,
    /// Counts the clients connected. It may take its time.
    pub sessions: Box<dyn Fn() -> usize + Send + Sync>,
    /// The last day of the daemon's certificate, if that is over.
    pub certificate_ended: Box<dyn Fn() -> Option<String> + Send + Sync>,
}

/// Watches a daemon.
pub struct Watch {
    watched: Watched,
    started: Instant,
    seen: Mutex<Seen>,
    end: Mutex<Option<Sender<()>>>,
}

/// What was seen when it was looked last.
struct Seen {
    at: Instant,
    stuck: Vec<Reason>,
    hearing: Vec<Hearing>,
    sessions: usize,
}

impl Watch {
    /// Begins to watch.
    ///
    /// # Errors
    ///
    /// When no thread can be started.
    pub fn start(watched: Watched) -> std::io::Result<Arc<Self>> {
        let (end, ended) = channel();
        let endpoints = watched.endpoints.iter();
        let probes: Vec<Probe> = endpoints.filter_map(|it| Probe::of(it)).collect();
        let watch = Arc::new(Watch {
            started: Instant::now(),
            seen: Mutex::new(Seen {
                at: Instant::now(),
                stuck: Vec::new(),
                hearing: probes.iter().map(|_| Hearing::default()).collect(),
                sessions: 0,
            }),
            end: Mutex::new(Some(end)),
            watched,
        });
        thread::Builder::new().name("watch".into()).spawn({
            let watch = watch.clone();
            move || watch.run(&probes, &ended)
        })?;
        Ok(watch)
    }

    /// Ends the watch.
    pub fn stop(&self) {
        drop(
            self.end
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .take(),
        );
    }

    /// Why not all is well; nothing if it is.
    pub fn reasons(&self) -> Vec<Reason> {
        let store = self.watched.store.health();
        let seen = self.seen();
        let mut reasons = seen.stuck.clone();
        let unseen = seen.at.elapsed();
        if unseen > PATIENCE + probe::PATIENCE * u32::try_from(seen.hearing.len()).unwrap_or(1) {
            let secs = unseen.as_secs_f64();
            reasons.push(Reason::WatchStuck { secs });
        }
        for hearing in seen.hearing.iter().filter(|it| it.failures >= FAILURES) {
            reasons.extend(hearing.problem.clone());
        }
        let ended = (self.watched.certificate_ended)();
        reasons.extend(ended.map(|day| Reason::CertificateEnded { day }));
        let troubles = [
            (store.is_full, Reason::StoreFull),
            (store.is_failing, Reason::StoreFailing),
            (store.is_overrun, Reason::StoreOverrun),
        ];
        reasons.extend(
            troubles
                .into_iter()
                .filter_map(|(is, why)| is.then_some(why)),
        );
        reasons
    }

    /// Since when it is watched: since the daemon started.
    pub fn uptime(&self) -> Duration {
        self.started.elapsed()
    }

    fn run(&self, probes: &[Probe], ended: &Receiver<()>) {
        let mut stuck = Stuck::default();
        let mut probe_due = Instant::now();
        let mut is_well = true;
        while ended.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
            let now = Instant::now();
            let found = stuck.look(&self.pieces(), now, PATIENCE);
            let sessions = (self.watched.sessions)();
            {
                let mut seen = self.seen();
                (seen.stuck, seen.sessions, seen.at) = (found, sessions, now);
            }
            if now >= probe_due {
                probe_due = now + PROBE_PERIOD;
                for (i, probe) in probes.iter().enumerate() {
                    let heard = probe.try_once();
                    if heard.is_err() {
                        probe_due = now + PROBE_AGAIN;
                    }
                    self.seen().hearing[i].note(heard);
                }
            }
            let reasons = self.reasons();
            if reasons.is_empty() != is_well {
                is_well = reasons.is_empty();
                let reasons: Vec<String> = reasons.iter().map(ToString::to_string).collect();
                match is_well {
                    true => info!("all is well again"),
                    false => warn!(reasons = reasons.join("; "), "not all is well"),
                }
            }
        }
    }

    /// Every piece of work under way: who is at it, and its number.
    fn pieces(&self) -> Vec<(stuck::Who, u64)> {
        let (swarms, _) = self.watched.host.handles();
        let swarms = swarms.into_iter().filter_map(|(name, handle)| {
            let number = handle.tally.pulse.at_work()?;
            Some((stuck::Who::Swarm(name), number))
        });
        let threads = self.watched.threads.iter();
        let threads =
            threads.filter_map(|(name, pulse)| Some((stuck::Who::Thread(name), pulse.at_work()?)));
        swarms.chain(threads).chain(self.store_at_work()).collect()
    }

    /// The store is at work while something waits; with every commit at the next piece.
    fn store_at_work(&self) -> Option<(stuck::Who, u64)> {
        let health = self.watched.store.health();
        // One that cannot write says so by itself.
        let is_stuck = health.waiting > 0 && !health.is_full && !health.is_failing;
        is_stuck.then_some((stuck::Who::Thread("store"), health.commits))
    }

    fn seen(&self) -> MutexGuard<'_, Seen> {
        // Every change is an assignment, so a panic leaves it whole.
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
