//! The daemon as its clients meet it: real sessions on loopback, real swarms, nothing mocked.

#![expect(clippy::unwrap_used, reason = "tests")]

mod abuse;
mod apart;
mod architecture;
mod backup;
mod changes;
mod claim;
mod codes;
mod commands;
mod contested;
mod contract;
mod controllers;
mod copies;
mod corpora;
mod crash;
mod experiment;
mod experiments;
mod harness;
mod health;
mod history;
mod idle_http;
mod limits;
mod load;
mod once;
mod overload;
mod page;
mod pages;
mod process;
mod readers;
mod recording;
mod repeat;
mod replay;
mod rights;
mod schedule;
mod settings;
mod soak;
mod states;
mod stored;
mod streams;
mod supervisor;
mod support;
mod targets;
mod verify;
mod version;
mod wall_clock;
