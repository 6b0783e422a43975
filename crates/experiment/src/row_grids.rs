//! The grids of a CSV: one for each row, with a single condition.

use std::collections::BTreeSet;

use jostle_proto::Axis;
use toml::{Spanned, Value};

use crate::error::PlanError;
use crate::file::Source;
use crate::grid::{Grid, axes, check_axis};
use crate::points::Points;

/// The largest distance from 0 of whole numbers that a double represents.
const MAX_WHOLE: f64 = 9_007_199_254_740_992.0;

/// Returns a grid for each row, with one value on each axis.
///
/// # Errors
///
/// [`PlanError::Points`] with the first cell that is wrong.
pub fn grids(
    points: &Points,
    source: Source<'_>,
    used: &BTreeSet<String>,
    replicates: u64,
) -> Result<Vec<Grid>, PlanError> {
    let header = points.header();
    let columns = header.len();
    let mut places = Vec::with_capacity(columns);
    for (column, name) in header.iter().enumerate() {
        let span = points.span(column);
        if name.is_empty() {
            let reason = "the column has no name: name it, or write the file without an index";
            return Err(source.reject(&span, reason));
        }
        if header[..column].contains(name) {
            let reason = format!("duplicate column {name:?}: leave out one of them");
            return Err(source.reject(&span, reason));
        }
        if Axis::of(name).is_none() && !used.contains(name) {
            let separated = match name.contains([';', '\t']) {
                true => "separate columns by commas, and ",
                false => "",
            };
            let axes = axes();
            let reason = format!(
                "unknown column {name:?}: {separated}use {axes}, or a variable that an [[at]] or \
                 [stop] uses as \"$name\""
            );
            return Err(source.reject(&span, reason));
        }
        places.push(check_axis(source, name, &span, used)?);
    }
    let rows = points.rows().iter().enumerate();
    rows.map(|(row, cells)| {
        let mut grid = Grid {
            axes: Vec::with_capacity(columns),
            replicates,
            span: points.span((row + 1) * columns),
        };
        for (column, text) in cells.iter().enumerate() {
            let span = points.span((row + 1) * columns + column);
            let value = value(text).map_err(|reason| source.reject(&span, reason))?;
            let named = (header[column].as_str(), places[column]);
            grid.add(source, named, vec![Spanned::new(span, value)])?;
        }
        grid.finished(source)
    })
    .collect()
}

/// Returns the value of a cell: a number, a table as in a TOML, or a text.
fn value(text: &str) -> Result<Value, String> {
    if text.is_empty() {
        return Err("the cell is empty: give a value".to_owned());
    }
    if let Ok(number) = text.parse() {
        return Ok(Value::Integer(number));
    }
    if let Ok(number) = text.parse::<f64>() {
        let is_whole = number.fract() == 0.0 && number.abs() < MAX_WHOLE;
        #[expect(clippy::cast_possible_truncation, reason = "whole and in range")]
        return match number.is_finite() {
            // Programs write whole numbers as 5.0 or 5e0, too.
            true if is_whole => Ok(Value::Integer(number as i64)),
            true => Ok(Value::Float(number)),
            false => Err(format!("{text} is not a finite number: give one")),
        };
    }
    if text.starts_with('{') {
        let parsed = toml::from_str::<toml::Table>(&format!("value = {text}"));
        return match parsed.ok().and_then(|mut it| it.remove("value")) {
            Some(table) => Ok(table),
            None => Err(format!("{text} is no table of TOML")),
        };
    }
    Ok(Value::String(text.to_owned()))
}
