//! Tests that need the machine for themselves: they count lost states, memory, threads or shares of the
//! cores, or load every core. nextest runs each of them alone (`.config/nextest.toml`); with cargo it is
//! `cargo test --release --test measured -- --test-threads=1`.

#![expect(clippy::unwrap_used, reason = "tests")]

mod abuse;
mod conditions;
mod crash;
mod idle_http;
mod load;
mod memory;
mod overload;
mod page;
mod process;
mod recording;
mod series;
mod soak;
mod stolen;
mod streams;
mod supervisor;
#[path = "../support/mod.rs"]
mod support;
