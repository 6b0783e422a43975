//! The command line as a shell meets it: the real binary against a daemon in this process.

#![expect(clippy::unwrap_used, reason = "tests")]

mod claims;
mod copies;
mod doctor;
mod exits;
mod experiments;
mod fetching;
mod live;
mod looking;
mod lost;
mod options;
mod recording;
mod requests;
mod rights;
mod sending;
mod shell;
mod signals;
mod support;
mod terminal;
mod top;
mod verbs;
