//! Claim 6: the effect of changing one parameter in the paper's animations [35].

use super::{Case, Claim, ClaimResult, Evidence, Verdict};
use crate::contact_statistics::ContactStatistics;

pub(super) const CLAIMS: [Claim; 4] = [
    Claim {
        name: "6a",
        statement: "π3 = 0.1 (low turning rates): individuals hardly exhibit any contact.",
        criterion: "an individual has less than a tenth of the pushing contacts that it has at π3 = 1",
        judge: |evidence| {
            let pushing = |it: &ContactStatistics| it.pushing;
            let what = "pushing contacts of an individual";
            compare(evidence, (0.1, 10.0), what, pushing, |there, usual| {
                there < 0.1 * usual
            })
        },
    },
    Claim {
        name: "6b",
        statement: "π3 = 10 (high turning rates): translational motion of the group is suppressed.",
        criterion: "the displacement of the centroid is less than a tenth of that of a free individual",
        judge: |evidence| {
            let way = |it: &ContactStatistics| it.way;
            let what = "displacement of the centroid over that of a free individual";
            compare(evidence, (10.0, 10.0), what, way, |there, _| there < 0.1)
        },
    },
    Claim {
        name: "6c",
        statement: "π4 = 1: excentric contacts hardly rotate individuals.",
        criterion: "for the same displacement by contacts, bodies are turned less than a quarter as much as at π4 = 10",
        judge: |evidence| {
            let turned = |it: &ContactStatistics| it.turned / it.shifted;
            let what = "angle by which contacts turn a body, for each body size of displacement";
            compare(evidence, (1.0, 1.0), what, turned, |there, usual| {
                there < 0.25 * usual
            })
        },
    },
    Claim {
        name: "6d",
        statement: "π4 = 100: individuals form pairs that move shoulder to shoulder.",
        criterion: "more individuals are side by side than at π4 = 10, and at least half of all",
        judge: pairs_at_high_drag,
    },
];

/// Returns the mean over the runs with π1 = 4 at the given π3 and π4; `None` without such runs.
fn mean(
    evidence: &Evidence,
    (pi3, pi4): (f64, f64),
    of: fn(&ContactStatistics) -> f64,
) -> Option<f64> {
    let all = evidence.contact_rows.iter();
    let of_them = all.filter(|it| it.pi1 == 4.0 && it.pi3 == pi3 && it.pi4 == pi4);
    let values: Vec<f64> = of_them.map(of).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Compares the mean at `changed` π3 and π4 with that at the usual π3 = 1 and π4 = 10.
fn compare(
    evidence: &Evidence,
    changed: (f64, f64),
    what: &str,
    of: fn(&ContactStatistics) -> f64,
    is_met: fn(f64, f64) -> bool,
) -> ClaimResult {
    let (Some(usual), Some(there)) = (mean(evidence, (1.0, 10.0), of), mean(evidence, changed, of))
    else {
        return ClaimResult::no_runs();
    };
    ClaimResult {
        measured: format!("{what}: {there:.4}; at π3 = 1, π4 = 10: {usual:.4}"),
        verdict: Verdict::of_cases(&[Case::sure(is_met(there, usual))]),
    }
}

fn pairs_at_high_drag(evidence: &Evidence) -> ClaimResult {
    let beside = |it: &ContactStatistics| it.beside;
    let (Some(usual), Some(there)) = (
        mean(evidence, (1.0, 10.0), beside),
        mean(evidence, (1.0, 100.0), beside),
    ) else {
        return ClaimResult::no_runs();
    };
    let is_met = there > usual && there >= 0.5;
    ClaimResult {
        measured: format!(
            "share of individuals with another at their side: {there:.3}; at π3 = 1, π4 = 10: {usual:.3}"
        ),
        verdict: Verdict::of_cases(&[Case::sure(is_met)]),
    }
}
