//! The daemon of jostle: hosts swarms of bodies that only push each other.
//!
//! Each layer may name those before it; `tests/architecture/layers.rs` checks that:
//!
//! 1. [`metrics`]
//! 2. [`swarm`], [`store`], [`auth`]
//! 3. [`audit`], [`convert`], [`persistence`], [`playback`], `recording`, `experiments`, `jobs`, [`health`],
//!    [`backup`], [`config`]
//! 4. [`api`]: requests of clients
//! 5. [`transport`]: zenoh and HTTP
//! 6. [`app`]: start and stop; [`doctor`]: what a start would do
//! 7. [`cli`]: the subcommands of `jostled`
//!
//! The path of a command: [`transport`] receives a query, [`api`] parses and checks it, the swarm's
//! thread ([`swarm`]) executes it between two steps, and the reply returns the same way.

// `# Errors` sections are for functions whose error type does not say enough.
#![allow(clippy::missing_errors_doc)]

pub mod api;
pub mod app;
pub mod audit;
pub mod auth;
pub mod backup;
pub mod cli;
pub mod config;
pub mod convert;
pub mod doctor;
mod experiments;
mod failpoint;
pub mod health;
mod jobs;
pub mod lanes;
pub mod metrics;
pub mod persistence;
pub mod playback;
mod recording;
pub mod store;
pub mod suspension;
pub mod swarm;
pub mod transport;
