//! Numbers, durations, commands and other values as text.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use jostle_proto::{LARGEST_WHOLE, Origin, OriginKind, Phase, Reply};
use serde_json::Value;

/// The text for a missing value.
pub const NONE: &str = "-";

/// A value, or the text for a missing one.
pub fn or_none(value: Option<impl ToString>) -> String {
    value.map_or_else(|| NONE.into(), |value| value.to_string())
}

/// A text of another client, whose characters that are not printable are escaped.
pub fn printable(text: &str) -> String {
    let mut printable = String::with_capacity(text.len());
    for char in text.chars() {
        match char {
            '"' | '\'' | '\\' => printable.push(char),
            char => printable.extend(char.escape_debug()),
        }
    }
    printable
}

/// A phase with its reason.
pub fn phase(phase: Phase, reason: Option<&str>) -> String {
    let name = phase.name();
    reason.map_or_else(|| name.into(), |reason| format!("{name} ({reason})"))
}

/// What a swarm was made from; `None` of a playback, whose position says it.
pub fn origin(origin: &Origin) -> Option<String> {
    let from = match origin.kind {
        OriginKind::Fork => "by fork from",
        OriginKind::Restore => "from a snapshot of",
        OriginKind::Play => return None,
    };
    let swarm = origin.swarm.as_deref().map_or("a swarm".into(), printable);
    Some(format!("{from} {swarm} at step {}", origin.step))
}

/// Phase, step and time of a swarm.
pub fn position<T>(reply: &Reply<T>) -> String {
    let phase = reply.phase.name();
    format!("{phase} at step {}, time {}", reply.step, time(reply.time))
}

/// A swarm with its phase, step and time.
pub fn standing<T>(reply: &Reply<T>) -> String {
    format!("{} is {}", reply.swarm, position(reply))
}

/// A simulated time, rounded to the digits that a step can have.
pub fn time(time: f64) -> String {
    let digits = fixed(time, 4);
    digits.trim_end_matches('0').trim_end_matches('.').into()
}

/// A wall-clock time in seconds since 1970, in RFC 3339, UTC, to the millisecond.
pub fn when(unix_secs: Option<f64>) -> String {
    or_none(time_of(unix_secs).map(humantime::format_rfc3339_millis))
}

/// A wall-clock time as [`when`] has it, to the second.
pub fn when_secs(unix_secs: f64) -> String {
    or_none(time_of(Some(unix_secs)).map(humantime::format_rfc3339_seconds))
}

fn time_of(unix_secs: Option<f64>) -> Option<SystemTime> {
    /// The last millisecond of the year 9999.
    const END: f64 = 253_402_300_799.999;
    let secs = unix_secs.filter(|secs| (0.0..END).contains(secs))?;
    // Truncated to a millisecond.
    let since = Duration::try_from_secs_f64(secs + 0.0005).ok()?;
    Some(UNIX_EPOCH + since)
}

/// A rate: `max` is as fast as possible.
pub fn rate(rate: Option<f64>) -> String {
    let written = |rate: f64| match rate {
        1e-4..1e7 => rate.to_string(),
        _ => format!("{rate:e}"),
    };
    rate.map_or_else(|| "max".into(), written)
}

/// A number with so many decimals; never `-0.000`.
pub fn fixed(value: f64, decimals: usize) -> String {
    unsigned_zero(format!("{value:.decimals$}"))
}

/// Removes the sign of a number that is zero as written.
fn unsigned_zero(text: String) -> String {
    let is_zero = |digits: &str| digits.bytes().all(|byte| b"0.e".contains(&byte));
    match text.strip_prefix('-') {
        Some(digits) if is_zero(digits) => digits.to_owned(),
        _ => text,
    }
}

/// A speed or an order, to three decimals.
pub fn share(share: Option<f64>) -> String {
    or_none(share.map(|share| fixed(share, 3)))
}

/// A share in percent.
pub fn percent(share: f64) -> String {
    format!("{} %", fixed(100.0 * share, 0))
}

/// A real-time factor, to three digits.
pub fn factor(factor: Option<f64>) -> String {
    or_none(factor.map(|factor| {
        let decimals = match factor.abs() {
            size if size < 10.0 => 2,
            size if size < 100.0 => 1,
            _ => 0,
        };
        fixed(factor, decimals)
    }))
}

/// A gap or a residual, in scientific notation.
pub fn magnitude(number: Option<f64>) -> String {
    or_none(number.map(|number| unsigned_zero(format!("{number:.1e}"))))
}

/// A number in its shortest form, a large one in powers of ten.
pub fn number(number: f64) -> String {
    if number.to_bits() == (LARGEST_WHOLE as f64).to_bits() {
        "2^53-1".into()
    } else if number.abs() >= 1e6 && (number / 1e6).fract() == 0.0 {
        format!("{number:e}")
    } else {
        unsigned_zero(number.to_string())
    }
}

/// A number to so many significant digits, at least one; a small one in powers of ten.
pub fn rounded(value: f64, digits: usize) -> String {
    /// Numbers below this are in powers of ten.
    const SMALL: f64 = 1e-4;
    let decimals = digits.saturating_sub(1);
    let rounded: f64 = format!("{value:.decimals$e}").parse().unwrap_or(value);
    if rounded != 0.0 && rounded.abs() < SMALL {
        return format!("{rounded:e}");
    }
    number(rounded)
}

/// A duration in its two largest units.
pub fn duration(secs: f64) -> String {
    const UNITS: [(f64, &str); 4] = [(86_400.0, "d"), (3600.0, "h"), (60.0, "min"), (1.0, "s")];
    let whole = secs.max(0.0).floor();
    let Some(largest) = UNITS.iter().position(|(size, _)| whole >= *size) else {
        return "0 s".into();
    };
    let (size, unit) = UNITS[largest];
    let first = format!("{} {unit}", (whole / size).floor());
    match UNITS.get(largest + 1) {
        Some((small, unit)) => format!("{first} {} {unit}", (whole % size / small).floor()),
        None => first,
    }
}

/// A short duration.
pub fn millis(secs: f64) -> String {
    let millis = secs * 1e3;
    match millis.abs() {
        size if size < 10.0 => format!("{} ms", fixed(millis, 2)),
        size if size < 1000.0 => format!("{millis:.0} ms"),
        _ => format!("{secs:.1} s"),
    }
}

/// A number of bytes with a binary unit.
pub fn bytes(bytes: u64) -> String {
    const UNITS: [&str; 4] = ["B", "KiB", "MiB", "GiB"];
    let (mut size, mut unit) = (bytes as f64, 0);
    while size >= 1024.0 && unit + 1 < UNITS.len() {
        size /= 1024.0;
        unit += 1;
    }
    if unit == 0 || size >= 100.0 {
        format!("{size:.0} {}", UNITS[unit])
    } else {
        format!("{size:.1} {}", UNITS[unit])
    }
}

/// A command in one line: its verb and its arguments. Long arguments are truncated, a note is not.
pub fn command(verb: &str, args: &Value) -> String {
    const LONGEST: usize = 100;
    if let ("annotate", Some(text @ Value::String(_))) = (verb, args.get("text")) {
        return format!("{verb} {text}");
    }
    let mut line = String::from(verb);
    match (verb, args) {
        ("batch", Value::Object(fields)) => {
            let changes = fields.get("commands").and_then(Value::as_array);
            for (index, change) in changes.into_iter().flatten().enumerate() {
                line.push_str(if index == 0 { ": " } else { "; " });
                let verb = change["verb"].as_str().unwrap_or(NONE);
                line.push_str(&command(verb, &change["args"]));
            }
        }
        (_, Value::Object(fields)) => {
            for (name, value) in fields {
                line.push_str(&format!(" {name}={value}"));
            }
        }
        (_, Value::Null) => {}
        (_, other) => line.push_str(&format!(" {other}")),
    }
    match line.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &line[..end]),
        None => line,
    }
}

/// A bar of `width` characters for a number from 0 to 1.
pub fn bar(share: f64, width: usize) -> String {
    const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];
    let steps = width * EIGHTHS.len();
    // Counting avoids a cast; a NaN draws nothing.
    let reached = (1..=steps)
        .take_while(|&step| step as f64 <= (share * steps as f64).round())
        .count();
    let (full, part) = (reached / EIGHTHS.len(), EIGHTHS[reached % EIGHTHS.len()]);
    let empty = width - full - usize::from(!part.is_empty());
    format!("{}{part}{}", "█".repeat(full), "░".repeat(empty))
}

/// `1 step`, `2 steps`.
pub fn count(count: u64, one: &str) -> String {
    if count == 1 {
        format!("{count} {one}")
    } else {
        format!("{count} {one}s")
    }
}

/// Ids in the form of `--ids`.
pub fn ids(ids: &[u32]) -> String {
    let ids: Vec<String> = ids.iter().map(u32::to_string).collect();
    ids.join(",")
}

/// A parameter's value in the form of an option.
pub fn value(value: &Value, is_nullable: bool) -> String {
    match value {
        // Only the rate may be null.
        Value::Null if is_nullable => "max".into(),
        Value::Null => NONE.into(),
        Value::String(word) => word.clone(),
        Value::Object(choice) => match choice.get("kind").and_then(Value::as_str) {
            Some(kind) => {
                // A law, in the form of `--attraction`.
                let numbers = choice.values().filter_map(Value::as_f64);
                numbers.fold(kind.into(), |text, it| format!("{text}={}", number(it)))
            }
            None => value.to_string(),
        },
        Value::Number(it) => it.as_f64().map_or_else(|| it.to_string(), number),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn rounded_numbers_have_so_many_digits() {
        for (value, six, three) in [
            (0.0, "0", "0"),
            (1.0, "1", "1"),
            (-0.000_000_012_345_678, "-1.23457e-8", "-1.23e-8"),
            (0.123_456_789, "0.123457", "0.123"),
            (228.607_786_9, "228.608", "229"),
            (22.0, "22", "22"),
        ] {
            assert_eq!([rounded(value, 6), rounded(value, 3)], [six, three]);
        }
    }

    #[test]
    fn times_have_no_trailing_zeros() {
        assert_eq!(time(0.0), "0");
        assert_eq!(time(0.06), "0.06");
        assert_eq!(time(100.0), "100");
        assert_eq!(time(12.000_000_1), "12");
    }

    #[test]
    fn wall_clock_times_are_rfc_3339_and_unknown_ones_empty() {
        assert_eq!(when(Some(1_795_531_201.25)), "2026-11-24T14:40:01.250Z");
        assert_eq!(when(Some(1_764_000_000.123)), "2025-11-24T16:00:00.123Z");
        assert_eq!(when(Some(0.0)), "1970-01-01T00:00:00.000Z");
        assert_eq!(when_secs(1_795_531_201.25), "2026-11-24T14:40:01Z");
        assert_eq!(when_secs(f64::NAN), "-");
        assert_eq!(when(Some(253_402_300_799.0)), "9999-12-31T23:59:59.000Z");
        for unknown in [
            None,
            Some(f64::NAN),
            Some(f64::INFINITY),
            Some(-1.0),
            Some(1e300),
            Some(253_402_300_800.0),
        ] {
            assert_eq!(when(unknown), "-", "{unknown:?}");
        }
    }

    #[test]
    fn a_text_of_a_client_cannot_forge_a_line_or_move_the_cursor() {
        assert_eq!(printable("ada's \"desk\" \u{e9}"), "ada's \"desk\" \u{e9}");
        let text = "a\nb\u{1b}[2J\u{9b}2J\u{202e}c";
        assert_eq!(printable(text), "a\\nb\\u{1b}[2J\\u{9b}2J\\u{202e}c");
    }

    #[test]
    fn a_bar_has_its_width_whatever_the_number() {
        for share in [0.0, 0.01, 0.5, 0.999, 1.0, 1.0 + 1e-12, 7.0, -1.0, f64::NAN] {
            assert_eq!(bar(share, 10).chars().count(), 10, "{share}");
        }
        assert_eq!(bar(0.5, 4), "██░░");
        assert_eq!(bar(1.0, 2), "██");
        assert_eq!(bar(0.0, 2), "░░");
    }

    #[test]
    fn sizes_have_the_unit_that_fits() {
        assert_eq!(number(1e6), "1e6");
        assert_eq!(number(LARGEST_WHOLE as f64), "2^53-1");
        assert_eq!(number(0.02), "0.02");
        assert_eq!(number(12_345_678.0), "12345678");
        assert_eq!(duration(0.4), "0 s");
        assert_eq!(duration(61.0), "1 min 1 s");
        assert_eq!(duration(90_000.0), "1 d 1 h");
        assert_eq!(millis(0.000_25), "0.25 ms");
        assert_eq!(millis(-0.25), "-250 ms");
        assert_eq!(millis(3.0), "3.0 s");
        assert_eq!(bytes(512), "512 B");
        assert_eq!(bytes(1536), "1.5 KiB");
        assert_eq!(bytes(1 << 30), "1.0 GiB");
    }

    #[test]
    fn a_zero_has_no_sign() {
        for zero in [-0.0, -1e-9] {
            assert_eq!(fixed(zero, 2), "0.00");
            assert_eq!(share(Some(zero)), "0.000");
            assert_eq!(percent(zero), "0 %");
            assert_eq!(time(zero), "0");
            assert_eq!(factor(Some(zero)), "0.00");
            assert_eq!(millis(zero * 1e-3), "0.00 ms");
        }
        assert_eq!(number(-0.0), "0");
        assert_eq!(rounded(-0.0, 3), "0");
        assert_eq!(magnitude(Some(-0.0)), "0.0e0");
        assert_eq!(percent(-0.006), "-1 %");
        assert_eq!(fixed(f64::NEG_INFINITY, 2), "-inf");
    }

    #[test]
    fn a_command_fits_a_line() {
        assert_eq!(command("pause", &json!({})), "pause");
        assert_eq!(
            command("inform", &json!({"select": {"count": 5}, "direction": 0})),
            r#"inform direction=0 select={"count":5}"#
        );
        let change = json!({"verb": "set", "args": {"pi3": 2}});
        assert_eq!(
            command("batch", &json!({"commands": [change, change]})),
            "batch: set pi3=2; set pi3=2"
        );
        let long = command("inform", &json!({"select": {"ids": vec![7; 1000]}}));
        assert_eq!(long.chars().count(), 101);
        let note = command("annotate", &json!({"text": "\u{e9}\"".repeat(500)}));
        assert_eq!(note.chars().count(), "annotate ".len() + 2 + 1500);
        assert!(long.ends_with('…'));
    }

    #[test]
    fn numbers_keep_the_digits_that_matter() {
        assert_eq!(share(Some(-1e-9)), "0.000");
        assert_eq!(share(None), "-");
        assert_eq!(factor(Some(0.98)), "0.98");
        assert_eq!(factor(Some(1234.5)), "1234");
        assert_eq!(magnitude(Some(-1.23e-11)), "-1.2e-11");
        assert_eq!(rate(None), "max");
        assert_eq!(rate(Some(2.0)), "2");
        assert_eq!(count(1, "step"), "1 step");
        assert_eq!(count(0, "step"), "0 steps");
        assert_eq!(ids(&[3, 1]), "3,1");
    }
}
