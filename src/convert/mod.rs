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

pub mod commands;
mod controllers;
mod decode;
pub mod digest;
pub mod durable;
pub mod error;
mod events;
mod experiments;
mod figures;
mod payload;
mod recordings;
mod replies;
mod states;
pub mod validate;

pub use controllers::controllers;
pub use decode::{decode_event, decode_spec, decode_state};
pub use events::{event, events, journal};
pub use experiments::{order_page, progress, results_page};
pub use figures::metrics;
pub use payload::Payload;
pub use recordings::{recording, recording_piece, recordings};
pub use replies::{created, outcome, reply};
pub use states::{limits, order_sample, parameters, replay, state, status, summary};
