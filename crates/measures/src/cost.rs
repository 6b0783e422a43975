//! What measures cost that are evaluated after every step, together.

use thiserror::Error;

use crate::measure::Measure;

/// The most different measures of cost n that conditions compare together, unless one of the conditions alone
/// compares more. Each takes about a hundredth of a step.
pub const MAX_PLAIN: usize = 16;

/// The largest share of an estimated step that the measures with a cost above n may take together, unless
/// those of one condition take more alone.
const MAX_SHARE: f64 = 0.1;

/// The measures of conditions would take too long after every step.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{0}")]
pub struct TooCostlyTogether(String);

/// Different measures, of one state.
#[derive(Clone, Debug, Default)]
struct Together {
    /// Those of cost n.
    plain: Vec<Measure>,
    /// Those of cost n log n.
    costly: Vec<Measure>,
}

impl Together {
    fn add(&mut self, measure: &Measure) {
        let all = match measure.definition().cost {
            "n" => &mut self.plain,
            _ => &mut self.costly,
        };
        if !all.contains(measure) {
            all.push(*measure);
        }
    }

    fn extend<'a>(&mut self, measures: impl IntoIterator<Item = &'a Measure>) {
        measures.into_iter().for_each(|it| self.add(it));
    }
}

/// Checks that the different measures of conditions, evaluated together after each step of `n` individuals,
/// leave most of the time to the steps: at most 16 of cost n, and of those of cost n log n as many as take a
/// tenth of a step. If one condition alone has more or takes longer, all together may have or take as much as
/// that one, so that a single condition is always accepted. The costs are estimates, which depend on the
/// measures and on `n` alone.
///
/// # Errors
///
/// [`TooCostlyTogether`].
pub fn check_cost<'a, M: IntoIterator<Item = &'a Measure>>(
    conditions: impl IntoIterator<Item = M>,
    n: usize,
) -> Result<(), TooCostlyTogether> {
    let (mut together, mut max_plain) = (Together::default(), MAX_PLAIN);
    let mut limit = MAX_SHARE * step(n);
    for measures in conditions {
        let mut alone = Together::default();
        alone.extend(measures);
        max_plain = max_plain.max(alone.plain.len());
        limit = limit.max(cost_of(&alone.costly, n));
        together.extend(alone.plain.iter().chain(&alone.costly));
    }
    let Together { plain, costly } = &together;
    if plain.len() > max_plain {
        return Err(TooCostlyTogether(format!(
            "the conditions would compare {} different measures after every step, the limit is {max_plain}: \
             compare measures that others compare already, or fewer",
            plain.len()
        )));
    }
    let cost = cost_of(costly, n);
    match cost <= limit * (1.0 + f64::EPSILON) {
        true => Ok(()),
        false => Err(TooCostlyTogether(format!(
            "{} would take about {:.0} µs after every step of {n} individuals, the limit is {:.0} µs: compare \
             measures and gaps that others compare already, or wait until they have ended",
            names(costly),
            cost * 1e-3,
            limit * 1e-3,
        ))),
    }
}

/// Returns the estimated time of a step, in nanoseconds. It is that of docs/performance.md for settled groups
/// of less than a thousand, and less for larger ones, in which fewer individuals touch.
fn step(n: usize) -> f64 {
    let n = n as f64;
    n * (250.0 + 0.5 * n.min(2000.0))
}

/// Returns the estimated time to evaluate different measures with a cost above n, in nanoseconds.
fn cost_of(measures: &[Measure], n: usize) -> f64 {
    /// One search for the pairs within a gap: for each individual, and for each that lies within the gap.
    const SEARCH: f64 = 150.0;
    const NEAR: f64 = 40.0;
    /// The clusters or contacts of one gap.
    const GAP: f64 = 20.0;
    /// The triangulation, and the rest of each measure that needs it.
    const TRIANGULATION: f64 = 500.0;
    const QUANTILES: f64 = 200.0;
    /// Sorting.
    const SORT: f64 = 60.0;
    let (mut each, mut largest_gap, mut is_triangulated) = (0.0, None::<f64>, false);
    let mut gaps: Vec<f64> = Vec::new();
    for measure in measures {
        if let Some(gap) = measure.gap() {
            largest_gap = Some(largest_gap.map_or(gap, |it| it.max(gap)));
            if !gaps.contains(&gap) {
                gaps.push(gap);
                each += GAP * near(gap);
            }
        } else if measure.definition().is_of_informed {
            each += SORT;
        } else {
            is_triangulated = true;
            each += QUANTILES;
        }
    }
    each += largest_gap.map_or(0.0, |gap| SEARCH + NEAR * near(gap));
    each += if is_triangulated { TRIANGULATION } else { 0.0 };
    n as f64 * each
}

/// Returns the estimated number of pairs within a gap for each individual of a dense group.
fn near(gap: f64) -> f64 {
    3.0 * (1.0 + gap) * (1.0 + gap)
}

/// Names at most three measures.
fn names(measures: &[Measure]) -> String {
    const SHOWN: usize = 3;
    let mut names: Vec<String> = measures
        .iter()
        .take(SHOWN)
        .map(ToString::to_string)
        .collect();
    if measures.len() > SHOWN {
        names.push(format!("{} more", measures.len() - SHOWN));
    }
    names.join(", ")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// Whether these conditions are accepted, each with its measures separated by spaces.
    fn check(conditions: &[String], n: usize) -> bool {
        let conditions: Vec<Vec<Measure>> = conditions
            .iter()
            .map(|it| it.split(' ').map(|name| name.parse().unwrap()).collect())
            .collect();
        check_cost(&conditions, n).is_ok()
    }

    fn gaps(count: u32) -> Vec<String> {
        (0..count)
            .map(|k| format!("clusters.count({})", f64::from(k) / 500.0))
            .collect()
    }

    fn lags(count: u32) -> Vec<String> {
        (1..=count).map(|k| format!("msd({k})")).collect()
    }

    const SIZES: [usize; 4] = [1, 50, 2000, 10_000];

    #[test]
    fn equal_measures_cost_as_much_as_one() {
        for n in SIZES {
            for name in [
                "order",
                "clusters.count",
                "clusters.count(2)",
                "neighbour_gap.median",
                "order clusters.count front",
            ] {
                assert!(check(&vec![name.to_owned(); 500], n), "{name} {n}");
            }
        }
    }

    #[test]
    fn many_different_measures_of_several_conditions_are_rejected() {
        for n in SIZES {
            assert!(!check(&gaps(544), n), "{n}");
            assert!(!check(&gaps(16), n), "{n}");
            assert!(check(&lags(16), n), "{n}");
            assert!(!check(&lags(17), n), "{n}");
            // Those of cost n are counted apart.
            assert!(check(&[lags(16), gaps(1)].concat(), n), "{n}");
        }
    }

    #[test]
    fn one_condition_is_always_accepted_and_others_with_its_measures() {
        let alone = [
            "front clusters.count".to_owned(),
            "neighbour_gap.median clusters.count(1) contacts_per_body".to_owned(),
            gaps(16).join(" "),
            lags(34).join(" "),
            [lags(20), gaps(20)].concat().join(" "),
        ];
        for n in SIZES {
            for condition in &alone {
                assert!(check(std::slice::from_ref(condition), n), "{condition} {n}");
                let parts = condition.split(' ').map(str::to_owned);
                let all: Vec<String> = parts.chain([condition.clone()]).collect();
                assert!(check(&all, n), "{condition} {n}");
                let more = [condition.clone(), "clusters.count(2)".to_owned()];
                // The dearer of both is the limit, not their sum.
                let is_first = !condition.contains("clusters");
                assert_eq!(check(&more, n), is_first, "{condition} {n}");
            }
            assert!(
                !check(&[lags(34).join(" "), "msd(35)".to_owned()], n),
                "{n}"
            );
        }
    }
}
