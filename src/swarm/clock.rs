//! The wall clock, for times in the journal and in events. No result depends on it, and no hash
//! contains it.

use std::time::{SystemTime, UNIX_EPOCH};

/// Seconds since 1970, UTC, to the millisecond; `None` if the clock is before 1970.
pub fn unix_secs() -> Option<f64> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    Some(since.as_millis() as f64 / 1000.0)
}
