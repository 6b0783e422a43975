//! The verdict on a claim from measured cases.

use std::fmt;

/// The number of standard errors beyond which a difference counts.
pub(super) const ERRORS: f64 = 2.0;

/// The verdict on a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// All cases meet the criterion.
    Holds,
    /// At least half of the cases meet it, and the mean of all cases is on the claim's side.
    InPart,
    /// Fewer than half of the cases meet it, or the mean of all cases is on the other side.
    Fails,
    /// The verdict depends on cases within two standard errors of the limit.
    Undecided,
    /// The runs that the claim refers to are missing.
    NoData,
}

/// One condition of a claim: the distance of the measured value from the limit in standard errors,
/// positive on the claim's side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Case(f64);

impl Case {
    /// Creates a case from the value's distance from the limit, positive on the claim's side, and
    /// its standard error. Without a standard error, as for a single run, the case counts as being
    /// at the limit.
    pub fn new(margin: f64, error: Option<f64>) -> Self {
        let errors = margin / error.unwrap_or(f64::INFINITY);
        // 0 / 0: the value is exactly at the limit.
        Case(if errors.is_nan() { 0.0 } else { errors })
    }

    /// Creates a case without statistical uncertainty, which meets the criterion or misses it.
    pub fn sure(is_met: bool) -> Self {
        Case(if is_met {
            f64::INFINITY
        } else {
            f64::NEG_INFINITY
        })
    }

    /// Combines two cases, both of which must meet the criterion.
    pub fn and(self, other: Self) -> Self {
        Case(self.0.min(other.0))
    }

    pub fn is_met(self) -> bool {
        self.0 > ERRORS
    }

    pub fn is_missed(self) -> bool {
        self.0 < -ERRORS
    }
}

/// Describes how many cases meet the criterion, and how many are too near to its limit to decide.
pub(super) fn counts(cases: &[Case]) -> String {
    let met = cases.iter().filter(|case| case.is_met()).count();
    let missed = cases.iter().filter(|case| case.is_missed()).count();
    match cases.len() - met - missed {
        0 => format!("{met} of {}", cases.len()),
        near => format!("{met} of {}, {near} within {ERRORS} errors", cases.len()),
    }
}

impl Verdict {
    /// Returns the verdict on `cases`. `mean_agrees` is whether the mean over all cases is on the
    /// claim's side.
    pub(super) fn of(cases: &[Case], mean_agrees: bool) -> Self {
        if cases.is_empty() {
            return Self::NoData;
        }
        let with_met = |met: usize| match met {
            _ if met == cases.len() => Self::Holds,
            _ if 2 * met >= cases.len() && mean_agrees => Self::InPart,
            _ => Self::Fails,
        };
        let met = cases.iter().filter(|case| case.is_met()).count();
        let not_missed = cases.iter().filter(|case| !case.is_missed()).count();
        let (least, most) = (with_met(met), with_met(not_missed));
        match least == most {
            true => least,
            false => Self::Undecided,
        }
    }

    /// Returns the verdict on `cases`, with the mean of their margins as the mean over all cases.
    pub(super) fn of_cases(cases: &[Case]) -> Self {
        // The margin of a sure case is infinite: then the majority decides instead of the mean.
        let mean_agrees = match cases.iter().all(|case| case.0.is_finite()) {
            true => cases.iter().map(|case| case.0).sum::<f64>() > 0.0,
            false => 2 * cases.iter().filter(|case| case.0 > 0.0).count() >= cases.len(),
        };
        Self::of(cases, mean_agrees)
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Holds => "holds",
            Self::InPart => "holds in part",
            Self::Fails => "does not hold",
            Self::Undecided => "undecided",
            Self::NoData => "no data",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(errors: &[f64]) -> Verdict {
        let cases: Vec<Case> = errors.iter().map(|it| Case::new(*it, Some(1.0))).collect();
        Verdict::of_cases(&cases)
    }

    #[test]
    fn all_hold_half_hold_in_part_and_fewer_fail() {
        assert_eq!(of(&[3.0, 4.0, 5.0, 6.0]), Verdict::Holds);
        assert_eq!(of(&[3.0, 4.0, -3.0, 6.0]), Verdict::InPart);
        assert_eq!(of(&[3.0, 9.0, -3.0, -4.0]), Verdict::InPart);
        assert_eq!(of(&[3.0, -4.0, -3.0, 4.0, -4.0]), Verdict::Fails);
        assert_eq!(of(&[30.0, -4.0, -3.0]), Verdict::Fails);
        assert_eq!(of(&[-3.0]), Verdict::Fails);
        assert_eq!(of(&[]), Verdict::NoData);
    }

    #[test]
    fn a_contrary_mean_excludes_holding_in_part() {
        assert_eq!(of(&[3.0, 4.0, -30.0, 4.0]), Verdict::Fails);
        let cases = [1.0, 1.0, 1.0, 0.0].map(|it| Case::sure(it > 0.0));
        assert_eq!(Verdict::of(&cases, true), Verdict::InPart);
        assert_eq!(Verdict::of(&cases, false), Verdict::Fails);
    }

    #[test]
    fn a_verdict_that_depends_on_cases_within_two_errors_is_undecided() {
        assert_eq!(of(&[1.9]), Verdict::Undecided);
        assert_eq!(of(&[-1.9]), Verdict::Undecided);
        assert_eq!(of(&[2.1]), Verdict::Holds);
        assert_eq!(of(&[3.0, 3.0, 3.0, 1.0]), Verdict::Undecided);
        // With or without the third, at least half hold, but not all.
        assert_eq!(of(&[3.0, 3.0, 1.0, -3.0]), Verdict::InPart);
        assert_eq!(of(&[1.0, -3.0, -3.0, -3.0]), Verdict::Fails);
        // Without a standard error no case is clear.
        assert_eq!(
            Verdict::of_cases(&[Case::new(5.0, None)]),
            Verdict::Undecided
        );
        assert_eq!(
            Verdict::of_cases(&[Case::new(0.0, Some(0.0))]),
            Verdict::Undecided
        );
    }

    #[test]
    fn both_conditions_of_a_case_count() {
        let case = Case::new(5.0, Some(1.0));
        assert!(case.and(Case::new(3.0, Some(1.0))).is_met());
        assert!(case.and(Case::sure(false)).is_missed());
        assert_eq!(
            counts(&[case, case.and(Case::new(1.0, Some(1.0)))]),
            "1 of 2, 1 within 2 errors"
        );
        assert_eq!(counts(&[case, Case::sure(false)]), "1 of 2");
    }
}
