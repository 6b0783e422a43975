//! What a daemon answers on `get/metrics`: itself and its swarms in numbers.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Phase;

/// A node's answer to `get/metrics`. What grows for ever is counted since the daemon started; two
/// looks tell what came in between.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Metrics {
    /// Seconds since the daemon started.
    pub uptime_secs: f64,
    /// Why not all is well, for people; empty if it is.
    pub unwell: Vec<String>,
    /// What is wrong without keeping it from its work, such as a recording that has failed, for
    /// people; empty if nothing is.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// Seconds its threads have computed.
    pub cpu_secs: f64,
    /// Cores it may use.
    pub cores: u64,
    /// Memory in use, in bytes.
    pub memory_bytes: u64,
    /// Clients connected.
    pub sessions: u64,
    /// Steps taken by all swarms there ever were.
    pub steps: u64,
    /// Seconds that these steps took.
    pub step_secs: f64,
    /// Steps that failed; each stops its swarm.
    pub faults: u64,
    /// Steps that missed the target residual, yet were good enough to go on.
    pub degraded: u64,
    /// The largest residual of a step, in body sizes.
    pub residual_max: f64,
    /// States made to be published.
    pub frames: u64,
    /// States that gave way to a newer one before they were published.
    pub frames_dropped: u64,
    /// Names of the daemon and its swarms that another daemon holds, too.
    #[serde(default)]
    pub contested: u64,
    /// How the daemon's memory on disk does.
    pub store: StoreMetrics,
    /// The recordings it has made or makes.
    #[serde(default)]
    pub recordings: RecordingMetrics,
    /// What all recordings take on disk, in bytes.
    #[serde(default)]
    pub recordings_bytes: u64,
    /// What they may take, in bytes: those that go on end there, and none begins.
    #[serde(default)]
    pub recordings_quota_bytes: u64,
    /// What all experiments take on disk, in bytes; earlier daemons do not count it.
    #[serde(default)]
    pub experiments_bytes: Option<u64>,
    /// What they may take, in bytes: the one that goes on is paused there, and none begins; `null` if
    /// they may take the whole disk.
    #[serde(default)]
    pub experiments_quota_bytes: Option<u64>,
    /// Every swarm, ordered by name.
    pub swarms: Vec<SwarmMetrics>,
}

/// How a daemon's memory on disk does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StoreMetrics {
    /// Commits.
    pub commits: u64,
    /// Seconds that all commits took, their syncs included.
    pub commit_secs: f64,
    /// Seconds that the last one took.
    pub last_commit_secs: f64,
    /// Writes that wait.
    pub waiting: u64,
    /// What it takes on disk, in bytes.
    pub disk_bytes: u64,
    /// Whether the disk is full.
    pub full: bool,
    /// Whether writing fails otherwise.
    pub failing: bool,
    /// Whether more waits than should be kept in memory.
    pub overrun: bool,
}

/// A daemon's recordings, counted by what they do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordingMetrics {
    /// Those that go on.
    pub recording: u64,
    /// Those that have ended.
    pub ended: u64,
    /// Those that have failed.
    pub failed: u64,
}

/// A swarm in numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SwarmMetrics {
    /// Its name.
    pub swarm: String,
    /// What it is doing.
    pub phase: Phase,
    /// The number of steps since the start.
    pub step: u64,
    /// The number of individuals.
    pub n: u64,
    /// Time units per second of wall clock; `null` is as fast as possible.
    pub rate: Option<f64>,
    /// Time units per second of wall clock it lately ran at; `null` while it does not run.
    pub real_time_factor: Option<f64>,
    /// Steps taken since it is hosted here.
    pub steps: u64,
    /// Seconds that these steps took.
    pub step_secs: f64,
    /// How many of them were due at a time.
    pub due_steps: u64,
    /// Seconds that they began after they were due.
    pub late_secs: f64,
    /// Contacts of its last step.
    pub contacts: u64,
    /// Residual of its last step, in body sizes.
    pub residual: f64,
    /// Steps that missed the target residual, yet were good enough to go on.
    pub degraded: u64,
    /// Steps that failed.
    pub faults: u64,
}
