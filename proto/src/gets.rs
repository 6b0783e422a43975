//! What the `get` keys answer.

use serde::{Deserialize, Serialize};

use crate::{Certificate, Order, ParameterValues, Phase};

/// A swarm's answer to `get/status`; phase, step and time are in the envelope.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Why it is paused or faulted.
    pub reason: Option<String>,
    /// The step it will pause at.
    pub until_step: Option<u64>,
    /// Time units per second of wall clock; `null` is as fast as possible.
    pub rate: Option<f64>,
    /// Time units per second of wall clock it lately ran at; `null` while it does not run.
    pub real_time_factor: Option<f64>,
    /// The size of the group.
    pub n: u64,
    /// How many of it are informed.
    pub informed: u64,
    /// The seed of every draw.
    pub seed: u64,
    /// The time step.
    pub dt: f64,
    /// The parameters that may change while it lives.
    pub parameters: ParameterValues,
    /// BLAKE3 of the state, in hexadecimal.
    pub state_hash: String,
    /// Order and drift.
    pub order: Order,
    /// How exact the state is.
    pub certificate: Certificate,
}

/// A node's answer to `get/hello`: who is there and what it takes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// The daemon's version.
    pub version: String,
    /// The version of the contract it speaks.
    pub wire_version: u32,
    /// The limits it enforces.
    pub limits: Limits,
}

/// What a daemon refuses to go beyond.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Individuals in one swarm.
    pub max_individuals: u64,
    /// Swarms at once.
    pub max_swarms: u64,
    /// Memory of all swarms together, in bytes.
    pub max_memory_bytes: u64,
    /// The largest payload, in bytes; larger ones vanish on the way.
    pub max_message_bytes: u64,
    /// States published per second and swarm.
    pub max_hz: u64,
}

/// A node's answer to `get/status`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NodeStatus {
    /// Seconds since the daemon started.
    pub uptime_secs: f64,
    /// Swarms it hosts.
    pub swarms: u64,
    /// How many of them run.
    pub running: u64,
    /// How many of them faulted.
    pub faulted: u64,
    /// Individuals in all swarms together.
    pub individuals: u64,
    /// Memory set aside for the swarms, in bytes.
    pub memory_bytes: u64,
    /// Clients connected.
    pub clients: u64,
}

/// A node's answer to `get/swarms`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Swarms {
    /// All it hosts, ordered by name.
    pub swarms: Vec<SwarmSummary>,
}

/// A swarm in a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SwarmSummary {
    /// Its name.
    pub swarm: String,
    /// What it is doing.
    pub phase: Phase,
    /// Why it is paused or faulted.
    pub reason: Option<String>,
    /// The number of steps since the start.
    pub step: u64,
    /// `step · dt`.
    pub time: f64,
    /// The size of the group.
    pub n: u64,
    /// How many of it are informed.
    pub informed: u64,
    /// The polar order parameter.
    pub order: f64,
    /// Time units per second of wall clock; `null` is as fast as possible.
    pub rate: Option<f64>,
    /// Time units per second of wall clock it lately ran at; `null` while it does not run.
    pub real_time_factor: Option<f64>,
}
