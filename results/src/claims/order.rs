//! Claims 1 and 2: how ordered groups without preferences are (Figure 2).

use super::{Answer, Claim, Evidence, Verdict, of_difference, with_error};
use crate::disorder::v_ind;

/// The lengths over widths of which the paper speaks as elongated.
pub(super) const ELONGATED: [f64; 2] = [4.0, 8.0];

/// How many standard errors make a difference.
pub(super) const ERRORS: f64 = 2.0;

pub(super) const CLAIMS: [Claim; 5] = [
    Claim {
        name: "1a",
        says: "Discs (π1 = 1): v tends to be under v_ind(n).",
        criterion: "v below v_ind by 2 standard errors at every n; in part: at some",
        ask: discs_are_below_chance,
    },
    Claim {
        name: "1b",
        says: "For discs v rises with n while n < 10.",
        criterion: "v at n = 7 above v at n = 3 by 2 standard errors",
        ask: discs_rise,
    },
    Claim {
        name: "2a",
        says: "π1 = 4 and 8: almost perfect order for n ≤ 10.",
        criterion: "v ≥ 0.9 at every n ≤ 10; in part: at some",
        ask: almost_perfect,
    },
    Claim {
        name: "2b",
        says: "The curves of π1 = 4 and 8 are close to one another.",
        criterion: "neither more than 1.25 times the other at any n; in part: at most n",
        ask: close_to_each_other,
    },
    Claim {
        name: "2c",
        says: "π1 = 4 and 8: significant order up to n = 74.",
        criterion: "v above v_ind(74) by 2 standard errors for both; in part: for one",
        ask: order_at_74,
    },
];

fn discs_are_below_chance(evidence: &Evidence) -> Answer {
    let discs = evidence.uninformed(1.0);
    if discs.is_empty() {
        return Answer::untold();
    }
    let below = |v: f64, error: Option<f64>, chance: f64| {
        chance - v > ERRORS * error.unwrap_or(f64::INFINITY)
    };
    let met = discs
        .iter()
        .filter(|it| below(it.v.mean, it.v.error, v_ind(it.condition.n)))
        .count();
    let shares: Vec<String> = discs
        .iter()
        .map(|it| {
            let chance = v_ind(it.condition.n);
            let share = with_error(it.v.mean / chance, it.v.error.map(|error| error / chance));
            format!("{share} (n = {})", it.condition.n)
        })
        .collect();
    Answer {
        measured: format!("v / v_ind = {}", shares.join(", ")),
        verdict: Verdict::of_cases(met, discs.len()),
    }
}

fn discs_rise(evidence: &Evidence) -> Answer {
    let (Some(three), Some(seven)) = (evidence.one(1.0, 3), evidence.one(1.0, 7)) else {
        return Answer::untold();
    };
    let rises = seven.v.mean - three.v.mean > ERRORS * of_difference(three.v.error, seven.v.error);
    let steps = evidence.uninformed(1.0).into_iter();
    let steps: Vec<String> = steps
        .filter(|it| it.condition.n < 10)
        .map(|it| with_error(it.v.mean, it.v.error))
        .collect();
    Answer {
        measured: format!("v = {} at n = 3, 5, 7", steps.join(", ")),
        verdict: Verdict::of_cases(usize::from(rises), 1),
    }
}

fn almost_perfect(evidence: &Evidence) -> Answer {
    let few = ELONGATED.map(|pi1| evidence.uninformed(pi1)).concat();
    let few: Vec<_> = few.iter().filter(|it| it.condition.n <= 10).collect();
    let Some(least) = few.iter().min_by(|a, b| a.v.mean.total_cmp(&b.v.mean)) else {
        return Answer::untold();
    };
    let met = few.iter().filter(|it| it.v.mean >= 0.9).count();
    Answer {
        measured: format!(
            "least v = {} (π1 = {}, n = {}); {met} of {} at 0.9 or more",
            with_error(least.v.mean, least.v.error),
            least.condition.pi1,
            least.condition.n,
            few.len()
        ),
        verdict: Verdict::of_cases(met, few.len()),
    }
}

fn close_to_each_other(evidence: &Evidence) -> Answer {
    let mut ratios = Vec::new();
    for four in evidence.uninformed(4.0) {
        if let Some(eight) = evidence.one(8.0, four.condition.n) {
            ratios.push((four.condition.n, eight.v.mean / four.v.mean));
        }
    }
    let apart = |ratio: f64| f64::max(ratio, 1.0 / ratio);
    let furthest = ratios
        .iter()
        .max_by(|a, b| apart(a.1).total_cmp(&apart(b.1)));
    let Some((n, ratio)) = furthest else {
        return Answer::untold();
    };
    let met = ratios.iter().filter(|it| apart(it.1) <= 1.25).count();
    let verdict = match Verdict::of_cases(met, ratios.len()) {
        Verdict::InPart if 2 * met <= ratios.len() => Verdict::Fails,
        verdict => verdict,
    };
    Answer {
        measured: format!(
            "v(π1 = 8) / v(π1 = 4) = {ratio:.2} at n = {n}, where it is furthest from 1; {met} of {} \
             within 1.25",
            ratios.len()
        ),
        verdict,
    }
}

fn order_at_74(evidence: &Evidence) -> Answer {
    let chance = v_ind(74);
    let (mut met, mut told) = (0, Vec::new());
    for pi1 in ELONGATED {
        let Some(it) = evidence.one(pi1, 74) else {
            return Answer::untold();
        };
        let above = it.v.mean - chance > ERRORS * it.v.error.unwrap_or(f64::INFINITY);
        met += usize::from(above);
        told.push(format!(
            "{} (π1 = {pi1})",
            with_error(it.v.mean, it.v.error)
        ));
    }
    Answer {
        measured: format!("v = {}; v_ind(74) = {chance:.4}", told.join(", ")),
        verdict: Verdict::of_cases(met, ELONGATED.len()),
    }
}
