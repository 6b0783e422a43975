//! What a daemon answers on `get/metrics`: itself and its swarms in numbers.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Phase;

/// Metrics of a daemon; counters begin when it starts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Metrics {
    /// Seconds since it started.
    pub uptime_secs: f64,
    /// The reasons why it is unhealthy, for people; empty if it is healthy.
    pub unwell: Vec<String>,
    /// Problems that do not stop its work, for people, such as a failed recording; empty if there
    /// are none.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// CPU seconds of its threads.
    pub cpu_secs: f64,
    /// Number of cores that it may use.
    pub cores: u64,
    /// Memory in use, bytes.
    pub memory_bytes: u64,
    /// Number of connected clients.
    pub sessions: u64,
    /// Number of steps of all swarms, also of deleted ones.
    pub steps: u64,
    /// Seconds that these steps took.
    pub step_secs: f64,
    /// Number of failed steps; each stops its swarm.
    pub faults: u64,
    /// Number of steps that missed the target residual, but were acceptable.
    pub degraded: u64,
    /// The largest residual of a step, body sizes.
    pub residual_max: f64,
    /// Number of states for publication.
    pub frames: u64,
    /// Number of states that a newer one replaced before publication.
    pub frames_dropped: u64,
    /// Number of names, the daemon's and its swarms', that another daemon has too.
    #[serde(default)]
    pub contested: u64,
    /// The database.
    pub store: StoreMetrics,
    /// The recordings.
    #[serde(default)]
    pub recordings: RecordingMetrics,
    /// Bytes of all recordings on disk.
    #[serde(default)]
    pub recordings_bytes: u64,
    /// The limit of these bytes: running recordings end at it, and none begins.
    #[serde(default)]
    pub recordings_quota_bytes: u64,
    /// Bytes of all experiments on disk; `null` from an earlier daemon.
    #[serde(default)]
    pub experiments_bytes: Option<u64>,
    /// The limit of these bytes, at which the running experiment is paused, and none begins; `null`
    /// if there is none.
    #[serde(default)]
    pub experiments_quota_bytes: Option<u64>,
    /// Every swarm, ordered by name.
    pub swarms: Vec<SwarmMetrics>,
}

/// The database of a daemon.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StoreMetrics {
    /// Number of commits since the daemon started.
    pub commits: u64,
    /// Seconds that they took, with their syncs.
    pub commit_secs: f64,
    /// Seconds that the last one took.
    pub last_commit_secs: f64,
    /// Number of queued writes.
    pub waiting: u64,
    /// Bytes on disk.
    pub disk_bytes: u64,
    /// Whether the disk is full.
    pub full: bool,
    /// Whether writing fails for another reason.
    pub failing: bool,
    /// Whether the queue exceeds its memory limit.
    pub overrun: bool,
}

/// Numbers of a daemon's recordings, by phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordingMetrics {
    /// Number of running recordings.
    pub recording: u64,
    /// Number of ended recordings.
    pub ended: u64,
    /// Number of failed recordings.
    pub failed: u64,
}

/// Metrics of a swarm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SwarmMetrics {
    /// The swarm's name.
    pub swarm: String,
    /// The phase of the swarm.
    pub phase: Phase,
    /// Number of steps since the start.
    pub step: u64,
    /// The size of the group.
    pub n: u64,
    /// Time units per second of wall clock; `null` is as fast as possible.
    pub rate: Option<f64>,
    /// The rate that it reached lately; `null` while it does not run.
    pub real_time_factor: Option<f64>,
    /// Number of steps since the daemon loaded it.
    pub steps: u64,
    /// Seconds that these steps took.
    pub step_secs: f64,
    /// Number of these steps that had a due time.
    pub due_steps: u64,
    /// Seconds that they began after their due times.
    pub late_secs: f64,
    /// Number of contacts of the last step.
    pub contacts: u64,
    /// Residual of the last step, body sizes.
    pub residual: f64,
    /// Number of steps that missed the target residual, but were acceptable.
    pub degraded: u64,
    /// Number of failed steps.
    pub faults: u64,
}
