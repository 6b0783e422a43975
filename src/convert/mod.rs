//! Conversions between messages and the types of the daemon. No other module converts them.

/// Converts an enum of the daemon to the one of the messages with the same variants, and back.
macro_rules! same_variants {
    ($ours:ty, $message:ty: $($variant:ident),+) => {
        impl From<$message> for $ours {
            fn from(it: $message) -> Self {
                match it {
                    $(<$message>::$variant => Self::$variant,)+
                }
            }
        }

        impl From<$ours> for $message {
            fn from(it: $ours) -> Self {
                match it {
                    $(<$ours>::$variant => Self::$variant,)+
                }
            }
        }
    };
}

mod audit;
pub mod commands;
mod controllers;
mod decode;
pub mod digest;
pub mod durable;
pub mod error;
mod events;
mod experiments;
mod measures;
mod metrics;
mod payload;
mod recordings;
mod replies;
mod states;
pub mod validate;

pub(crate) use audit::audit;
pub(crate) use controllers::controllers;
pub(crate) use decode::{decode_event, decode_spec, decode_state};
pub(crate) use events::{event, events, journal};
pub(crate) use experiments::{
    expanded, order_page, planned, progress, results_page, series_page, trajectory_page,
};
pub(crate) use measures::measures;
pub(crate) use metrics::metrics;
pub(crate) use payload::Payload;
pub(crate) use recordings::{recording, recording_piece, recordings};
pub(crate) use replies::{created, outcome, reply};
pub(crate) use states::{
    attachment, limits, order_sample, origin, parameters, phase, present, replay, state, status,
    summary,
};
