//! Claim 6: the effect of changing one parameter in the paper's animations [35].

use super::{Answer, Case, Claim, Evidence, Verdict};
use crate::touch::Touch;

pub(super) const CLAIMS: [Claim; 4] = [
    Claim {
        name: "6a",
        says: "π3 = 0.1 (low turning rates): individuals hardly exhibit any contact.",
        criterion: "less than a tenth of the pushing contacts at π3 = 1",
        ask: |evidence| {
            let pushing = |it: &Touch| it.pushing;
            let what = "pushing contacts each";
            compare(evidence, (0.1, 10.0), what, pushing, |there, usual| {
                there < 0.1 * usual
            })
        },
    },
    Claim {
        name: "6b",
        says: "π3 = 10 (high turning rates): translational motion of the group is suppressed.",
        criterion: "the centroid's way less than a tenth of a free individual's",
        ask: |evidence| {
            let way = |it: &Touch| it.way;
            let what = "way of the centroid over a free one's";
            compare(evidence, (10.0, 10.0), what, way, |there, _| there < 0.1)
        },
    },
    Claim {
        name: "6c",
        says: "π4 = 1: excentric contacts hardly rotate individuals.",
        criterion: "contacts turn the bodies that they displace less than a quarter as much as at π4 = 10",
        ask: |evidence| {
            let turned = |it: &Touch| it.turned / it.shifted;
            let what = "angle turned for a body size of displacement by contacts";
            compare(evidence, (1.0, 1.0), what, turned, |there, usual| {
                there < 0.25 * usual
            })
        },
    },
    Claim {
        name: "6d",
        says: "π4 = 100: individuals form pairs that move shoulder to shoulder.",
        criterion: "more individuals side by side than at π4 = 10, and at least half of all",
        ask: pairs_at_high_drag,
    },
];

/// Returns the mean over the runs with π1 = 4 at the given π3 and π4; `None` without such runs.
fn mean(evidence: &Evidence, (pi3, pi4): (f64, f64), of: fn(&Touch) -> f64) -> Option<f64> {
    let all = evidence.touches.iter();
    let of_them = all.filter(|it| it.pi1 == 4.0 && it.pi3 == pi3 && it.pi4 == pi4);
    let values: Vec<f64> = of_them.map(of).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Compares the mean at `changed` π3 and π4 with that at the usual π3 = 1 and π4 = 10.
fn compare(
    evidence: &Evidence,
    changed: (f64, f64),
    what: &str,
    of: fn(&Touch) -> f64,
    is_met: fn(f64, f64) -> bool,
) -> Answer {
    let (Some(usual), Some(there)) = (mean(evidence, (1.0, 10.0), of), mean(evidence, changed, of))
    else {
        return Answer::no_runs();
    };
    Answer {
        measured: format!("{what}: {there:.4}, usually {usual:.4}"),
        verdict: Verdict::of_cases(&[Case::sure(is_met(there, usual))]),
    }
}

fn pairs_at_high_drag(evidence: &Evidence) -> Answer {
    let beside = |it: &Touch| it.beside;
    let (Some(usual), Some(there)) = (
        mean(evidence, (1.0, 10.0), beside),
        mean(evidence, (1.0, 100.0), beside),
    ) else {
        return Answer::no_runs();
    };
    let is_met = there > usual && there >= 0.5;
    Answer {
        measured: format!("share with another at their side: {there:.3}, usually {usual:.3}"),
        verdict: Verdict::of_cases(&[Case::sure(is_met)]),
    }
}
