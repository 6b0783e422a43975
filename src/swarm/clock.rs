//! The wall clock, for the journal and events: when something happened, for people to read. Nothing
//! is computed from it, and no hash contains it.

use std::time::{SystemTime, UNIX_EPOCH};

/// Seconds since 1970, UTC, to the millisecond; `None` if the clock stands before 1970.
pub fn unix_secs() -> Option<f64> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    Some(since.as_millis() as f64 / 1000.0)
}
