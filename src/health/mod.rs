//! The health of the daemon: blocked threads, a store that cannot write, unresponsive listeners.
//!
//! One thread checks every second. The threads that it watches only count their tasks
//! ([`Activity`]), so a blocked thread does not block the checks.

pub mod metrics;
pub mod probe;

mod reason;
mod watchdog;

pub use reason::{Bus, Contested, Reason, RecordingCounts};

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use tracing::{info, warn};

use crate::auth::live::LiveRights;
use crate::experiments::ExperimentManager;
use crate::health::probe::{Probe, ProbeStatus};
use crate::health::watchdog::{Watchdog, Worker};
use crate::lanes::Lanes;
use crate::metrics::Activity;
use crate::recording::Recordings;
use crate::store::Store;
use crate::swarm::recovery_progress::RecoveryProgress;
use crate::swarm::registry::SwarmRegistry;

/// The interval between checks.
const CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// The longest time for one task, and between two checks. The longest steps, of thousands of packed
/// individuals, take less than a second.
const TASK_TIMEOUT: Duration = Duration::from_secs(5);

/// The interval between probes of the listeners, and after a failed one: an unresponsive listener is
/// reported within half a minute.
const PROBE_INTERVAL: Duration = Duration::from_secs(20);
const PROBE_RETRY: Duration = Duration::from_secs(5);

/// Failed probes in a row after which a listener is reported.
const MIN_FAILURES: u32 = 2;

/// What is checked.
pub struct HealthSources {
    /// The swarms.
    pub registry: Arc<SwarmRegistry>,
    /// The store.
    pub store: Store,
    /// The users.
    pub rights: Arc<LiveRights>,
    /// The recordings.
    pub recordings: Recordings,
    /// The experiments.
    pub experiments: ExperimentManager,
    /// The lanes.
    pub lanes: Lanes,
    /// The other threads of the daemon.
    pub threads: Vec<(&'static str, Arc<Activity>)>,
    /// The endpoints to probe.
    pub endpoints: Vec<String>,
    /// Counts the connected clients. May block.
    pub sessions: Box<dyn Fn() -> usize + Send + Sync>,
    /// Whether zenoh is blocked.
    pub bus: Box<dyn Fn() -> Bus + Send + Sync>,
    /// Counts the recordings by phase.
    pub count: fn(&Recordings) -> RecordingCounts,
    /// Requests that a defect dropped without a reply.
    pub dropped_requests: Box<dyn Fn() -> u64 + Send + Sync>,
    /// Data of other daemons beside the new data folder of this one: the message.
    pub other_data: Option<String>,
    /// The swarms that are not recovered yet.
    pub recovery: Arc<RecoveryProgress>,
    /// The names that another daemon uses too.
    pub contested: Box<dyn Fn() -> Vec<Contested> + Send + Sync>,
}

/// The health checks of a daemon.
pub struct HealthMonitor {
    watched: HealthSources,
    started: Instant,
    /// Every change is an assignment, so a panic leaves no partial one.
    last: Mutex<Check>,
    end: Mutex<Option<Sender<()>>>,
}

/// The results of the last check.
struct Check {
    at: Instant,
    stuck: Vec<Reason>,
    probes: Vec<ProbeStatus>,
    sessions: usize,
}

impl HealthMonitor {
    /// Starts the health thread.
    pub fn start(watched: HealthSources) -> std::io::Result<Arc<Self>> {
        let (end, ended) = channel();
        let endpoints = watched.endpoints.iter();
        let probes: Vec<Probe> = endpoints.filter_map(|it| Probe::of(it)).collect();
        let watch = Arc::new(HealthMonitor {
            started: Instant::now(),
            last: Mutex::new(Check {
                at: Instant::now(),
                stuck: Vec::new(),
                probes: vec![ProbeStatus::default(); probes.len()],
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

    /// Stops the health thread.
    pub fn stop(&self) {
        self.end.lock().take();
    }

    /// Why the daemon is unhealthy; empty if it is healthy.
    pub fn reasons(&self) -> Vec<Reason> {
        let store = self.watched.store.health();
        let last = self.last.lock();
        let mut reasons = last.stuck.clone();
        let left = self.watched.recovery.swarms_left();
        reasons.extend(left.map(|swarms_left| Reason::Recovering { swarms_left }));
        let age = last.at.elapsed();
        let probes = u32::try_from(last.probes.len()).unwrap_or(1);
        if age > TASK_TIMEOUT + probe::TIMEOUT * probes {
            reasons.push(Reason::WatchStuck(age.as_secs_f64()));
        }
        let failed = last.probes.iter().filter(|it| it.failures >= MIN_FAILURES);
        reasons.extend(failed.filter_map(|it| it.problem.clone()));
        drop(last);
        let lanes = self.watched.lanes.status().into_iter();
        reasons.extend(lanes.filter_map(|it| {
            Some(Reason::ThreadStuck {
                thread: it.lane.name(),
                secs: it.stuck?.as_secs_f64(),
            })
        }));
        let bus = (self.watched.bus)();
        reasons.extend(bus.blocked.map(|age| Reason::BusBlocked {
            secs: age.as_secs_f64(),
            closing: bus.closing,
        }));
        let rights = &self.watched.rights;
        let ended = rights.current().ended();
        reasons.extend(ended.map(Reason::CertificateEnded));
        let contested = (self.watched.contested)().into_iter();
        reasons.extend(contested.map(Reason::Contested));
        let flags = [
            (rights.problem().is_some(), Reason::PeopleUnreadable),
            (store.is_full, Reason::StoreFull),
            (store.is_failing, Reason::StoreFailing),
            (store.is_overrun, Reason::StoreOverrun),
        ];
        let flags = flags.into_iter();
        reasons.extend(flags.filter_map(|(is, reason)| is.then_some(reason)));
        reasons
    }

    /// The problems with which the daemon stays healthy: the code of each in `/healthz`, and its
    /// message.
    pub fn warnings(&self) -> Vec<(&'static str, String)> {
        let mut warnings = Vec::new();
        let failed = (self.watched.count)(&self.watched.recordings).failed;
        if !failed.is_empty() {
            warnings.push(("recording_failed", reason::recordings_failed(&failed)));
        }
        let paused = self.watched.experiments.paused_by_daemon();
        if !paused.is_empty() {
            warnings.push(("experiment_paused", reason::experiments_paused(&paused)));
        }
        let (swarms, _) = self.watched.registry.handles();
        let swarms = swarms.into_iter();
        let behind = swarms.filter_map(|(name, it)| reason::shortfall(name, &it.summary()?));
        let behind: Vec<_> = behind.collect();
        if !behind.is_empty() {
            warnings.push(("behind_rate", reason::swarms_behind(&behind)));
        }
        let lanes = self.watched.lanes.status().into_iter();
        let behind = lanes.filter(|it| it.is_behind());
        warnings.extend(behind.map(|it| ("lane_behind", reason::lane_behind(&it))));
        let damaged = self.watched.store.health().damaged;
        if damaged > 0 {
            warnings.push(("journal_damaged", reason::journal_damaged(damaged)));
        }
        let other_data = self.watched.other_data.clone();
        warnings.extend(other_data.map(|message| ("other_data", message)));
        let soon = self.watched.rights.current().ends_soon();
        warnings.extend(soon.map(|message| ("certificate_ends", message)));
        warnings
    }

    /// The time since the daemon started.
    pub fn uptime(&self) -> Duration {
        self.started.elapsed()
    }

    fn run(&self, probes: &[Probe], ended: &Receiver<()>) {
        let mut watchdog = Watchdog::default();
        let mut probe_due = Instant::now();
        let mut is_healthy = true;
        while ended.recv_timeout(CHECK_INTERVAL) == Err(RecvTimeoutError::Timeout) {
            let now = Instant::now();
            let stuck = watchdog.check(&self.tasks(), now, TASK_TIMEOUT);
            let sessions = (self.watched.sessions)();
            {
                let mut last = self.last.lock();
                (last.stuck, last.sessions, last.at) = (stuck, sessions, now);
            }
            if now >= probe_due {
                probe_due = now + PROBE_INTERVAL;
                for (i, probe) in probes.iter().enumerate() {
                    let result = probe.try_once();
                    if result.is_err() {
                        probe_due = now + PROBE_RETRY;
                    }
                    self.last.lock().probes[i].record(result);
                }
            }
            let reasons = self.reasons();
            if reasons.is_empty() != is_healthy {
                is_healthy = reasons.is_empty();
                let reasons: Vec<String> = reasons.iter().map(ToString::to_string).collect();
                match is_healthy {
                    true => info!("healthy again"),
                    false => warn!(reasons = reasons.join("; "), "unhealthy"),
                }
            }
        }
    }

    /// The number of the task that each busy thread executes.
    fn tasks(&self) -> Vec<(Worker, u64)> {
        let (swarms, _) = self.watched.registry.handles();
        let swarms = swarms.into_iter().filter_map(|(name, handle)| {
            let task = handle.metrics.activity.task()?;
            Some((Worker::Swarm(name), task))
        });
        let threads = self.watched.threads.iter();
        let threads = threads.filter_map(|(name, it)| Some((Worker::Thread(name), it.task()?)));
        swarms.chain(threads).chain(self.store_task()).collect()
    }

    /// While writes are queued, the task of the store is the next commit.
    fn store_task(&self) -> Option<(Worker, u64)> {
        let health = self.watched.store.health();
        // A store that cannot write is reported as such.
        let is_busy = health.waiting > 0 && !health.is_full && !health.is_failing;
        is_busy.then_some((Worker::Thread("store"), health.commits))
    }
}
