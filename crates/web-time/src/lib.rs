//! Takes the place of crates.io's `web-time`, which asks JavaScript for the time and so gives a wasm
//! module imports. Only clarabel names it, on wasm targets, to measure its solve time; its time limit
//! is infinite, so that no result depends on the clock.

pub use std::time::Duration;

/// An instant of a machine without a clock.
#[derive(Clone, Copy, Debug)]
pub struct Instant;

impl Instant {
    /// The present instant, which equals every other.
    #[must_use]
    pub const fn now() -> Self {
        Self
    }

    /// The time since this instant: none.
    #[must_use]
    pub const fn elapsed(&self) -> Duration {
        Duration::ZERO
    }
}
