//! The paper's claims, each compared with the results of runs.
//!
//! A claim is judged on the runs of one contact rule and time step. The verdict follows from the
//! measured numbers by the claim's criterion, which is the same for every rule.

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

/// The result of judging a claim on the runs of one rule.
#[derive(Clone, Debug, PartialEq)]
pub struct ClaimResult {
    /// The measured values, with standard errors.
    pub measured: String,
    /// The verdict that follows from them.
    pub verdict: Verdict,
}

impl ClaimResult {
    /// The result of a claim for which runs are missing.
    fn no_runs() -> Self {
        Self {
            measured: "no such runs".to_owned(),
            verdict: Verdict::NoData,
        }
    }
}

/// One claim of the paper.
#[derive(Clone, Copy)]
pub struct Claim {
    /// The number of the claim in the paper's order, and a letter for each of its parts.
    pub name: &'static str,
    /// The claim, paraphrased.
    pub statement: &'static str,
    /// The condition under which it holds.
    pub criterion: &'static str,
    /// Judges the claim.
    pub judge: fn(&Evidence) -> ClaimResult,
}

/// Returns every claim, in the paper's order.
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

/// Formats a number with its standard error, rounded to the error's second significant digit.
fn with_error(value: f64, error: Option<f64>) -> String {
    let Some(error) = error.filter(|error| *error > 0.0 && error.is_finite()) else {
        return format!("{value:.3}");
    };
    let digits = (1.0 - libm::log10(error).floor()).clamp(0.0, 5.0);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "from 0 to 5"
    )]
    let digits = digits as usize;
    format!("{value:.digits$} ± {error:.digits$}")
}

/// Returns the standard error of a difference of independent means; `None` if either is unknown.
fn of_difference(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    Some(libm::hypot(one?, other?))
}

/// Returns the case that `one` is at most `times` times `other`. It does not divide, since `other`
/// may be near 0.
fn at_most(times: f64, one: Spread, other: Spread) -> Case {
    let error = of_difference(one.error, other.error.map(|error| times * error));
    Case::new(times * other.mean - one.mean, error)
}

/// Returns the ratio of two independent means, and its standard error.
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
    fn the_standard_error_sets_the_number_of_digits() {
        assert_eq!(with_error(0.123_456, Some(0.0123)), "0.123 ± 0.012");
        assert_eq!(with_error(12.345, Some(1.23)), "12.3 ± 1.2");
        assert_eq!(with_error(1234.5, Some(123.0)), "1234 ± 123");
        assert_eq!(with_error(0.5, None), "0.500");
    }

    #[test]
    fn claims_have_unique_names_and_no_verdict_without_runs() {
        let evidence = Evidence::default();
        let mut names = Vec::new();
        for claim in claims() {
            assert_eq!(
                (claim.judge)(&evidence).verdict,
                Verdict::NoData,
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
