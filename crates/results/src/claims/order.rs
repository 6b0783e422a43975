//! Claims 1 and 2: the order of groups without preferences (Figure 2).

use super::{
    Case, Claim, ClaimResult, Evidence, Verdict, at_most, counts, of_difference, ratio, with_error,
};
use crate::disorder::v_ind;

/// The values of `pi1` that the paper's claims about elongated bodies refer to.
pub(super) const ELONGATED: [f64; 2] = [4.0, 8.0];

pub(super) const CLAIMS: [Claim; 5] = [
    Claim {
        name: "1a",
        statement: "Discs (π1 = 1): v tends to be under v_ind(n).",
        criterion: "v is below v_ind(n) at every n",
        judge: discs_are_below_chance,
    },
    Claim {
        name: "1b",
        statement: "For discs v rises with n while n < 10.",
        criterion: "v at n = 7 is above v at n = 3",
        judge: discs_rise,
    },
    Claim {
        name: "2a",
        statement: "π1 = 4 and 8: almost perfect order for n ≤ 10.",
        criterion: "v ≥ 0.9 at every n ≤ 10",
        judge: almost_perfect,
    },
    Claim {
        name: "2b",
        statement: "The curves of π1 = 4 and 8 are close to one another.",
        criterion: "neither v is more than 1.25 times the other at any n",
        judge: close_to_each_other,
    },
    Claim {
        name: "2c",
        statement: "π1 = 4 and 8: significant order up to n = 74.",
        criterion: "v at n = 74 is above v_ind(74) for both values of π1",
        judge: order_at_74,
    },
];

fn discs_are_below_chance(evidence: &Evidence) -> ClaimResult {
    let discs = evidence.uninformed(1.0);
    if discs.is_empty() {
        return ClaimResult::no_runs();
    }
    let cases: Vec<Case> = discs
        .iter()
        .map(|it| Case::new(v_ind(it.condition.n) - it.v.mean, it.v.error))
        .collect();
    let shares: Vec<String> = discs
        .iter()
        .map(|it| {
            let chance = v_ind(it.condition.n);
            let share = with_error(it.v.mean / chance, it.v.error.map(|error| error / chance));
            format!("{share} (n = {})", it.condition.n)
        })
        .collect();
    ClaimResult {
        measured: format!("v / v_ind = {}", shares.join(", ")),
        verdict: Verdict::of_cases(&cases),
    }
}

fn discs_rise(evidence: &Evidence) -> ClaimResult {
    let (Some(three), Some(seven)) = (evidence.one(1.0, 3), evidence.one(1.0, 7)) else {
        return ClaimResult::no_runs();
    };
    let error = of_difference(three.v.error, seven.v.error);
    let rises = Case::new(seven.v.mean - three.v.mean, error);
    let steps = evidence.uninformed(1.0).into_iter();
    let steps: Vec<String> = steps
        .filter(|it| it.condition.n < 10)
        .map(|it| with_error(it.v.mean, it.v.error))
        .collect();
    ClaimResult {
        measured: format!("v = {} at n = 3, 5, 7", steps.join(", ")),
        verdict: Verdict::of_cases(&[rises]),
    }
}

fn almost_perfect(evidence: &Evidence) -> ClaimResult {
    let few = ELONGATED.map(|pi1| evidence.uninformed(pi1)).concat();
    let few: Vec<_> = few.iter().filter(|it| it.condition.n <= 10).collect();
    let Some(least) = few.iter().min_by(|a, b| a.v.mean.total_cmp(&b.v.mean)) else {
        return ClaimResult::no_runs();
    };
    let cases = few.iter().map(|it| Case::new(it.v.mean - 0.9, it.v.error));
    let cases: Vec<Case> = cases.collect();
    ClaimResult {
        measured: format!(
            "least v = {} (π1 = {}, n = {}); at 0.9 or more: {}",
            with_error(least.v.mean, least.v.error),
            least.condition.pi1,
            least.condition.n,
            counts(&cases)
        ),
        verdict: Verdict::of_cases(&cases),
    }
}

fn close_to_each_other(evidence: &Evidence) -> ClaimResult {
    let (mut cases, mut furthest) = (Vec::new(), None);
    let apart = |ratio: f64| f64::max(ratio, 1.0 / ratio);
    for four in evidence.uninformed(4.0) {
        let n = four.condition.n;
        let Some(eight) = evidence.one(8.0, n) else {
            continue;
        };
        cases.push(at_most(1.25, eight.v, four.v).and(at_most(1.25, four.v, eight.v)));
        let (value, error) = ratio(eight.v, four.v);
        if furthest.is_none_or(|(_, other, _)| apart(value) > apart(other)) {
            furthest = Some((n, value, error));
        }
    }
    let Some((n, value, error)) = furthest else {
        return ClaimResult::no_runs();
    };
    ClaimResult {
        measured: format!(
            "v(π1 = 8) / v(π1 = 4) = {} at n = {n}, where it is furthest from 1; within 1.25: {}",
            with_error(value, error),
            counts(&cases)
        ),
        verdict: Verdict::of_cases(&cases),
    }
}

fn order_at_74(evidence: &Evidence) -> ClaimResult {
    let chance = v_ind(74);
    let (mut cases, mut orders) = (Vec::new(), Vec::new());
    for pi1 in ELONGATED {
        let Some(it) = evidence.one(pi1, 74) else {
            return ClaimResult::no_runs();
        };
        cases.push(Case::new(it.v.mean - chance, it.v.error));
        orders.push(format!(
            "{} (π1 = {pi1})",
            with_error(it.v.mean, it.v.error)
        ));
    }
    ClaimResult {
        measured: format!("v = {}; v_ind(74) = {chance:.4}", orders.join(", ")),
        verdict: Verdict::of_cases(&cases),
    }
}
