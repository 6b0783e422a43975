//! The current metrics of the daemon.

use std::fs;
use std::sync::Arc;
use std::thread;

use rustix::time::{ClockId, clock_gettime};

use crate::experiments::DiskUsage;
use crate::health::{Bus, HealthMonitor, Reason, RecordingCounts};
use crate::lanes;
use crate::store;
use crate::swarm::frame::{Frame, Summary};
use crate::swarm::metrics::{LastStep, Totals};

/// The metrics of the daemon.
#[derive(Clone, Debug)]
pub struct DaemonMetrics {
    /// Seconds since it started.
    pub uptime_secs: f64,
    /// Why the daemon is unhealthy; empty if it is healthy.
    pub reasons: Vec<Reason>,
    /// Problems with which it stays healthy.
    pub warnings: Vec<String>,
    /// CPU time in seconds.
    pub cpu_secs: f64,
    /// Cores that it may use.
    pub cores: usize,
    /// Resident memory.
    pub resident_bytes: u64,
    /// Memory reserved for swarms and the running experiment.
    pub reserved_bytes: u64,
    /// Memory reserved for the running experiment.
    pub experiments_reserved_bytes: u64,
    /// Its threads.
    pub threads: u64,
    /// Connected clients.
    pub sessions: usize,
    /// Response time of its slowest listener; `None` before the first successful probe.
    pub probe_secs: Option<f64>,
    /// Whether zenoh is blocked.
    pub bus: Bus,
    /// Sums over all swarms since it started, including deleted ones.
    pub totals: Totals,
    /// Swarms that are not recovered yet.
    pub recovering: usize,
    /// Names that another daemon uses too.
    pub contested: usize,
    /// The begin of the last day of the daemon's certificate in seconds since 1970, if it has one.
    pub certificate_end: Option<i64>,
    /// The health of the store.
    pub store: store::Health,
    /// The size of the audit log.
    pub audit: store::AuditSize,
    /// The number of recordings by phase.
    pub recordings: RecordingCounts,
    /// The size of all recordings and its limit, in bytes.
    pub recordings_bytes: (u64, u64),
    /// The size of all experiments and its limit.
    pub experiments: DiskUsage,
    /// Its lanes.
    pub lanes: Vec<lanes::Status>,
    /// Requests that a defect dropped without a reply.
    pub dropped_requests: u64,
    /// Each swarm that is built, ordered by name.
    pub swarms: Vec<PerSwarmMetrics>,
}

/// The metrics of a swarm.
#[derive(Clone, Debug)]
pub struct PerSwarmMetrics {
    /// Its name.
    pub name: String,
    /// Its summary.
    pub summary: Summary,
    /// Its totals since it was loaded.
    pub totals: Totals,
    /// Its last step.
    pub last: LastStep,
    /// A recent state, if it publishes measures.
    pub measured: Option<Arc<Frame>>,
}

impl HealthMonitor {
    /// The current metrics. Reads counters; sends no message to a swarm.
    pub fn metrics(&self) -> DaemonMetrics {
        let (handles, mut totals) = self.watched.registry.handles();
        let mut swarms = Vec::with_capacity(handles.len());
        for (name, handle) in handles {
            let own = handle.totals();
            totals.add(&own);
            if let Some(summary) = handle.summary() {
                swarms.push(PerSwarmMetrics {
                    name,
                    summary,
                    totals: own,
                    last: handle.metrics.last_step(),
                    measured: handle.metrics.measured(),
                });
            }
        }
        let (resident_bytes, threads) = process();
        let (sessions, probe_secs) = {
            let last = self.last.lock();
            let probes = last.probes.iter().filter(|it| it.failures == 0);
            let slowest = probes.filter_map(|it| it.secs).reduce(f64::max);
            (last.sessions, slowest)
        };
        let recordings = &self.watched.recordings;
        let cpu = clock_gettime(ClockId::ProcessCPUTime);
        DaemonMetrics {
            uptime_secs: self.uptime().as_secs_f64(),
            reasons: self.reasons(),
            warnings: self.warnings().into_iter().map(|it| it.1).collect(),
            cpu_secs: cpu.tv_sec as f64 + cpu.tv_nsec as f64 * 1e-9,
            cores: thread::available_parallelism().map_or(1, usize::from),
            resident_bytes,
            reserved_bytes: self.watched.registry.memory_bytes(),
            experiments_reserved_bytes: self.watched.registry.experiments_memory_bytes(),
            threads,
            sessions,
            probe_secs,
            bus: (self.watched.bus)(),
            totals,
            recovering: self.watched.recovery.swarms_left().unwrap_or(0),
            contested: (self.watched.contested)().len(),
            certificate_end: self.watched.rights.current().end_unix_secs(),
            store: self.watched.store.health(),
            recordings: (self.watched.count)(recordings),
            recordings_bytes: recordings.usage(),
            // A store that cannot be read is reported elsewhere.
            audit: self.watched.store.audit_size().unwrap_or_default(),
            experiments: self.watched.experiments.disk_usage(),
            lanes: self.watched.lanes.status().to_vec(),
            dropped_requests: (self.watched.dropped_requests)(),
            swarms,
        }
    }
}

/// Resident memory in bytes and the number of threads; 0 if the kernel does not report them.
fn process() -> (u64, u64) {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let number = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name));
        let word = line.and_then(|line| line.split_whitespace().next());
        word.and_then(|word| word.parse::<u64>().ok()).unwrap_or(0)
    };
    (number("VmRSS:") * 1024, number("Threads:"))
}
