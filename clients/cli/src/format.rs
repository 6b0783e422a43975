//! Numbers as people read them.

use jostle_proto::Phase;

/// What stands where there is no number.
pub const NONE: &str = "-";

/// The wire's word for a phase.
pub fn phase(phase: Phase) -> &'static str {
    match phase {
        Phase::Paused => "paused",
        Phase::Running => "running",
        Phase::Faulted => "faulted",
    }
}

/// A time, without digits nobody asked for.
pub fn time(time: f64) -> String {
    let digits = format!("{time:.4}");
    digits.trim_end_matches('0').trim_end_matches('.').into()
}

/// A rate: `max` is as fast as possible.
pub fn rate(rate: Option<f64>) -> String {
    rate.map_or_else(|| "max".into(), |rate| rate.to_string())
}

/// A speed or an order, to three decimals; never `-0.000`.
pub fn share(share: Option<f64>) -> String {
    share.map_or_else(
        || NONE.into(),
        |share| {
            let text = format!("{share:.3}");
            if text == "-0.000" {
                "0.000".into()
            } else {
                text
            }
        },
    )
}

/// How fast a swarm lately ran, to three digits.
pub fn factor(factor: Option<f64>) -> String {
    factor.map_or_else(
        || NONE.into(),
        |factor| {
            let decimals = match factor.abs() {
                size if size < 10.0 => 2,
                size if size < 100.0 => 1,
                _ => 0,
            };
            format!("{factor:.decimals$}")
        },
    )
}

/// A gap or a residual, of which the magnitude tells most.
pub fn magnitude(number: Option<f64>) -> String {
    number.map_or_else(|| NONE.into(), |number| format!("{number:.1e}"))
}

/// A bar of `width` characters for a number from 0 to 1.
pub fn bar(share: f64, width: usize) -> String {
    const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];
    let steps = width * EIGHTHS.len();
    // Counting up keeps clear of a cast, and a NaN draws nothing.
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

/// Numbers as `--ids` reads them.
pub fn ids(ids: &[u32]) -> String {
    let ids: Vec<String> = ids.iter().map(u32::to_string).collect();
    ids.join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_carry_no_empty_digits() {
        assert_eq!(time(0.0), "0");
        assert_eq!(time(0.06), "0.06");
        assert_eq!(time(100.0), "100");
        assert_eq!(time(12.000_000_1), "12");
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
