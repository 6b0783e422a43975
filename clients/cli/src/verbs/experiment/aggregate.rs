//! Means of results over the runs that share the values of some axes.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use jostle_results::chart::{Values, values_of, varied};
use jostle_results::statistics::{Spread, compare_values, mean_of};
use jostle_results::{COLUMNS, Cell, ResultRow};
use serde_json::{Value, json};

use crate::failure::Failure;
use crate::format;
use crate::suggest::did_you_mean;
use crate::table;
use crate::units::unit;

/// The axis whose values are the names of runs.
const RUN: &str = "run";
/// The columns of every table that are averaged.
const MEANS: [&str; 3] = ["v", "v_pd", "crossed_share"];

/// Means, a group for each combination of the values of some axes.
pub struct Aggregates<'a> {
    by: Vec<String>,
    /// What is averaged.
    names: Vec<String>,
    groups: Vec<Group<'a>>,
    /// The number of groups that a limit leaves out.
    left_out: usize,
}

struct Group<'a> {
    values: Values,
    runs: Vec<&'a ResultRow>,
}

impl<'a> Aggregates<'a> {
    /// Groups the runs by these axes, or by all that vary; at most `most` groups.
    pub fn of(rows: &'a [ResultRow], by: Option<&[String]>, most: usize) -> Result<Self, Failure> {
        let named: Vec<Values> = rows.iter().map(|row| values_of(&row.run)).collect();
        let by = match by {
            Some(by) => by.to_vec(),
            None => varied(&named),
        };
        let mut groups: Vec<Group> = Vec::new();
        for (row, named) in rows.iter().zip(&named) {
            let values = by.iter().map(|axis| {
                let value = value(row, named, axis).ok_or_else(|| unknown(axis, row, named))?;
                Ok((axis.clone(), value))
            });
            let values = values.collect::<Result<Values, Failure>>()?;
            match groups.iter_mut().find(|group| group.values == values) {
                Some(group) => group.runs.push(row),
                None => groups.push(Group {
                    values,
                    runs: vec![row],
                }),
            }
        }
        groups.sort_by(|a, b| compare(&a.values, &b.values));
        let left_out = groups.len().saturating_sub(most);
        groups.truncate(groups.len() - left_out);
        let mut names = MEANS.map(str::to_owned).to_vec();
        for extra in rows.iter().flat_map(|row| &row.extra) {
            // A variable of the grid is a column, too.
            let is_axis = named.iter().flatten().any(|(axis, _)| *axis == extra.name);
            if !is_axis && !names.contains(&extra.name) {
                names.push(extra.name.clone());
            }
        }
        Ok(Self {
            by,
            names,
            groups,
            left_out,
        })
    }

    /// The number of groups that the limit left out.
    pub fn left_out(&self) -> usize {
        self.left_out
    }

    /// A line for each group.
    pub fn table(&self) -> String {
        let cells = |cell: &dyn Fn(&Group) -> String| self.groups.iter().map(cell).collect();
        let mut columns: Vec<(&str, Vec<String>)> = Vec::new();
        for (index, axis) in self.by.iter().enumerate() {
            columns.push((axis, cells(&|it| it.values[index].1.clone())));
        }
        columns.push(("runs", cells(&|it| it.runs.len().to_string())));
        for name in &self.names {
            columns.push((name, cells(&|it| it.mean_text(name))));
        }
        table::columns(&columns)
    }

    /// The same for programs.
    pub fn to_json(&self, experiment: &str, runs: usize) -> Value {
        let groups = self.groups.iter().map(|group| {
            let values = group.values.iter().map(|(axis, text)| {
                let number = text.parse::<f64>().ok().filter(|it| it.is_finite());
                (
                    axis.clone(),
                    number.map_or_else(|| json!(text), |it| json!(it)),
                )
            });
            let values: BTreeMap<String, Value> = values.collect();
            let means = self.names.iter().map(|name| {
                let (count, spread) = group.mean(name);
                let mean = spread.map(|it| it.mean);
                let error = spread.and_then(|it| it.error);
                (name, json!({"mean": mean, "error": error, "n": count}))
            });
            let means: BTreeMap<&String, Value> = means.collect();
            json!({"values": values, "runs": group.runs.len(), "means": means})
        });
        let units = self.names.iter().map(|name| (name, unit(name)));
        json!({
            "experiment": experiment,
            "runs": runs,
            "by": self.by,
            "units": units.collect::<BTreeMap<_, _>>(),
            "groups": groups.collect::<Vec<_>>(),
            "left_out": self.left_out,
        })
    }
}

impl Group<'_> {
    /// The mean over the runs in which a column is defined, and their number.
    fn mean(&self, name: &str) -> (usize, Option<Spread>) {
        let values = self.runs.iter().filter_map(|row| number(row, name));
        let values: Vec<f64> = values.collect();
        let spread = (!values.is_empty()).then(|| mean_of(&values));
        (values.len(), spread)
    }

    fn mean_text(&self, name: &str) -> String {
        let (count, spread) = self.mean(name);
        let Some(Spread { mean, error, .. }) = spread else {
            return format::NONE.to_owned();
        };
        let mut text = format::fixed(mean, 4);
        // Its error is not what one looks for.
        if let Some(error) = error.filter(|_| name != "crossed_share") {
            text.push_str(&format!(" ± {error:.4}"));
        }
        match count == self.runs.len() {
            true => text,
            false => format!("{text} ({count} of {})", self.runs.len()),
        }
    }
}

/// The value of an axis, as in the names of runs; none if there is no such axis.
fn value(row: &ResultRow, named: &Values, axis: &str) -> Option<String> {
    if let Some((_, value)) = named.iter().find(|(name, _)| name == axis) {
        return Some(value.clone());
    }
    if axis == RUN {
        return Some(row.run.clone());
    }
    let is_set = SET.contains(&axis);
    let column = COLUMNS.iter().find(|column| column.name == axis && is_set);
    match column.map(|column| column.get(row)) {
        Some(Cell::Count(count)) => Some(count.to_string()),
        Some(Cell::Number(number)) => Some(number.to_string()),
        Some(Cell::Text(text)) => Some(text.into()),
        // Another grid of the experiment has it.
        Some(Cell::Absent) | None if row.extra.iter().any(|it| it.name == axis) => {
            Some(format::NONE.to_owned())
        }
        Some(Cell::Absent) | None => None,
    }
}

/// The columns that a run is given, and does not measure.
const SET: [&str; 8] = [
    "contacts", "n", "pi1", "pi2", "pi3", "pi4", "informed", "dt",
];

fn unknown(axis: &str, row: &ResultRow, named: &Values) -> Failure {
    let mut there: Vec<&str> = named.iter().map(|(name, _)| name.as_str()).collect();
    let others = SET.into_iter().chain([RUN]);
    there.extend(others.filter(|it| !named.iter().any(|(name, _)| name == it)));
    let question = did_you_mean(axis, there.iter().copied());
    let question = question.map_or_else(String::new, |it| format!("{it} "));
    let list = there.join(", ");
    let problem = format!(
        "{axis} is no axis of {}: {question}use some of {list}",
        row.run
    );
    Failure::argument("--by", problem)
}

/// A column as a number, if it is one.
fn number(row: &ResultRow, name: &str) -> Option<f64> {
    let value = match COLUMNS.iter().find(|column| column.name == name) {
        Some(column) => match column.get(row) {
            Cell::Number(number) => Some(number),
            Cell::Count(count) => Some(count as f64),
            Cell::Absent | Cell::Text(_) => None,
        },
        None => row.extra(name),
    };
    value.filter(|it| it.is_finite())
}

/// The order of groups: by number, and `endpoints`, the exact rule, before `closest`.
fn compare(one: &Values, two: &Values) -> Ordering {
    let rule = |values: &Values| {
        let mut rules = values.iter().filter(|(axis, _)| axis == "contacts");
        rules.next().map(|(_, rule)| rule.clone())
    };
    let by_rule = rule(two).cmp(&rule(one));
    by_rule.then_with(|| compare_values(one, two))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use jostle_results::Measure;

    use super::*;
    use crate::fixtures;

    #[test]
    fn a_mean_is_over_the_runs_in_which_a_value_is_defined_and_says_how_many() {
        let row = |n: u64, number: u32, drift: Option<f64>| {
            let mut row = ResultRow {
                run: format!("n={n} #{number}"),
                n,
                ..fixtures::result_row()
            };
            row.set(Measure::V_PD, drift.into());
            row.set(Measure::V, 0.5.into());
            row
        };
        let rows = [
            row(3, 0, Some(0.25)),
            row(3, 1, None),
            row(3, 2, Some(0.75)),
            row(5, 0, None),
            row(5, 1, None),
        ];
        let all = Aggregates::of(&rows, None, 10).unwrap();
        let json = all.to_json("some", rows.len());
        let means = |group: usize| json["groups"][group]["means"].clone();
        assert_eq!(
            (&json["groups"][0]["runs"], &json["groups"][1]["runs"]),
            (&json!(3), &json!(2))
        );
        assert_eq!(
            means(0)["v_pd"],
            json!({"mean": 0.5, "error": 0.25, "n": 2})
        );
        assert_eq!(means(0)["v"], json!({"mean": 0.5, "error": 0.0, "n": 3}));
        assert_eq!(
            means(1)["v_pd"],
            json!({"mean": null, "error": null, "n": 0})
        );
        let table = all.table();
        let lines: Vec<&str> = table.lines().collect();
        assert!(lines[1].contains("0.5000 ± 0.2500 (2 of 3)"), "{table}");
    }
}
