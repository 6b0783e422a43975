//! Tests of the daemon through its interfaces: real sessions on loopback, real swarms, no mocks.

#![expect(clippy::unwrap_used, reason = "tests")]

mod abuse;
mod annotate;
mod audit;
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
mod experiment_space;
mod experiments;
mod harness;
mod health;
mod history;
mod idle_http;
mod journal;
mod lanes;
mod limits;
mod load;
mod measures;
mod once;
mod operator;
mod page;
mod pages;
mod parts;
mod process;
mod protocols;
mod readers;
mod recording;
mod recovering;
mod repeat;
mod replay;
mod rights;
mod schedule;
mod settings;
mod states;
mod stdout;
mod stored;
mod streams;
mod supervisor;
#[path = "../support/mod.rs"]
mod support;
mod targets;
mod unclean_ends;
mod verify;
mod waits;
mod wall_clock;
mod when;
