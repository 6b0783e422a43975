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
use crate::metrics::Pulse;
use crate::store::Store;
use crate::swarm::registry::SwarmRegistry;

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
    /// zenoh takes no queries.
    #[error(
        "commands and queries have been blocked for {secs:.0} s{}: it ends by itself; docs/security.md \
         says what a session's subscriptions can block",
        while_closing(closing)
    )]
    BusBlocked {
        /// For how long.
        secs: f64,
        /// Whose sessions are being closed, if any is.
        closing: String,
    },
    /// Another daemon holds a name of this one.
    #[error("{0}")]
    Contested(Contested),
    /// Nobody gets in any more.
    #[error(
        "the daemon's certificate held until {day}: `jostled auth init --host NAME` with each of its \
         names makes a new one, for the daemon's next start"
    )]
    CertificateEnded {
        /// The last day of it.
        day: String,
    },
    /// `people.json` was damaged while the daemon runs.
    #[error(
        "people.json cannot be read again: the rights that were read last stay in force, and \
         `jostled auth add` and `remove` have no effect; the log says why"
    )]
    PeopleUnreadable,
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
            Reason::BusBlocked { .. } => "bus_blocked",
            Reason::Contested(_) => "contested",
            Reason::CertificateEnded { .. } => "certificate_ended",
            Reason::PeopleUnreadable => "people_unreadable",
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
            | Reason::BusBlocked { .. }
            | Reason::Contested(_)
            | Reason::CertificateEnded { .. }
            | Reason::PeopleUnreadable => false,
        }
    }
}

/// A name that another daemon holds, too.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{}", words(self))]
pub struct Contested {
    /// The swarm; `None` for the daemon's own name.
    pub swarm: Option<String>,
    /// The other daemon's name.
    pub node: String,
    /// Its run.
    pub instance: String,
    /// Whether the other one serves the name.
    pub waits: bool,
}

fn words(contested: &Contested) -> String {
    let Contested {
        swarm,
        node,
        instance,
        waits,
    } = contested;
    let what = match swarm {
        Some(swarm) => format!("daemon {node} has a swarm {swarm}, too"),
        None => format!("another daemon is named {node}, too ({instance})"),
    };
    let outcome = match waits {
        true => "the other daemon serves it, and this one waits",
        false => "both created it or executed commands on it, so both reject everything",
    };
    let end = match swarm {
        Some(_) => "until one is stopped or deletes it",
        None => "until one is stopped",
    };
    format!("contested: {what}; {outcome}, {end}")
}

/// How many failed recordings a warning names.
const MAX_NAMED: usize = 5;

/// What is wrong without keeping the daemon from its work.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Warning {
    /// Recordings have failed.
    #[error("{}", recordings_failed(.0))]
    RecordingsFailed(Vec<(String, String)>),
}

impl Warning {
    /// What it is in a word, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Warning::RecordingsFailed(_) => "recording_failed",
        }
    }
}

fn recordings_failed(failed: &[(String, String)]) -> String {
    let named = failed.iter().take(MAX_NAMED);
    let named: Vec<String> = named
        .map(|(name, reason)| format!("{name} ({reason})"))
        .collect();
    let others = match failed.len().saturating_sub(MAX_NAMED) {
        0 => String::new(),
        others => format!(" and {others} more"),
    };
    format!(
        "recordings failed: {}{others}; `jostle record --list` lists them, \
         `jostle record --delete NAME` removes one with its files",
        named.join(", ")
    )
}

/// The daemon's recordings, counted by what they do.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordingCounts {
    /// Those that go on.
    pub recording: u64,
    /// Those that have ended.
    pub ended: u64,
    /// The names of those that have failed, and why.
    pub failed: Vec<(String, String)>,
}

/// The start of what is said of a session that is being closed.
fn while_closing(closing: &str) -> String {
    match closing {
        "" => String::new(),
        closing => format!(" while zenoh closes the session of {closing}"),
    }
}

/// Whether zenoh takes queries.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bus {
    /// For how long zenoh has been blocked, if that is longer than the limit.
    pub blocked: Option<Duration>,
    /// The clients whose sessions are being closed.
    pub closing: String,
    /// The number of blocks longer than the limit.
    pub blocks: u64,
}

/// What is watched.
pub struct Watched {
    /// The swarms.
    pub host: Arc<SwarmRegistry>,
    /// What outlives the daemon.
    pub store: Store,
    /// The daemon's own threads.
    pub threads: Vec<(&'static str, Arc<Pulse>)>,
    /// Where it listens.
    pub endpoints: Vec<String>,
    /// Counts the clients connected. It may take its time.
    pub sessions: Box<dyn Fn() -> usize + Send + Sync>,
    /// Tells whether zenoh takes queries.
    pub bus: Box<dyn Fn() -> Bus + Send + Sync>,
    /// The last day of the daemon's certificate, if that is over.
    pub certificate_ended: Box<dyn Fn() -> Option<String> + Send + Sync>,
    /// Counts the daemon's recordings.
    pub recordings: Box<dyn Fn() -> RecordingCounts + Send + Sync>,
    /// Whether `people.json` cannot be read again.
    pub are_people_unreadable: Box<dyn Fn() -> bool + Send + Sync>,
    /// The bytes of all recordings, and those that they may have.
    pub recordings_bytes: Box<dyn Fn() -> (u64, u64) + Send + Sync>,
    /// The names that another daemon holds, too.
    pub contested: Box<dyn Fn() -> Vec<Contested> + Send + Sync>,
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
        let bus = (self.watched.bus)();
        reasons.extend(bus.blocked.map(|age| Reason::BusBlocked {
            secs: age.as_secs_f64(),
            closing: bus.closing,
        }));
        let ended = (self.watched.certificate_ended)();
        reasons.extend(ended.map(|day| Reason::CertificateEnded { day }));
        let contested = (self.watched.contested)().into_iter();
        reasons.extend(contested.map(Reason::Contested));
        let troubles = [
            (
                (self.watched.are_people_unreadable)(),
                Reason::PeopleUnreadable,
            ),
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

    /// What is wrong without keeping the daemon from its work; nothing if all is well.
    pub fn warnings(&self) -> Vec<Warning> {
        let failed = (self.watched.recordings)().failed;
        let warning = (!failed.is_empty()).then_some(Warning::RecordingsFailed(failed));
        warning.into_iter().collect()
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
