//! Tests of the Rust client against a daemon.

#![expect(clippy::unwrap_used, reason = "tests")]

mod controller;
#[path = "../../clients/rust/examples_daemon.rs"]
mod daemon;
mod follow;
