//! Between what crosses the wire and what the daemon works with: here, and nowhere else.

pub mod commands;
pub mod digest;
pub mod durable;
pub mod error;
mod experiments;
mod figures;
mod from_proto;
mod recorded;
mod recordings;
pub mod sanity;
mod to_proto;

pub use experiments::{order_page, progress, results_page};
pub use figures::metrics;
pub use from_proto::{control, mode, on_timeout};
pub use recorded::{recorded, recorded_event, recorded_frame};
pub use recordings::{recording, recording_piece, recordings};
pub use to_proto::{
    Payload, WordRefusal, controllers, created, event, events, journal, limits, order_sample,
    outcome, parameters, replay, reply, state, status, summary,
};
