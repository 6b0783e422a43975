//! What is attached to a published state: its times, and the set-points in it.

use std::collections::BTreeMap;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a daemon attaches to a published state, in CBOR: times of its clock, and set-points.
///
/// It is no part of the state, so that equal states have equal bytes. If the clock is set back in
/// between, the second time is the earlier.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Attachment {
    /// When the step that led to the state was taken, nanoseconds since 1970, UTC; `null` if the
    /// daemon does not know: before the first step, after a reset or a restart until the next one,
    /// and in a playback.
    pub stepped_unix_nanos: Option<u64>,
    /// When the daemon published the state, nanoseconds since 1970, UTC; `null` in a recording by
    /// the daemon.
    pub published_unix_nanos: Option<u64>,
    /// The numbers of the newest set-points in the state, the `sequence` of each put, by
    /// controller. Controllers in lock-step have none.
    pub sequences: BTreeMap<String, u64>,
}

impl Attachment {
    /// Writes it as CBOR.
    #[must_use]
    pub fn to_cbor(&self) -> Vec<u8> {
        crate::to_cbor(self)
    }

    /// Reads it from CBOR.
    ///
    /// # Errors
    ///
    /// What is wrong with `bytes`.
    pub fn from_cbor(bytes: &[u8]) -> Result<Self, String> {
        ciborium::from_reader(bytes).map_err(|error| error.to_string())
    }

    /// `stepped_unix_nanos` as a time.
    #[must_use]
    pub fn stepped_at(&self) -> Option<SystemTime> {
        self.stepped_unix_nanos.map(time)
    }

    /// `published_unix_nanos` as a time.
    #[must_use]
    pub fn published_at(&self) -> Option<SystemTime> {
        self.published_unix_nanos.map(time)
    }
}

/// A time in nanoseconds since 1970; `None` if the clock is before 1970.
#[must_use]
pub fn unix_nanos(time: SystemTime) -> Option<u64> {
    let since = time.duration_since(UNIX_EPOCH).ok()?;
    u64::try_from(since.as_nanos()).ok()
}

fn time(unix_nanos: u64) -> SystemTime {
    UNIX_EPOCH + Duration::from_nanos(unix_nanos)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn times_are_read_back_to_the_nanosecond() {
        let nanos = 1_795_531_201_250_000_001;
        let attachment = Attachment {
            stepped_unix_nanos: Some(nanos),
            published_unix_nanos: None,
            sequences: BTreeMap::from([("ada".to_owned(), 7)]),
        };
        let read = Attachment::from_cbor(&attachment.to_cbor()).unwrap();
        assert_eq!(read, attachment);
        assert_eq!(read.stepped_at().and_then(unix_nanos), Some(nanos));
        assert_eq!(read.published_at(), None);
        assert_eq!(unix_nanos(UNIX_EPOCH - Duration::from_nanos(1)), None);
    }

    #[test]
    fn a_later_version_may_add_fields() {
        let later = serde_json::json!({
            "stepped_unix_nanos": null, "published_unix_nanos": 1, "sequences": {}, "of_later": [1],
        });
        let read = Attachment::from_cbor(&crate::to_cbor(&later)).unwrap();
        assert_eq!(
            (read.published_unix_nanos, read.sequences.len()),
            (Some(1), 0)
        );
        assert!(Attachment::from_cbor(b"").is_err());
    }
}
