//! Means of a column of results over a varied value, and of a measure over time, for charts.

use std::collections::BTreeMap;

use crate::statistics::{Spread, compare_values, mean_of};
use crate::table::Series;
use crate::{COLUMNS, Cell, CellKind, ResultRow};

/// The mean of one point of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// The varied value, or the time.
    pub x: f64,
    /// The mean over the runs that have a value, with its standard error.
    pub spread: Spread,
    /// The number of these runs.
    pub runs: usize,
    /// Whether the curve has entries without a value between the point before and this one.
    pub after_gap: bool,
}

impl Mean {
    /// Returns half the length of the 95 % interval of the mean; none for one run.
    #[must_use]
    pub fn half_width(&self) -> Option<f64> {
        self.spread.half_width(self.runs)
    }
}

/// The means of one combination of the other varied values.
#[derive(Clone, Debug, PartialEq)]
pub struct MeanCurve {
    /// These values, as in the names of the runs: `pi1=4 share=0.1`; empty if no other value varies.
    pub label: String,
    /// Its points, ascending by `x`.
    pub points: Vec<Mean>,
}

/// The data of a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// The name of the horizontal axis: a varied value, or `time`.
    pub x: String,
    /// The name of the column or measure.
    pub y: String,
    /// The curves, ordered by their values.
    pub curves: Vec<MeanCurve>,
    /// The number of runs.
    pub runs: usize,
    /// The number of runs that have no value, which are left out.
    pub left_out: usize,
    /// The conditions of which no run has a value, such as `pi1=2 share=0.1`, ordered by their values.
    pub empty: Vec<String>,
    /// The number of runs that end before others of their condition; 0 unless over time.
    pub ended_early: usize,
}

/// An error of choosing what a chart shows.
#[derive(Debug, thiserror::Error)]
pub enum ChartError {
    /// There are no runs.
    #[error("the results have no runs: draw them when a run is finished")]
    Empty,
    /// A fault ended every run.
    #[error("all {runs} runs ended by a fault: none can be drawn, `results --csv` has the reasons")]
    Faulted {
        /// Number of runs.
        runs: usize,
    },
    /// The horizontal axis was measured.
    #[error(
        "--x {name}: it is measured, so that runs of one condition differ in it: choose a value that \
         is set, one of {}", available.join(", ")
    )]
    Measured {
        /// The column.
        name: String,
        /// The names that can be chosen.
        available: Vec<String>,
    },
    /// The horizontal axis has one value.
    #[error(
        "--x {name}: it is {value} in all {runs} runs: {}",
        remedy_of_constant(varied)
    )]
    Constant {
        /// The column or the value.
        name: String,
        /// Its value.
        value: f64,
        /// Number of runs.
        runs: usize,
        /// The values that vary.
        varied: Vec<String>,
    },
    /// A name is unknown.
    #[error("{option} {name}: no such {kind}, use one of {}", available.join(", "))]
    Unknown {
        /// The option that has the name.
        option: &'static str,
        /// What the name should be.
        kind: &'static str,
        /// The name.
        name: String,
        /// The names that exist.
        available: Vec<String>,
    },
    /// No value varies.
    #[error("no number varies in these results: draw a measure with --over-time")]
    NothingVaries,
    /// Several values vary.
    #[error("several values vary, {}: choose one with --x", varied.join(", "))]
    Ambiguous {
        /// The varied values that are numbers.
        varied: Vec<String>,
    },
    /// A varied value is not a number.
    #[error("--x {name}: {value:?} is no number, choose a value with numbers")]
    NotANumber {
        /// The varied value.
        name: String,
        /// One of its values.
        value: String,
    },
    /// No run has a value.
    #[error("none of the {runs} runs has a value of {name}")]
    Undefined {
        /// The column.
        name: String,
        /// Number of runs.
        runs: usize,
    },
}

fn remedy_of_constant(varied: &[String]) -> String {
    match varied {
        [] => "no value varies".to_owned(),
        _ => format!("choose one that varies, {}", varied.join(", ")),
    }
}

/// Removes the runs that a fault ended, whose means are those of a shorter time; returns their names.
///
/// # Errors
///
/// [`ChartError::Faulted`] if none is left of some.
pub fn remove_faulted(rows: &mut Vec<ResultRow>) -> Result<Vec<String>, ChartError> {
    let runs = rows.len();
    let faulted: Vec<String> = rows
        .extract_if(.., |row| row.fault.is_some())
        .map(|row| row.run)
        .collect();
    match rows.is_empty() && runs > 0 {
        true => Err(ChartError::Faulted { runs }),
        false => Ok(faulted),
    }
}

/// Values with their names, as in the name of a run.
pub type Values = Vec<(String, String)>;

/// Returns the values in the name of a run.
#[must_use]
pub fn values_of(run: &str) -> Values {
    let pairs = run.split(' ').filter_map(|pair| pair.split_once('='));
    pairs
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .collect()
}

/// Returns the names of the values that differ between runs, in the order of the first run's name.
#[must_use]
pub fn varied(runs: &[Values]) -> Vec<String> {
    let mut all: Vec<(&str, Vec<Option<&str>>)> = Vec::new();
    for (name, _) in runs.iter().flatten() {
        if all.iter().all(|(it, _)| it != name) {
            let of = |run: &Values| run.iter().position(|(it, _)| it == name);
            let values = runs.iter().map(|run| of(run).map(|at| run[at].1.as_str()));
            all.push((name, values.collect()));
        }
    }
    let varies = |values: &[Option<&str>]| values.iter().any(|value| *value != values[0]);
    let varied = all.into_iter().filter(|(_, values)| varies(values));
    varied.map(|(name, _)| name.to_owned()).collect()
}

/// Returns the columns that a chart can show: measures of every table, then those of this one.
#[must_use]
pub fn columns(rows: &[ResultRow]) -> Vec<String> {
    let is_number = |kind| matches!(kind, CellKind::Number | CellKind::OptionalNumber);
    let fixed = COLUMNS
        .iter()
        .filter(|column| is_number(column.kind) || column.kind == CellKind::Count)
        .map(|column| column.name.to_owned());
    let mut names: Vec<String> = fixed.filter(|name| name != "seed").collect();
    for extra in rows.iter().flat_map(|row| &row.extra) {
        if !names.contains(&extra.name) {
            names.push(extra.name.clone());
        }
    }
    names
}

/// Returns the columns of numbers that a run is given, and does not measure.
fn is_set(name: &str) -> bool {
    ["n", "pi1", "pi2", "pi3", "pi4", "informed", "dt"].contains(&name)
}

/// Returns a number of a row.
fn number(row: &ResultRow, name: &str) -> Option<f64> {
    let value = match COLUMNS.iter().find(|column| column.name == name) {
        None => row.extra(name),
        Some(column) => match column.get(row) {
            Cell::Count(count) => Some(count as f64),
            Cell::Number(number) => Some(number),
            Cell::Absent | Cell::Text(_) => None,
        },
    };
    value.filter(|value| value.is_finite())
}

/// Returns the mean of column `y` over `x`, a varied value or a parameter; none is the only number that
/// varies. There is a curve for each combination of the other varied values.
///
/// # Errors
///
/// [`ChartError`].
pub fn over_value(rows: &[ResultRow], y: &str, x: Option<&str>) -> Result<Chart, ChartError> {
    if rows.is_empty() {
        return Err(ChartError::Empty);
    }
    let available = columns(rows);
    if !available.iter().any(|name| name == y) {
        return Err(ChartError::Unknown {
            option: "--y",
            kind: "column",
            name: y.to_owned(),
            available,
        });
    }
    let names: Vec<Values> = rows.iter().map(|row| values_of(&row.run)).collect();
    let varied = varied(&names);
    let x = choose(&names, &varied, &available, x)?;
    let mut curves: Vec<(Values, BTreeMap<Ordered, Vec<f64>>)> = Vec::new();
    let mut left_out = 0;
    let mut conditions: Vec<(Values, bool)> = Vec::new();
    for (row, values) in rows.iter().zip(names) {
        let condition = values.iter().filter(|(name, _)| varied.contains(name));
        let condition: Values = condition.cloned().collect();
        let has_value = number(row, y).is_some();
        match conditions.iter_mut().find(|(it, _)| *it == condition) {
            Some((_, found)) => *found |= has_value,
            None => conditions.push((condition, has_value)),
        }
        let at = match values.iter().find(|(name, _)| *name == x) {
            Some((_, value)) => Some(parse(&x, value)?),
            None => number(row, &x),
        };
        let value = number(row, y);
        left_out += usize::from(at.is_none() || value.is_none());
        let Some(at) = at else {
            continue;
        };
        let others = values.into_iter().filter(|(name, _)| *name != x);
        let others: Values = others.filter(|(name, _)| varied.contains(name)).collect();
        let found = curves.iter().position(|(it, _)| *it == others);
        let index = found.unwrap_or_else(|| {
            curves.push((others, BTreeMap::new()));
            curves.len() - 1
        });
        curves[index]
            .1
            .entry(Ordered(at))
            .or_default()
            .extend(value);
    }
    curves.retain(|(_, points)| points.values().any(|values| !values.is_empty()));
    let points = curves.iter().flat_map(|(_, points)| points);
    let mut shown = points.filter_map(|(at, values)| (!values.is_empty()).then_some(at));
    if let Some(Ordered(value)) = shown.next()
        && rows.len() > 1
        && shown.all(|Ordered(other)| other == value)
    {
        let value = *value;
        let varied = varied.into_iter().filter(|name| *name != x).collect();
        return Err(ChartError::Constant {
            name: x,
            value,
            runs: rows.len(),
            varied,
        });
    }
    let curves = curves
        .into_iter()
        .map(|(others, points)| (others, means(points.into_iter().map(|(x, it)| (x.0, it)))));
    finish(Chart {
        x,
        y: y.to_owned(),
        curves: sorted(curves.collect()),
        runs: rows.len(),
        left_out,
        empty: empty(conditions),
        ended_early: 0,
    })
}

/// Chooses the horizontal axis.
fn choose(
    names: &[Values],
    varied: &[String],
    columns: &[String],
    x: Option<&str>,
) -> Result<String, ChartError> {
    let has = |name: &str| names.iter().flatten().any(|(it, _)| it == name);
    if let Some(x) = x {
        let is_column = columns.iter().any(|name| name == x);
        let parameters = || {
            let columns = columns.iter().filter(|name| is_set(name));
            let others = columns.filter(|name| !varied.contains(name));
            varied.iter().chain(others).cloned().collect()
        };
        return match (has(x) || is_set(x), is_column) {
            (true, _) => Ok(x.to_owned()),
            (false, true) => Err(ChartError::Measured {
                name: x.to_owned(),
                available: parameters(),
            }),
            (false, false) => Err(ChartError::Unknown {
                option: "--x",
                kind: "varied value or parameter",
                name: x.to_owned(),
                available: parameters(),
            }),
        };
    }
    let is_number = |name: &&String| {
        let mut values = names.iter().flatten().filter(|(it, _)| it == *name);
        values.all(|(_, value)| parse(name, value).is_ok())
    };
    match varied.iter().filter(is_number).collect::<Vec<_>>()[..] {
        [] => Err(ChartError::NothingVaries),
        [one] => Ok(one.clone()),
        ref several => Err(ChartError::Ambiguous {
            varied: several.iter().copied().cloned().collect(),
        }),
    }
}

fn parse(name: &str, value: &str) -> Result<f64, ChartError> {
    let number = value.parse().ok().filter(|number: &f64| number.is_finite());
    number.ok_or_else(|| ChartError::NotANumber {
        name: name.to_owned(),
        value: value.to_owned(),
    })
}

/// Returns the mean of measure `y` over time, with a curve for each condition.
///
/// A time is shown if every run of the condition has an entry there, or if it is one of the regular
/// entries: the last entry of a run that ended early is not.
///
/// # Errors
///
/// [`ChartError`].
pub fn over_time(all: &[Series], y: &str) -> Result<Chart, ChartError> {
    let Some(first) = all.first() else {
        return Err(ChartError::Empty);
    };
    if first.measures.iter().all(|measure| measure.name != y) {
        let measures = first.measures.iter();
        return Err(ChartError::Unknown {
            option: "--y",
            kind: "measure over time",
            name: y.to_owned(),
            available: measures.map(|measure| measure.name.clone()).collect(),
        });
    }
    let names: Vec<Values> = all.iter().map(|series| values_of(&series.run)).collect();
    let varied = varied(&names);
    let mut conditions: Vec<(Values, Vec<&Series>)> = Vec::new();
    for (series, values) in all.iter().zip(names) {
        let values = values.into_iter();
        let values: Values = values.filter(|(name, _)| varied.contains(name)).collect();
        match conditions.iter_mut().find(|(it, _)| *it == values) {
            Some((_, series_of)) => series_of.push(series),
            None => conditions.push((values, vec![series])),
        }
    }
    let (mut curves, mut left_out, mut ended_early) = (Vec::new(), 0, 0);
    let mut found = Vec::new();
    for (values, series) in conditions {
        let last = |series: &&Series| series.steps.last().copied();
        let longest = series.iter().filter_map(last).max();
        ended_early += series.iter().filter(|it| last(it) < longest).count();
        let has_value = |series: &&&Series| values_over_time(series, y).next().is_some();
        let with_value = series.iter().filter(has_value).count();
        left_out += series.len() - with_value;
        found.push((values.clone(), with_value > 0));
        if with_value > 0 {
            curves.push((values, means_over_time(&series, y)));
        }
    }
    finish(Chart {
        x: "time".to_owned(),
        y: y.to_owned(),
        curves: sorted(curves),
        runs: all.len(),
        left_out,
        empty: empty(found),
        ended_early,
    })
}

/// The step, the time and the value of the entries that have a value.
fn values_over_time<'a>(series: &'a Series, y: &str) -> impl Iterator<Item = (u64, f64, f64)> + 'a {
    let measure = series.measures.iter().find(|measure| measure.name == y);
    let values = measure.into_iter().flat_map(|measure| &measure.values);
    let entries = series.steps.iter().zip(&series.times).zip(values);
    entries.filter_map(|((&step, &time), value)| Some((step, time, (*value)?)))
}

fn means_over_time(series: &[&Series], y: &str) -> Vec<Mean> {
    // The time, the number of entries and the values of each step.
    let mut entries: BTreeMap<u64, (f64, usize, Vec<f64>)> = BTreeMap::new();
    for series in series {
        for (&step, &time) in series.steps.iter().zip(&series.times) {
            entries.entry(step).or_insert((time, 0, Vec::new())).1 += 1;
        }
        for (step, _, value) in values_over_time(series, y) {
            if let Some((.., values)) = entries.get_mut(&step) {
                values.push(value);
            }
        }
    }
    let every = series
        .iter()
        .filter_map(|it| Some(it.steps.get(1)? - it.steps[0]));
    let every = every.max().unwrap_or(1).max(1);
    entries.retain(|step, (_, count, _)| step.is_multiple_of(every) || *count == series.len());
    means(
        entries
            .into_values()
            .map(|(time, _, values)| (time, values)),
    )
}

/// Returns the means of the entries that have values.
fn means(entries: impl Iterator<Item = (f64, Vec<f64>)>) -> Vec<Mean> {
    let (mut means, mut after_gap) = (Vec::new(), false);
    for (x, values) in entries {
        if !values.is_empty() {
            means.push(Mean {
                x,
                spread: mean_of(&values),
                runs: values.len(),
                after_gap,
            });
        }
        after_gap = values.is_empty() && !means.is_empty();
    }
    means
}

/// Orders curves by their values, numbers by size.
fn sorted(mut curves: Vec<(Values, Vec<Mean>)>) -> Vec<MeanCurve> {
    curves.sort_by(|(one, _), (two, _)| compare_values(one, two));
    curves
        .into_iter()
        .map(|(values, points)| MeanCurve {
            label: label(values),
            points,
        })
        .collect()
}

/// Returns the conditions without a value.
fn empty(mut conditions: Vec<(Values, bool)>) -> Vec<String> {
    conditions.retain(|(_, has_value)| !has_value);
    conditions.sort_by(|(one, _), (two, _)| compare_values(one, two));
    conditions.into_iter().map(|(it, _)| label(it)).collect()
}

fn label(values: Values) -> String {
    let pairs = values
        .into_iter()
        .map(|(name, value)| format!("{name}={value}"));
    pairs.collect::<Vec<_>>().join(" ")
}

fn finish(chart: Chart) -> Result<Chart, ChartError> {
    match chart.curves.iter().all(|curve| curve.points.is_empty()) {
        true => Err(ChartError::Undefined {
            name: chart.y,
            runs: chart.runs,
        }),
        false => Ok(chart),
    }
}

/// A finite number as a key.
#[derive(PartialEq)]
struct Ordered(f64);

impl Eq for Ordered {}

impl PartialOrd for Ordered {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Ordered {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
