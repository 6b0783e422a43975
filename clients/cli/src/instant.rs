//! Parses points in time, as `audit --since` has them.

use std::time::{SystemTime, UNIX_EPOCH};

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// Parses an instant: a duration before now, such as `2h`, or a time in UTC or with its offset, such as
/// `2026-11-28T07:00`. Returns seconds since 1970.
pub fn parse(text: &str) -> Result<f64, String> {
    let now = || SystemTime::now().duration_since(UNIX_EPOCH);
    if let (Ok(ago), Ok(now)) = (humantime::parse_duration(text), now()) {
        return Ok(now.saturating_sub(ago).as_secs_f64());
    }
    let with_offset = text.parse::<Timestamp>().ok();
    let in_utc = || {
        let time = text.parse::<DateTime>().ok()?;
        Some(time.to_zoned(TimeZone::UTC).ok()?.timestamp())
    };
    with_offset
        .or_else(in_utc)
        .map(|it| it.as_duration().as_secs_f64())
        .filter(|secs| *secs >= 0.0)
        .ok_or_else(|| {
            format!(
                "`{text}` is neither a duration, such as 2h or 3d, nor a time since 1970, such as \
                 2026-11-28T07:00"
            )
        })
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn an_instant_is_a_time_in_utc_or_a_duration_before_now() {
        for (text, secs) in [
            ("1970-01-01", 0.0),
            ("2026-11-24T14:40:01.25Z", 1_795_531_201.25),
            ("2026-11-24 14:40:01Z", 1_795_531_201.0),
            ("2026-11-24 15:40:01+01:00", 1_795_531_201.0),
            ("2026-11-24T14:40", 1_795_531_200.0),
            ("2026-11-24 14:40", 1_795_531_200.0),
            ("2026-11-24", 1_795_478_400.0),
        ] {
            assert_eq!(parse(text), Ok(secs), "{text}");
        }
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
        for (text, secs) in [
            ("90s", 90.0),
            ("30min", 1800.0),
            ("2h", 7200.0),
            ("3d", 259_200.0),
        ] {
            let ago = now.as_secs_f64() - parse(text).unwrap();
            assert!((ago - secs).abs() < 60.0, "{text}: {ago}");
        }
        for text in [
            "",
            "2",
            "yesterday",
            "-2h",
            "2026-13-01",
            "07:00",
            "1969-12-31",
        ] {
            assert!(parse(text).is_err(), "{text:?}");
        }
    }
}
