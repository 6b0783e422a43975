//! Claim 5: the drift of groups with informed individuals (Figure 6).

use super::{
    Case, Claim, ClaimResult, Evidence, Verdict, at_most, counts, of_difference, ratio, with_error,
};
use crate::statistics::{Spread, Summary};

pub(super) const CLAIMS: [Claim; 5] = [
    Claim {
        name: "5a",
        statement: "Elongation increases the drift speed, by up to a factor of 2.",
        criterion: "at every n and k, the drift of elongated bodies (π1 ≥ 2) is larger than that of discs, \
                    and at most 2.5 times as large; in some condition it is at least 1.5 times as large",
        judge: elongation_helps,
    },
    Claim {
        name: "5b",
        statement: "Elongated and n ≤ 20: v_pd is significantly higher than k/n.",
        criterion: "v_pd is above k/n in every condition with π1 ≥ 2 and n ≤ 20",
        judge: more_than_their_share,
    },
    Claim {
        name: "5c",
        statement: "Larger groups are led less well: v_pd is lower at n = 40 than at 10 and 20.",
        criterion: "v_pd at n = 40 is below both at every k/n and π1 ≥ 2",
        judge: larger_groups_are_slower,
    },
    Claim {
        name: "5d",
        statement: "Moderate elongation (2 ≤ π1 ≤ 4) sometimes does better than π1 = 8.",
        criterion: "some v_pd at π1 = 2, 3 or 4 exceeds that at π1 = 8 by more than 3 standard errors",
        judge: moderate_is_sometimes_better,
    },
    Claim {
        name: "5e",
        statement: "Runs differ much, especially at n = 10 and for elongated shapes.",
        criterion: "the mean standard deviation of v_pd at n = 10 (π1 ≥ 4) is at least 1.5 times that at \
                    n = 40, and above that of discs at n = 10",
        judge: runs_differ,
    },
];

/// The smallest `pi1` that counts as elongated: the paper does not call weaker elongation so.
const ELONGATED_FROM: f64 = 2.0;

fn share(it: &Summary) -> f64 {
    it.condition.informed as f64 / it.condition.n as f64
}

fn elongated(evidence: &Evidence) -> Vec<&Summary> {
    let all = evidence.informed();
    all.filter(|it| it.condition.pi1 >= ELONGATED_FROM && it.v_pd.is_some())
        .collect()
}

fn name(it: &Summary) -> String {
    let condition = &it.condition;
    format!(
        "n = {}, k = {}, π1 = {}",
        condition.n, condition.informed, condition.pi1
    )
}

fn elongation_helps(evidence: &Evidence) -> ClaimResult {
    let (mut cases, mut best) = (Vec::new(), None::<(f64, Option<f64>, String)>);
    let (mut quicker, mut too_quick) = (Vec::new(), 0);
    for it in elongated(evidence) {
        let discs = evidence.drift(1.0, it.condition.n, it.condition.informed);
        let (Some(long), Some(discs)) = (it.v_pd, discs) else {
            continue;
        };
        let error = of_difference(long.error, discs.error);
        let is_quicker = Case::new(long.mean - discs.mean, error);
        let is_at_most = at_most(2.5, long, discs);
        quicker.push(is_quicker);
        too_quick += usize::from(is_at_most.is_missed());
        cases.push(is_quicker.and(is_at_most));
        let (value, error) = ratio(long, discs);
        if best.as_ref().is_none_or(|best| value > best.0) {
            best = Some((value, error, name(it)));
        }
    }
    let Some((largest, error, place)) = best else {
        return ClaimResult::no_runs();
    };
    let verdict = match Verdict::of_cases(&cases) {
        Verdict::Holds if largest < 1.5 => Verdict::InPart,
        verdict => verdict,
    };
    ClaimResult {
        measured: format!(
            "drift larger than that of discs: {}; more than 2.5 times as large in {too_quick}; largest \
             ratio {} ({place})",
            counts(&quicker),
            with_error(largest, error)
        ),
        verdict,
    }
}

fn more_than_their_share(evidence: &Evidence) -> ClaimResult {
    let few: Vec<_> = elongated(evidence)
        .into_iter()
        .filter(|it| it.condition.n <= 20)
        .collect();
    let mut gains: Vec<f64> = Vec::new();
    let mut cases = Vec::new();
    for it in &few {
        let Some(drift) = it.v_pd else { continue };
        cases.push(Case::new(drift.mean - share(it), drift.error));
        gains.push(drift.mean / share(it));
    }
    gains.sort_by(f64::total_cmp);
    let Some(median) = gains.get(gains.len() / 2) else {
        return ClaimResult::no_runs();
    };
    ClaimResult {
        measured: format!(
            "v_pd / (k/n): median {median:.2}, least {:.2}, largest {:.2}; above 1: {}",
            gains[0],
            gains[gains.len() - 1],
            counts(&cases)
        ),
        verdict: Verdict::of_cases(&cases),
    }
}

fn larger_groups_are_slower(evidence: &Evidence) -> ClaimResult {
    let (mut cases, mut losses) = (Vec::new(), Vec::new());
    for it in elongated(evidence) {
        let condition = &it.condition;
        if condition.n != 40 || !condition.informed.is_multiple_of(4) {
            continue;
        }
        let small = [(10, condition.informed / 4), (20, condition.informed / 2)];
        let small = small.map(|(n, informed)| evidence.drift(condition.pi1, n, informed));
        let ([Some(ten), Some(twenty)], Some(forty)) = (small, it.v_pd) else {
            continue;
        };
        let below = |other: Spread| {
            let error = of_difference(other.error, forty.error);
            Case::new(other.mean - forty.mean, error)
        };
        cases.push(below(ten).and(below(twenty)));
        losses.push(2.0 * forty.mean / (ten.mean + twenty.mean));
    }
    if losses.is_empty() {
        return ClaimResult::no_runs();
    }
    let mean = losses.iter().sum::<f64>() / losses.len() as f64;
    ClaimResult {
        measured: format!(
            "v_pd at n = 40 is {mean:.2} times the mean of n = 10 and 20, on average; below both: {}",
            counts(&cases)
        ),
        verdict: Verdict::of(&cases, mean < 1.0),
    }
}

fn moderate_is_sometimes_better(evidence: &Evidence) -> ClaimResult {
    let (mut met, mut all, mut best) = (0, 0, None::<(f64, String)>);
    for it in elongated(evidence) {
        if it.condition.pi1 > 4.0 {
            continue;
        }
        let eight = evidence.drift(8.0, it.condition.n, it.condition.informed);
        let (Some(moderate), Some(eight)) = (it.v_pd, eight) else {
            continue;
        };
        all += 1;
        let error = of_difference(moderate.error, eight.error).unwrap_or(f64::INFINITY);
        let errors = (moderate.mean - eight.mean) / error;
        // Among this many comparisons, differences of two standard errors occur by chance.
        met += usize::from(errors > 3.0);
        if best.as_ref().is_none_or(|best| errors > best.0) {
            let comparison = format!(
                "{} against {} at π1 = 8 ({}), {errors:.1} standard errors",
                with_error(moderate.mean, moderate.error),
                with_error(eight.mean, eight.error),
                name(it)
            );
            best = Some((errors, comparison));
        }
    }
    let Some((_, clearest)) = best else {
        return ClaimResult::no_runs();
    };
    ClaimResult {
        measured: format!("in {met} of {all} conditions; clearest: {clearest}"),
        verdict: Verdict::of_cases(&[Case::sure(met > 0)]),
    }
}

fn runs_differ(evidence: &Evidence) -> ClaimResult {
    let mean = |is_among: &dyn Fn(&Summary) -> bool| {
        let among = evidence.informed().filter(|it| is_among(it));
        let spreads: Vec<f64> = among.filter_map(|it| it.v_pd?.deviation).collect();
        spreads.iter().sum::<f64>() / spreads.len() as f64
    };
    let long = |it: &Summary| it.condition.pi1 >= 4.0;
    let of = |n: u64| mean(&|it: &Summary| long(it) && it.condition.n == n);
    let [ten, twenty, forty] = [10, 20, 40].map(of);
    let discs = mean(&|it: &Summary| it.condition.pi1 == 1.0 && it.condition.n == 10);
    if [ten, twenty, forty, discs].iter().any(|it| it.is_nan()) {
        return ClaimResult::no_runs();
    }
    let cases = [ten >= 1.5 * forty, ten > discs].map(Case::sure);
    ClaimResult {
        measured: format!(
            "standard deviation of v_pd among runs, π1 ≥ 4: {ten:.3}, {twenty:.3}, {forty:.3} at n = \
             10, 20, 40; discs at n = 10: {discs:.3}"
        ),
        verdict: Verdict::of_cases(&cases),
    }
}
