//! The daemon in numbers, as they are now.

use std::fs;
use std::thread;

use rustix::time::{ClockId, clock_gettime};

use crate::health::{Bus, Reason, RecordingCounts, Warning, Watch};
use crate::store;
use crate::swarm::frame::Summary;
use crate::swarm::tally::{LastStep, Totals};

/// The daemon in numbers.
#[derive(Clone, Debug)]
pub struct Figures {
    /// Seconds since it started.
    pub uptime_secs: f64,
    /// Why not all is well; nothing if it is.
    pub reasons: Vec<Reason>,
    /// What is wrong without keeping it from its work.
    pub warnings: Vec<Warning>,
    /// Seconds that its threads have computed.
    pub cpu_secs: f64,
    /// Cores it may use.
    pub cores: usize,
    /// Memory in use.
    pub resident_bytes: u64,
    /// Memory set aside for the swarms.
    pub reserved_bytes: u64,
    /// Its threads.
    pub threads: u64,
    /// Clients connected.
    pub sessions: usize,
    /// How long its own listener took to answer; nothing if it did not, or was not asked yet.
    pub probe_secs: Option<f64>,
    /// Whether zenoh takes queries.
    pub bus: Bus,
    /// Of all swarms since it started, those that are gone too.
    pub totals: Totals,
    /// Names that another daemon holds, too.
    pub contested: usize,
    /// How the store is doing.
    pub store: store::Health,
    /// The daemon's recordings.
    pub recordings: RecordingCounts,
    /// The bytes of all recordings, and those that they may have.
    pub recordings_bytes: (u64, u64),
    /// Every swarm that is built, ordered by name.
    pub swarms: Vec<SwarmFigures>,
}

/// A swarm in numbers.
#[derive(Clone, Debug)]
pub struct SwarmFigures {
    /// Its name.
    pub name: String,
    /// What it is doing.
    pub summary: Summary,
    /// What has been counted of it since it is hosted here.
    pub totals: Totals,
    /// How its last step was.
    pub last: LastStep,
}

impl Watch {
    /// The daemon in numbers. No swarm is asked: it is read what they count.
    pub fn figures(&self) -> Figures {
        let (handles, mut totals) = self.watched.host.handles();
        let mut swarms = Vec::with_capacity(handles.len());
        for (name, handle) in handles {
            let own = handle.totals();
            totals.add(&own);
            if let Some(summary) = handle.summary() {
                swarms.push(SwarmFigures {
                    name,
                    summary,
                    totals: own,
                    last: handle.tally.last_step(),
                });
            }
        }
        let (resident_bytes, threads) = process();
        let (sessions, probe_secs) = {
            let seen = self.seen();
            let heard = seen.hearing.iter().filter(|it| it.failures == 0);
            (
                seen.sessions,
                heard.filter_map(|it| it.secs).reduce(f64::max),
            )
        };
        let cpu = clock_gettime(ClockId::ProcessCPUTime);
        Figures {
            uptime_secs: self.uptime().as_secs_f64(),
            reasons: self.reasons(),
            warnings: self.warnings(),
            cpu_secs: cpu.tv_sec as f64 + cpu.tv_nsec as f64 * 1e-9,
            cores: thread::available_parallelism().map_or(1, usize::from),
            resident_bytes,
            reserved_bytes: self.watched.host.memory_bytes(),
            threads,
            sessions,
            probe_secs,
            bus: (self.watched.bus)(),
            totals,
            contested: (self.watched.contested)().len(),
            store: self.watched.store.health(),
            recordings: (self.watched.recordings)(),
            recordings_bytes: (self.watched.recordings_bytes)(),
            swarms,
        }
    }
}

/// Memory in use, in bytes, and threads, as the kernel tells; 0 where it does not.
fn process() -> (u64, u64) {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let number = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name));
        let word = line.and_then(|line| line.split_whitespace().next());
        word.and_then(|word| word.parse::<u64>().ok()).unwrap_or(0)
    };
    (number("VmRSS:") * 1024, number("Threads:"))
}
