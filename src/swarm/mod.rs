//! One hosted swarm, or a recording played as one: its phases, its thread and how to reach it. Knows no zenoh.

pub mod awaited;
pub mod checkpoint;
pub mod command;
mod controllers;
pub mod error;
pub(crate) mod fault;
pub mod frame;
pub mod handle;
pub(crate) mod history;
pub mod journal;
pub(crate) mod membership;
pub mod metrics;
pub(crate) mod output;
pub mod phase;
pub mod recovery_progress;
pub mod registry;
pub mod runner;
pub(crate) mod schedule;
pub mod scheduler;
pub mod sender;
pub(crate) mod waiters;
pub mod waits;
pub mod watch;
pub(crate) mod worker;
