//! The command line as a shell meets it: the real binary against a daemon in this process.

#![expect(clippy::unwrap_used, reason = "tests")]

mod copies;
mod doctor;
mod experiments;
mod live;
mod looking;
mod lost;
mod sending;
mod shell;
mod support;
mod top;
mod verbs;
