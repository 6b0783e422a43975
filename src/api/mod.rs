//! Requests of clients: permission, idempotency, deadlines, execution and replies.
//!
//! A transport passes each request to [`Context::handle`](context::Context::handle). A handler in
//! [`commands`] or [`queries`] parses it, sends a message to a swarm or a task to a lane, and
//! replies by a [`Responder`](responder::Responder).

pub mod admission;
mod audit;
pub mod commands;
pub mod context;
pub mod idempotency;
pub mod incoming;
pub mod queries;
pub mod responder;
pub mod verifications;
