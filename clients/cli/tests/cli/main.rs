//! Tests of the binary `jostle` against a daemon in this process.

#![expect(clippy::unwrap_used, reason = "tests")]

mod audit;
mod bounds;
mod charts;
mod claims;
mod contract;
mod doctor;
mod exits;
mod experiments;
mod exporting;
mod fetching;
mod forking;
mod inspect;
mod live;
mod lost;
mod options;
mod paged;
mod recording;
mod recovering;
mod remains;
mod requests;
mod rights;
mod sending;
mod shell;
mod signals;
mod stdout;
mod support;
mod terminal;
mod top;
mod verbs;
mod verifying;
