//! Reads the CSV of set-points.

use jostle_physics::model::parameters::{check_coordinate, check_share, check_weight};
use jostle_physics::model::{Drive, ParametersError};
use std::ops::Range;
use toml::Spanned;

use super::{COLUMNS, MODEL, Place, REQUIRED, Row, SetPoint, SetPointTable};
use crate::cells::Cells;
use crate::error::PlanError;
use crate::file::{File, Source};
use crate::files::{Files, is_text};
use crate::limits::MAX_SET_POINTS;

/// A number of a column of the CSV, from 1, and what is wrong there.
type Wrong = (usize, String);

impl SetPointTable {
    /// Reads the CSV that a file names or contains; none if it has none.
    ///
    /// # Errors
    ///
    /// [`PlanError`] with the line and the column.
    pub fn of(source: Source<'_>, file: &File, files: &Files) -> Result<Option<Self>, PlanError> {
        let span = file.setpoints.as_ref().map_or(0..0, Spanned::span);
        let reason = match (&file.setpoints, &files.setpoints) {
            (Some(text), None) if is_text(text.get_ref()) => {
                let place = Place::Within(line_before(source, &span));
                return Self::read(place, text.get_ref()).map(Some);
            }
            (Some(named), Some(text)) if !is_text(named.get_ref()) => {
                return Self::read(Place::File(named.get_ref().clone()), text).map(Some);
            }
            (Some(_), None) => {
                "setpoints: the contents of this file are missing: submit the experiment with a \
                 client of this version"
            }
            (_, Some(_)) => "a CSV of set-points was sent, but the file names none: give setpoints",
            (None, None) => return Ok(None),
        };
        Err(source.reject(&span, reason))
    }

    pub(super) fn read(place: Place, text: &str) -> Result<Self, PlanError> {
        let too_many = format!("more than {MAX_SET_POINTS} set-points: that is the limit of a run");
        let cells = Cells::read(text, MAX_SET_POINTS, &too_many);
        let Cells {
            header,
            rows,
            lines,
        } = cells.map_err(|(line, column, reason)| place.reject(line, column, reason))?;
        let header_line = lines.first().copied().unwrap_or(1);
        let columns = columns(&header)
            .map_err(|(column, reason)| place.reject(header_line, column, reason))?;
        let mut read: Vec<Row> = Vec::with_capacity(rows.len());
        // The first row of those with the same step and `after`.
        let mut first = 0;
        let mut ids = std::collections::HashSet::new();
        for (cells, &line) in rows.iter().zip(&lines[1..]) {
            let reject = |(column, reason)| place.reject(line, column, reason);
            let row = row(cells, &columns, line).map_err(reject)?;
            if let Some(last) = read.last() {
                let (now, before) = ((row.step, row.after), (last.step, last.after));
                if now < before {
                    let column = if row.step < last.step {
                        "step"
                    } else {
                        "after"
                    };
                    let reason = format!(
                        "{column} is below that of line {}: sort the rows",
                        last.line
                    );
                    return Err(reject((number(&columns, column), reason)));
                }
                if now > before {
                    first = read.len();
                    ids.clear();
                }
            }
            if !ids.insert(row.id) {
                let earlier = read[first..].iter().find(|it| it.id == row.id);
                let earlier = earlier.map_or(line, |it| it.line);
                let reason = format!(
                    "id = {} is also in line {earlier}, with the same step",
                    row.id
                );
                return Err(reject((number(&columns, "id"), reason)));
            }
            read.push(row);
        }
        Ok(Self {
            place,
            largest: read.iter().map(|row| row.id).max(),
            rows: read,
        })
    }
}

/// Returns the line before the text at `span`.
fn line_before(source: Source<'_>, span: &Range<usize>) -> usize {
    let text = source.toml.get(span.clone()).unwrap_or_default();
    let line = source.line(span);
    // A line break after the quotes is not a part of the text.
    let begins_below = text
        .trim_start_matches(['\'', '"'])
        .starts_with(['\n', '\r']);
    line - usize::from(!begins_below)
}

/// Returns the position of each column in a row.
fn columns(header: &[String]) -> Result<[Option<usize>; COLUMNS.len()], Wrong> {
    let mut columns = [None; COLUMNS.len()];
    for (at, name) in header.iter().enumerate() {
        let Some(known) = COLUMNS.iter().position(|it| it == name) else {
            let reason = format!("unknown column {name:?}: use {}", COLUMNS.join(", "));
            return Err((at + 1, reason));
        };
        if columns[known].replace(at).is_some() {
            return Err((at + 1, format!("column {name:?} is given twice")));
        }
    }
    let missing = (0..REQUIRED).find(|&known| columns[known].is_none());
    match missing {
        Some(known) => {
            let reason = format!(
                "column {:?} is missing: the columns are {}",
                COLUMNS[known],
                COLUMNS.join(", ")
            );
            Err((header.len() + 1, reason))
        }
        None => Ok(columns),
    }
}

/// Returns the number of a column in the CSV, from 1.
fn number(columns: &[Option<usize>; COLUMNS.len()], name: &str) -> usize {
    let known = COLUMNS.iter().position(|it| *it == name);
    known.and_then(|known| columns[known]).unwrap_or(0) + 1
}

fn row(
    cells: &[String],
    columns: &[Option<usize>; COLUMNS.len()],
    line: usize,
) -> Result<Row, Wrong> {
    let cell = |name: &str| {
        let known = COLUMNS.iter().position(|it| *it == name);
        let at = known.and_then(|known| columns[known]);
        at.map_or("", |at| cells[at].as_str())
    };
    let wrong = |name: &str, reason: String| (number(columns, name), reason);
    let whole = |name: &str, most: u64| {
        let value = cell(name).parse().ok().filter(|value| *value <= most);
        value.ok_or_else(|| {
            wrong(
                name,
                format!("{name} = {:?}: give a whole number, 0 or more", cell(name)),
            )
        })
    };
    let float = |name: &'static str, check: Check| match cell(name) {
        "" => Ok(None),
        text => {
            let value: f64 = text
                .parse()
                .map_err(|_| wrong(name, format!("{name} = {text:?} is no number")))?;
            check(name, value).map_err(|error| wrong(name, error.to_string()))?;
            Ok(Some(value))
        }
    };
    let direction = float("direction", check_coordinate)?;
    let weight = float("weight", check_weight)?;
    let driven = |name: &'static str, check: Check| match cell(name) {
        MODEL => Ok(None),
        _ => float(name, check),
    };
    let drive = match [cell("turn"), cell("speed")] {
        ["", ""] => None,
        ["", _] | [_, ""] => {
            let reason = format!("give turn and speed, or neither; {MODEL} is that of the model");
            let empty = if cell("turn").is_empty() {
                "turn"
            } else {
                "speed"
            };
            return Err(wrong(
                if columns[4].is_some() { empty } else { "speed" },
                reason,
            ));
        }
        _ => Some(Drive {
            turn: driven("turn", check_coordinate)?,
            speed: driven("speed", check_share)?,
        }),
    };
    let point = match (direction, weight, drive) {
        (Some(direction), weight, drive) => SetPoint::Steer {
            direction,
            weight,
            drive,
        },
        (None, None, None) => SetPoint::Release,
        (None, ..) => {
            let reason = "no direction: give one, or leave all cells after id empty, which makes \
                          the individual uninformed";
            return Err(wrong("direction", reason.to_owned()));
        }
    };
    Ok(Row {
        step: whole("step", u64::MAX)?,
        after: match cell("after") {
            "" => u64::MAX,
            _ => whole("after", u64::MAX - 1)?,
        },
        id: u32::try_from(whole("id", u64::from(u32::MAX))?).unwrap_or(u32::MAX),
        point,
        line,
    })
}

type Check = fn(&'static str, f64) -> Result<(), ParametersError>;
