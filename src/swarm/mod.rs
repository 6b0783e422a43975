//! One hosted swarm, or a recording played as one: its phases, its thread and how to reach it. Knows no zenoh.

pub mod checkpoint;
pub mod command;
pub mod controllers;
pub mod error;
mod failpoint;
pub mod frame;
pub mod handle;
pub mod history;
pub mod journal;
pub mod membership;
pub mod metrics;
pub mod output;
pub mod phase;
pub mod registry;
pub mod runner;
pub mod schedule;
pub mod scheduler;
pub mod sender;
pub mod waiters;
pub mod worker;
