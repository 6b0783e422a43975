//! Durations on the command line.

use std::time::Duration;

/// Thirty years, so that sums of times and durations do not overflow.
const MAX_DURATION: Duration = Duration::from_secs(1_000_000_000);

/// Parses `20s`, `5m`, `1.5h` or a plain number of seconds.
pub fn parse(text: &str) -> Result<Duration, String> {
    let (number, unit) = match text.find(|c: char| c.is_ascii_alphabetic()) {
        Some(at) => text.split_at(at),
        None => (text, "s"),
    };
    let secs = match unit {
        "ms" => 1e-3,
        "s" => 1.0,
        "m" => 60.0,
        "h" => 3600.0,
        _ => return Err(format!("invalid unit {unit:?}: use ms, s, m or h")),
    };
    let number: f64 = number
        .parse()
        .map_err(|_| format!("invalid number {number:?}"))?;
    Duration::try_from_secs_f64(number * secs)
        .ok()
        .filter(|duration| !duration.is_zero() && *duration <= MAX_DURATION)
        .ok_or_else(|| format!("invalid duration {text:?}: use one above 0 and below 30 years"))
}

/// A duration in its largest unit.
pub fn text(secs: f64) -> String {
    match secs {
        secs if secs < 90.0 => format!("{secs:.0} s"),
        secs if secs < 5400.0 => format!("{:.0} min", secs / 60.0),
        secs => format!("{:.1} h", secs / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_read_with_their_unit() {
        assert_eq!(parse("20s"), Ok(Duration::from_secs(20)));
        assert_eq!(parse("20"), Ok(Duration::from_secs(20)));
        assert_eq!(parse("1.5h"), Ok(Duration::from_secs(5400)));
        assert_eq!(parse("250ms"), Ok(Duration::from_millis(250)));
        for bad in [
            "",
            "s",
            "-1s",
            "0s",
            "1d",
            "nan",
            "1e400s",
            "inf",
            "1000000000h",
        ] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }
}
