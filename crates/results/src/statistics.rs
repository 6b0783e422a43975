//! Statistics over the runs of one condition, as in the paper's figures.

use std::cmp::Ordering;

use crate::disorder::n_eff;
use crate::{ExtraValue, Measure, ResultRow};

/// The parameters that the replicates of a run share; replicates differ only in their seed.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// The contact rule.
    pub contacts: String,
    /// The time step.
    pub dt: f64,
    /// Body size over turning radius.
    pub pi3: f64,
    /// Translational over rotational drag.
    pub pi4: f64,
    /// Length over width of a body.
    pub pi1: f64,
    /// Number of individuals.
    pub n: u64,
    /// Number of informed individuals.
    pub informed: u64,
    /// The weight of the informed individuals' preference; 0 if no run ever has informed individuals.
    pub pi2: f64,
    /// The other varied values, as in the names of the runs: `noise=0.1 share=0.05`.
    pub others: String,
}

/// A mean over runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The mean.
    pub mean: f64,
    /// The standard deviation of single runs, normalised by their number minus 1; none for one run.
    pub deviation: Option<f64>,
    /// The standard error of the mean; none for one run.
    pub error: Option<f64>,
}

/// A mean length of intervals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// The total time over the number of intervals, of all runs together.
    pub mean: f64,
    /// Its standard error over the runs, by the delta method for a ratio; none for one run.
    pub error: Option<f64>,
}

/// The runs of one condition.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// The parameters that they share.
    pub condition: Condition,
    /// Number of runs.
    pub runs: usize,
    /// The mean speed of the centroid, over the free speed.
    pub v: Spread,
    /// The mean drift along the informed individuals' direction; none unless every run has one.
    pub v_pd: Option<Spread>,
    /// The mean length of an interval without order; none unless every run reached order.
    pub build_up: Option<Interval>,
    /// The mean length of an interval with order; none unless every run reached order.
    pub breakdown: Option<Interval>,
    /// The effective cluster size from the mean `v`; none if that is below `v_ind(n)`.
    pub n_eff: Option<f64>,
    /// The share of all time that was ordered.
    pub ordered_share: f64,
    /// The mean share of time in which any two axes crossed.
    pub crossed_share: f64,
    /// The measures that only some experiments have, and `stopped_at`.
    pub extra: Vec<ExtraSummary>,
}

/// A measure that only some experiments have.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtraSummary {
    /// Its name.
    pub name: String,
    /// Number of runs in which it is defined.
    pub runs: usize,
    /// The mean over these; none without such a run.
    pub spread: Option<Spread>,
}

impl Condition {
    /// Returns the condition of `run`, with the weight that it was given.
    fn given(run: &ResultRow) -> Self {
        Self {
            contacts: run.contacts.clone(),
            dt: run.dt,
            pi3: run.pi3,
            pi4: run.pi4,
            pi1: run.pi1,
            n: run.n,
            informed: run.informed,
            pi2: run.pi2,
            others: others(&run.run),
        }
    }

    /// Returns the same without the weight, if nobody is informed at the start.
    fn at_the_start(&self) -> Self {
        Self {
            pi2: if self.informed == 0 { 0.0 } else { self.pi2 },
            ..self.clone()
        }
    }

    fn compare(&self, other: &Self) -> Ordering {
        let numbers = |condition: &Self| {
            let Self {
                dt, pi3, pi4, pi2, ..
            } = *condition;
            [dt, pi3, pi4, pi2, condition.pi1]
        };
        // Descending by name, so that `endpoints`, the exact rule, precedes `closest`.
        let by_number = numbers(self)
            .into_iter()
            .zip(numbers(other))
            .map(|(one, two)| one.total_cmp(&two))
            .find(|ordering| ordering.is_ne())
            .unwrap_or(Ordering::Equal);
        other
            .contacts
            .cmp(&self.contacts)
            .then(by_number)
            .then(self.n.cmp(&other.n))
            .then(self.informed.cmp(&other.informed))
            .then_with(|| compare_others(&self.others, &other.others))
    }
}

/// The varied values that are fields of a [`Condition`], and the share that `informed` was computed
/// from.
const FIELDS: [&str; 9] = [
    "contacts",
    "dt",
    "pi1",
    "pi2",
    "pi3",
    "pi4",
    "n",
    "informed",
    "informed_fraction",
];

/// Returns the varied values in the name of a run that are no fields of a [`Condition`].
fn others(run: &str) -> String {
    let is_other = |pair: &&str| {
        let name = pair.split_once('=').map(|(name, _)| name);
        name.is_some_and(|name| !FIELDS.contains(&name))
    };
    let others: Vec<&str> = run.split(' ').filter(is_other).collect();
    others.join(" ")
}

/// Compares [`Condition::others`], numbers by size.
#[must_use]
pub fn compare_others(one: &str, two: &str) -> Ordering {
    let split = |text: &str| -> Vec<(String, String)> {
        let pairs = text.split(' ').filter_map(|pair| pair.split_once('='));
        pairs
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .collect()
    };
    compare_values(&split(one), &split(two))
}

/// Compares varied values with their names, numbers by size.
#[must_use]
pub fn compare_values(one: &[(String, String)], two: &[(String, String)]) -> Ordering {
    let pairs = one.iter().zip(two);
    let mut orders = pairs.map(|((name, value), (of, other))| {
        let by_value = match (value.parse::<f64>(), other.parse::<f64>()) {
            (Ok(value), Ok(other)) => value.total_cmp(&other),
            _ => value.cmp(other),
        };
        name.cmp(of).then(by_value)
    });
    let first = orders.find(|order| order.is_ne());
    first.unwrap_or_else(|| one.len().cmp(&two.len()))
}

/// Summarises each condition of `runs`, ordered by rule, `dt`, `pi3`, `pi4`, `pi2`, `pi1`,
/// `n` and informed. Sums follow the order of `runs`.
pub fn summarise(runs: &[ResultRow]) -> Vec<Summary> {
    let mut rows: Vec<(Condition, &ResultRow)> = runs
        .iter()
        .map(|run| (Condition::given(run), run))
        .collect();
    // Without informed individuals their weight makes no difference, so that runs of several weights are
    // of one condition. A protocol may inform some later, perhaps not in every run: it is all runs
    // together that have a weight or none, since the runs of one condition stay together.
    let starts = |(one, _): &(Condition, &ResultRow), (two, _): &(Condition, &ResultRow)| {
        one.at_the_start().compare(&two.at_the_start())
    };
    rows.sort_by(starts);
    for rows in rows.chunk_by_mut(|one, two| starts(one, two).is_eq()) {
        let is_informed = |run: &ResultRow| run.optional_number(Measure::V_PD).is_some();
        if !rows.iter().any(|(_, run)| is_informed(run)) {
            for (condition, _) in rows {
                *condition = condition.at_the_start();
            }
        }
    }
    rows.sort_by(|(one, _), (two, _)| one.compare(two));
    rows.chunk_by(|(one, _), (two, _)| one.compare(two).is_eq())
        .map(|rows| {
            let runs: Vec<&ResultRow> = rows.iter().map(|(_, run)| *run).collect();
            summarise_condition(rows[0].0.clone(), &runs)
        })
        .collect()
}

fn summarise_condition(condition: Condition, runs: &[&ResultRow]) -> Summary {
    let numbers = |measure| -> Vec<f64> { runs.iter().map(|run| run.number(measure)).collect() };
    let v = mean_of(&numbers(Measure::V));
    let drifts = runs
        .iter()
        .filter_map(|run| run.optional_number(Measure::V_PD));
    let drifts: Vec<f64> = drifts.collect();
    let ordered = (
        numbers(Measure::ORDERED_TIME),
        numbers(Measure::ORDERED_INTERVALS),
    );
    let unordered = (
        numbers(Measure::UNORDERED_TIME),
        numbers(Measure::UNORDERED_INTERVALS),
    );
    let reached = ordered.1.iter().all(|&intervals| intervals > 0.0);
    let interval = |(times, intervals): &(Vec<f64>, Vec<f64>)| {
        let pairs: Vec<_> = times
            .iter()
            .copied()
            .zip(intervals.iter().copied())
            .collect();
        if reached { mean_interval(&pairs) } else { None }
    };
    let [ordered_time, unordered_time] =
        [&ordered.0, &unordered.0].map(|it| it.iter().sum::<f64>());
    Summary {
        runs: runs.len(),
        v_pd: (drifts.len() == runs.len()).then(|| mean_of(&drifts)),
        build_up: interval(&unordered),
        breakdown: interval(&ordered),
        n_eff: n_eff(condition.n, v.mean),
        ordered_share: ordered_time / (ordered_time + unordered_time),
        crossed_share: mean_of(&numbers(Measure::CROSSED_SHARE)).mean,
        extra: extra(&condition, runs),
        condition,
        v,
    }
}

/// Summarises the columns that only some experiments have, except for variables.
fn extra(condition: &Condition, runs: &[&ResultRow]) -> Vec<ExtraSummary> {
    let mut names: Vec<&str> = Vec::new();
    for ExtraValue { name, .. } in runs.iter().flat_map(|run| &run.extra) {
        let is_variable = condition
            .others
            .split(' ')
            .any(|pair| pair.split_once('=').is_some_and(|(it, _)| it == name));
        if !is_variable && !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    let summary = |name: &str| {
        let values: Vec<f64> = runs.iter().filter_map(|run| run.extra(name)).collect();
        ExtraSummary {
            name: name.to_owned(),
            runs: values.len(),
            spread: (!values.is_empty()).then(|| mean_of(&values)),
        }
    };
    names.into_iter().map(summary).collect()
}

impl Spread {
    /// Returns half the length of the 95 % interval of the mean of `runs` runs, from Student's t
    /// distribution; none for one run.
    #[must_use]
    pub fn half_width(&self, runs: usize) -> Option<f64> {
        let freedom = runs.checked_sub(1)?;
        self.error.map(|error| error * student_t(freedom as u64))
    }
}

/// Returns the 97.5 % quantile of Student's t distribution with so many degrees of freedom, at least 1.
///
/// Abramowitz and Stegun: by bisection of the finite sums 26.7.3 and 26.7.4; beyond 200 degrees by
/// the expansion 26.7.5, whose error is below 1e-8 there.
fn student_t(freedom: u64) -> f64 {
    const NORMAL: f64 = 1.959_963_984_540_054;
    let count = freedom as f64;
    if freedom > 200 {
        let z = NORMAL;
        let (three, five) = (z * z * z, z * z * z * z * z);
        let second = (5.0 * five + 16.0 * three + 3.0 * z) / 96.0;
        let third = (3.0 * five * z * z + 19.0 * five + 17.0 * three - 15.0 * z) / 384.0;
        return z + ((three + z) / 4.0 + (second + third / count) / count) / count;
    }
    let within = |angle: f64| {
        let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
        let is_odd = freedom % 2 == 1;
        let (mut term, mut sum) = (if is_odd { cosine } else { 1.0 }, 0.0);
        let mut degree = if is_odd { 1 } else { 0 };
        while degree + 2 <= freedom {
            sum += term;
            term *= cosine * cosine * (degree + 1) as f64 / (degree + 2) as f64;
            degree += 2;
        }
        match is_odd {
            true => (angle + sine * sum) / std::f64::consts::FRAC_PI_2,
            false => sine * sum,
        }
    };
    let (mut low, mut high) = (0.0, std::f64::consts::FRAC_PI_2);
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        match within(middle) < 0.95 {
            true => low = middle,
            false => high = middle,
        }
    }
    libm::tan(low) * count.sqrt()
}

/// Averages `values`, at least one.
#[must_use]
pub fn mean_of(values: &[f64]) -> Spread {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values
        .iter()
        .map(|value| (value - mean) * (value - mean))
        .sum();
    let deviation = (values.len() > 1).then(|| (squares / (count - 1.0)).sqrt());
    Spread {
        mean,
        deviation,
        error: deviation.map(|deviation| deviation / count.sqrt()),
    }
}

/// Divides the total time by the number of intervals. Returns `None` if there are no intervals.
///
/// Runs with few long intervals weigh less than in a mean of per-run means. The error is that of a
/// ratio of sums, `√(Σ (time - mean · intervals)² / (N (N - 1))) / mean intervals`.
fn mean_interval(runs: &[(f64, f64)]) -> Option<Interval> {
    let count = runs.len() as f64;
    let time: f64 = runs.iter().map(|(time, _)| time).sum();
    let intervals: f64 = runs.iter().map(|(_, intervals)| intervals).sum();
    if intervals == 0.0 {
        return None;
    }
    let mean = time / intervals;
    let squares: f64 = runs
        .iter()
        .map(|&(time, intervals)| time - mean * intervals)
        .map(|residual| residual * residual)
        .sum();
    let error = (squares / (count * (count - 1.0))).sqrt() / (intervals / count);
    Some(Interval {
        mean,
        error: (runs.len() > 1).then_some(error),
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
