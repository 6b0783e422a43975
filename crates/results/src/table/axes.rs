//! Columns of the axes of a grid that are no columns of every table. Their values are in the names of
//! the runs, which rows of all versions have.

use jostle_proto::{AXES, Axis, OccasionalColumns};

use crate::{COLUMNS, Cell, ResultRow};

/// Returns the names of the columns that only some experiments have: axes that vary, then the others.
#[must_use]
pub fn occasional(columns: &OccasionalColumns) -> Vec<String> {
    let axes = columns.varied.iter().filter(|name| is_axis(name));
    let extra = columns.extra.iter().filter(|name| !is_axis(name));
    axes.chain(extra).cloned().collect()
}

/// Returns the names of these axes that `first` contains or that a run has in its name.
pub fn of<'a>(runs: &'a [ResultRow], first: &'a [String]) -> impl Iterator<Item = &'static str> {
    let names = AXES.iter().map(|it| it.name.as_str());
    names.filter(|name| {
        is_axis(name)
            && (first.iter().any(|it| it == name)
                || runs.iter().any(|run| value(run, name).is_some()))
    })
}

pub fn is_axis(name: &str) -> bool {
    axis(name).is_some()
}

/// Whether a column that only some experiments have has text in it.
pub fn is_text(name: &str) -> bool {
    axis(name).is_some_and(|it| it.is_text)
}

fn axis(name: &str) -> Option<&'static Axis> {
    Axis::of(name).filter(|_| COLUMNS.iter().all(|column| column.name != name))
}

/// Returns the value of an axis in the name of a run.
pub fn value<'a>(run: &'a ResultRow, axis: &str) -> Option<&'a str> {
    let mut pairs = run.run.split(' ').filter_map(|pair| pair.split_once('='));
    pairs
        .find(|(name, _)| *name == axis)
        .map(|(_, value)| value)
}

/// Returns the value of a column of numbers that only some experiments have.
pub fn number(run: &ResultRow, name: &str) -> Option<f64> {
    match is_axis(name) {
        true => value(run, name)?.parse().ok(),
        false => run.extra(name),
    }
}

/// Returns the value of a column that only some experiments have.
pub fn cell(run: &ResultRow, name: &str) -> Cell {
    match is_text(name) {
        true => value(run, name).map_or(Cell::Absent, |it| Cell::Text(it.to_owned().into())),
        false => number(run, name).into(),
    }
}
