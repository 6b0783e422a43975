//! Requests of clients: permission, idempotency, deadlines, execution and replies.

pub mod commands;
pub mod context;
mod copies;
mod deadlines;
pub mod error;
pub mod experiments;
mod handlers;
pub mod idempotency;
pub mod pagination;
pub mod queries;
pub mod recordings;
mod replays;
pub mod responder;
mod verifications;
