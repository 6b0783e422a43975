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

use std::fmt;

pub use evidence::{Evidence, Rule, rules};

/// What is made of a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The criterion is met.
    Holds,
    /// It is met for some of what the claim speaks of.
    InPart,
    /// It is not.
    Fails,
    /// The runs do not tell.
    Untold,
}

impl Verdict {
    /// Of `all` cases so many are met.
    fn of_cases(met: usize, all: usize) -> Self {
        match met {
            _ if all == 0 => Self::Untold,
            0 => Self::Fails,
            _ if met == all => Self::Holds,
            _ => Self::InPart,
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Holds => "holds",
            Self::InPart => "holds in part",
            Self::Fails => "does not hold",
            Self::Untold => "not told",
        })
    }
}

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
fn of_difference(one: Option<f64>, other: Option<f64>) -> f64 {
    match (one, other) {
        (Some(one), Some(other)) => one.hypot(other),
        _ => f64::INFINITY,
    }
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
    fn some_of_many_is_in_part() {
        let verdicts = [0, 2, 3].map(|met| Verdict::of_cases(met, 3));
        assert_eq!(verdicts, [Verdict::Fails, Verdict::InPart, Verdict::Holds]);
        assert_eq!(Verdict::of_cases(0, 0), Verdict::Untold);
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
