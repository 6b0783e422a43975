//! What the paper reports, each claim beside what runs say of it.
//!
//! A claim is asked of the runs of one contact rule and time step. Its verdict follows from the
//! numbers by the criterion that stands beside it, the same for every rule.

mod animations;
pub mod bands;
mod drift;
mod evidence;
mod intervals;
mod order;
pub mod page;
mod verdict;

pub use evidence::{Evidence, Rule, rules};
pub use verdict::Verdict;

use crate::statistics::Spread;
use verdict::{Case, counts};

/// What the runs of one rule say of a claim.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// What was measured, with standard errors.
    pub measured: String,
    /// What follows.
    pub verdict: Verdict,
}

impl Answer {
    fn untold() -> Self {
        Self {
            measured: "no such runs".to_owned(),
            verdict: Verdict::Untold,
        }
    }
}

/// One claim of the paper.
#[derive(Clone, Copy)]
pub struct Claim {
    /// Its number in the list of claims, and a letter for each of its parts.
    pub name: &'static str,
    /// What the paper says, in our words.
    pub says: &'static str,
    /// When it holds.
    pub criterion: &'static str,
    /// Asks it.
    pub ask: fn(&Evidence) -> Answer,
}

/// Every claim, in the paper's order.
#[must_use]
pub fn claims() -> Vec<Claim> {
    [
        &order::CLAIMS[..],
        &intervals::CLAIMS,
        &drift::CLAIMS,
        &animations::CLAIMS,
    ]
    .concat()
}

/// A number with its standard error, rounded to the error's second digit.
fn with_error(value: f64, error: Option<f64>) -> String {
    let Some(error) = error.filter(|error| *error > 0.0 && error.is_finite()) else {
        return format!("{value:.3}");
    };
    let digits = (1.0 - error.log10().floor()).clamp(0.0, 5.0);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "from 0 to 5"
    )]
    let digits = digits as usize;
    format!("{value:.digits$} ± {error:.digits$}")
}

/// The standard error of a difference of independent means; unknown if either is.
fn of_difference(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    Some(one?.hypot(other?))
}

/// Whether one mean is at most so many times another: without a division, since the other may be near 0.
fn at_most(times: f64, one: Spread, other: Spread) -> Case {
    let error = of_difference(one.error, other.error.map(|error| times * error));
    Case::new(times * other.mean - one.mean, error)
}

/// The ratio of two independent means, and its standard error.
fn ratio(one: Spread, other: Spread) -> (f64, Option<f64>) {
    let ratio = one.mean / other.mean;
    let relative = |spread: Spread| spread.error.map(|error| error / spread.mean);
    let error = of_difference(relative(one), relative(other));
    (ratio, error.map(|error| (ratio * error).abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_decide_how_many_digits_are_shown() {
        assert_eq!(with_error(0.123_456, Some(0.0123)), "0.123 ± 0.012");
        assert_eq!(with_error(12.345, Some(1.23)), "12.3 ± 1.2");
        assert_eq!(with_error(1234.5, Some(123.0)), "1234 ± 123");
        assert_eq!(with_error(0.5, None), "0.500");
    }

    #[test]
    fn without_runs_nothing_is_told_and_names_are_used_once() {
        let evidence = Evidence::default();
        let mut names = Vec::new();
        for claim in claims() {
            assert_eq!(
                (claim.ask)(&evidence).verdict,
                Verdict::Untold,
                "{}",
                claim.name
            );
            names.push(claim.name);
        }
        assert!(names.is_sorted(), "{names:?}");
        names.dedup();
        assert_eq!(names.len(), claims().len());
    }
}
