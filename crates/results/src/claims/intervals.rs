//! Claims 3 and 4: the times of build-up and breakdown of order, and the size of clusters (Figures
//! 4 and 5).

use super::order::ELONGATED;
use super::{Case, Claim, ClaimResult, Evidence, Verdict, counts, of_difference, with_error};
use crate::disorder::n_eff;
use crate::statistics::Summary;

pub(super) const CLAIMS: [Claim; 5] = [
    Claim {
        name: "3a",
        statement: "Build-up times grow exponentially with n (π1 ≥ 4).",
        criterion: "for both values of π1, from n = 10 on, the logarithm of the time is linear in n with \
                    R² ≥ 0.9, and R² is larger than for a fit over log n",
        judge: build_up_grows,
    },
    Claim {
        name: "3b",
        statement: "Breakdown times are still well above 1 at n = 50 for π1 ≥ 4.",
        criterion: "the breakdown time is 2 or more for both values of π1; as in the paper, only if every run \
                    reached order",
        judge: breakdown_at_50,
    },
    Claim {
        name: "4a",
        statement: "n_eff is close to n for groups of a few (π1 ≥ 4).",
        criterion: "n_eff ≥ 0.8 n at every n ≤ 7",
        judge: few_are_one_cluster,
    },
    Claim {
        name: "4b",
        statement: "n_eff ≈ 10 at n = 50 for π1 ≥ 4.",
        criterion: "n_eff is between 7 and 14 for both values of π1",
        judge: ten_of_fifty,
    },
    Claim {
        name: "4c",
        statement: "n_eff probably saturates.",
        criterion: "n_eff grows by less than a quarter from n = 50 to 74, for both values of π1",
        judge: saturates,
    },
];

/// The fewest values of n through which a line is fitted: through two, every line has R² = 1.
const FIT_POINTS: usize = 3;

/// Fits a straight line to points (x, y). Returns the explained share of the variance, R², and the
/// slope.
fn line(points: &[(f64, f64)]) -> (f64, f64) {
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|it| it.0), mean(|it| it.1));
    let sum = |of: &dyn Fn(f64, f64) -> f64| {
        let terms = points.iter().map(|it| of(it.0 - x, it.1 - y));
        terms.sum::<f64>()
    };
    let (xx, xy, yy) = (sum(&|a, _| a * a), sum(&|a, b| a * b), sum(&|_, b| b * b));
    (xy * xy / (xx * yy), xy / xx)
}

fn build_up_grows(evidence: &Evidence) -> ClaimResult {
    let (mut cases, mut fits) = (Vec::new(), Vec::new());
    for pi1 in ELONGATED {
        let mut large = evidence.uninformed(pi1);
        large.retain(|it| it.condition.n >= 10);
        if large.len() < FIT_POINTS {
            return ClaimResult::no_runs();
        }
        let of = |it: &Summary| Some((it.condition.n as f64, it.build_up?.mean));
        let points: Vec<_> = large.iter().filter_map(|it| of(it)).collect();
        if points.len() < FIT_POINTS {
            fits.push(format!(
                "{} points where every run reached order (π1 = {pi1})",
                points.len()
            ));
            cases.push(Case::sure(false));
            continue;
        }
        let exponential: Vec<_> = points.iter().map(|it| (it.0, libm::log(it.1))).collect();
        let power: Vec<_> = points
            .iter()
            .map(|it| (libm::log(it.0), libm::log(it.1)))
            .collect();
        let ((fit, slope), (other, _)) = (line(&exponential), line(&power));
        cases.push(Case::sure(fit >= 0.9 && fit >= other && slope > 0.0));
        let (first, last) = (points[0], points[points.len() - 1]);
        fits.push(format!(
            "×{:.2} each 10 individuals, R² {fit:.3} (over log n {other:.3}); {:.1} at n = {} to {:.1} \
             at n = {} (π1 = {pi1})",
            libm::exp(10.0 * slope),
            first.1,
            first.0,
            last.1,
            last.0
        ));
    }
    ClaimResult {
        measured: fits.join("; "),
        verdict: Verdict::of_cases(&cases),
    }
}

fn breakdown_at_50(evidence: &Evidence) -> ClaimResult {
    let (mut cases, mut times) = (Vec::new(), Vec::new());
    for pi1 in ELONGATED {
        let Some(it) = evidence.one(pi1, 50) else {
            return ClaimResult::no_runs();
        };
        match it.breakdown {
            Some(time) => {
                cases.push(Case::new(time.mean - 2.0, time.error));
                times.push(format!(
                    "{} (π1 = {pi1})",
                    with_error(time.mean, time.error)
                ));
            }
            None => {
                cases.push(Case::sure(false));
                times.push(format!("not every run reached order (π1 = {pi1})"));
            }
        }
    }
    ClaimResult {
        measured: times.join(", "),
        verdict: Verdict::of_cases(&cases),
    }
}

/// Returns `n_eff` and its standard error: half the change of `n_eff` between the mean `v` minus
/// and plus its standard error.
fn cluster(it: &Summary) -> Option<(f64, Option<f64>)> {
    let n = it.condition.n;
    let size = it.n_eff?;
    let error = it.v.error.and_then(|error| {
        let [low, high] = [-error, error].map(|by| n_eff(n, it.v.mean + by));
        Some((high? - low?) / 2.0)
    });
    Some((size, error))
}

fn few_are_one_cluster(evidence: &Evidence) -> ClaimResult {
    let few = ELONGATED.map(|pi1| evidence.uninformed(pi1)).concat();
    let few = few.into_iter().filter(|it| it.condition.n <= 7);
    let shares: Vec<(f64, Option<f64>, &Summary)> = few
        .map(|it| {
            let (size, error) = cluster(it).unwrap_or((0.0, Some(0.0)));
            let n = it.condition.n as f64;
            (size / n, error.map(|error| error / n), it)
        })
        .collect();
    let Some((least, error, it)) = shares.iter().min_by(|a, b| a.0.total_cmp(&b.0)) else {
        return ClaimResult::no_runs();
    };
    let cases = shares.iter().map(|it| Case::new(it.0 - 0.8, it.1));
    let cases: Vec<Case> = cases.collect();
    ClaimResult {
        measured: format!(
            "least n_eff / n = {} (π1 = {}, n = {}); at 0.8 or more: {}",
            with_error(*least, *error),
            it.condition.pi1,
            it.condition.n,
            counts(&cases)
        ),
        verdict: Verdict::of_cases(&cases),
    }
}

fn ten_of_fifty(evidence: &Evidence) -> ClaimResult {
    let (mut cases, mut sizes) = (Vec::new(), Vec::new());
    for pi1 in ELONGATED {
        let Some(it) = evidence.one(pi1, 50) else {
            return ClaimResult::no_runs();
        };
        let Some((size, error)) = cluster(it) else {
            sizes.push(format!("none: v is below v_ind (π1 = {pi1})"));
            cases.push(Case::sure(false));
            continue;
        };
        cases.push(Case::new(f64::min(size - 7.0, 14.0 - size), error));
        sizes.push(format!("{} (π1 = {pi1})", with_error(size, error)));
    }
    ClaimResult {
        measured: format!("n_eff = {}", sizes.join(", ")),
        verdict: Verdict::of_cases(&cases),
    }
}

fn saturates(evidence: &Evidence) -> ClaimResult {
    let (mut cases, mut sizes) = (Vec::new(), Vec::new());
    for pi1 in ELONGATED {
        let (Some(fifty), Some(more)) = (evidence.one(pi1, 50), evidence.one(pi1, 74)) else {
            return ClaimResult::no_runs();
        };
        let (Some(before), Some(after)) = (cluster(fifty), cluster(more)) else {
            sizes.push(format!("none: v is below v_ind (π1 = {pi1})"));
            cases.push(Case::sure(false));
            continue;
        };
        let error = of_difference(before.1.map(|error| 1.25 * error), after.1);
        cases.push(Case::new(1.25 * before.0 - after.0, error));
        sizes.push(format!(
            "{} at n = 50, {} at 74 (π1 = {pi1})",
            with_error(before.0, before.1),
            with_error(after.0, after.1)
        ));
    }
    ClaimResult {
        measured: format!("n_eff = {}", sizes.join("; ")),
        verdict: Verdict::of_cases(&cases),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::{sample, with};
    use crate::statistics::summarise;
    use crate::{Measure, ResultRow};

    /// The evidence of runs whose time without order grows by a factor of e per 10 individuals.
    fn growing(sizes: &[u64]) -> Evidence {
        let run = |pi1: f64, n: u64| {
            let run = ResultRow {
                pi1,
                n,
                informed: 0,
                ..sample()
            };
            let run = with(run, Measure::UNORDERED_TIME, libm::exp(n as f64 / 10.0));
            let run = with(run, Measure::UNORDERED_INTERVALS, 1);
            with(run, Measure::ORDERED_INTERVALS, 1)
        };
        let of_shape = |pi1: &f64| sizes.iter().map(|n| run(*pi1, *n)).collect::<Vec<_>>();
        let runs: Vec<ResultRow> = ELONGATED.iter().flat_map(of_shape).collect();
        Evidence {
            summaries: summarise(&runs),
            contact_rows: Vec::new(),
        }
    }

    #[test]
    fn three_sizes_are_enough_for_a_line_and_two_are_not() {
        let of = |sizes: &[u64]| build_up_grows(&growing(sizes)).verdict;
        assert_eq!(of(&[10, 20, 50]), Verdict::Holds);
        assert_eq!(of(&[10, 50]), Verdict::NoData);
        // Smaller groups do not count.
        assert_eq!(of(&[5, 10, 50]), Verdict::NoData);
        // Of three sizes, one where a run did not reach order.
        let mut evidence = growing(&[10, 20, 50]);
        for it in &mut evidence.summaries {
            it.build_up = it.build_up.filter(|_| it.condition.n < 50);
        }
        assert_eq!(build_up_grows(&evidence).verdict, Verdict::Fails);
    }

    #[test]
    fn clusters_of_fifty_must_have_about_ten_members() {
        let of_clusters = |clusters: u64| {
            let v = crate::disorder::v_ind(clusters);
            let pair = |pi1: &f64| {
                let run = ResultRow {
                    pi1: *pi1,
                    n: 50,
                    ..sample()
                };
                [-1e-4, 1e-4].map(|by| with(run.clone(), Measure::V, v + by))
            };
            let runs: Vec<ResultRow> = ELONGATED.iter().flat_map(pair).collect();
            ten_of_fifty(&Evidence {
                summaries: summarise(&runs),
                contact_rows: Vec::new(),
            })
        };
        assert_eq!(of_clusters(5).verdict, Verdict::Holds);
        // n_eff = 25, and about 4.
        assert_eq!(of_clusters(2).verdict, Verdict::Fails);
        assert_eq!(of_clusters(12).verdict, Verdict::Fails);
    }

    #[test]
    fn a_fit_finds_the_slope_and_explained_share_of_a_line() {
        let (fit, slope) = line(&[(1.0, 2.0), (2.0, 4.0), (4.0, 8.0)]);
        assert!((fit - 1.0).abs() < 1e-12 && (slope - 2.0).abs() < 1e-12);
        let (fit, _) = line(&[(0.0, 0.0), (1.0, 1.0), (2.0, 0.0)]);
        assert!(fit < 1e-12);
    }
}
