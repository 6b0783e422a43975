//! The conditions of a plan from a CSV: a row for each condition, a column for each axis or variable.

use std::collections::BTreeSet;
use std::ops::Range;

use csv::{ReaderBuilder, StringRecord, Trim};
use toml::{Spanned, Value};

use crate::error::PlanError;
use crate::file::Source;
use crate::grid::{AXES, Grid, check_axis};

/// The largest distance from 0 of whole numbers that a double represents.
const MAX_WHOLE: f64 = 9_007_199_254_740_992.0;

/// The cells of a CSV. Each has a span after the end of the TOML, from which errors get its place.
pub struct Points {
    /// The file, as the TOML names it.
    pub file: String,
    /// The line of each row, from 1; the first is that of the header.
    lines: Vec<usize>,
    /// The rows after the header.
    rows: Vec<Vec<String>>,
    header: Vec<String>,
    /// The start of the span of the first cell.
    first: usize,
}

impl Points {
    /// Reads a CSV; `first` is the start of the span of its first cell.
    ///
    /// # Errors
    ///
    /// [`PlanError::Points`]: there is no header or no row, or a row has too few or too many cells.
    pub fn read(file: &str, text: &str, first: usize) -> Result<Self, PlanError> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let reject = |line, column, reason: String| {
            Err(PlanError::Points {
                file: file.to_owned(),
                line,
                column,
                reason,
            })
        };
        let mut reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(Trim::All)
            .from_reader(text.as_bytes());
        let (mut lines, mut rows): (Vec<usize>, Vec<Vec<String>>) = (Vec::new(), Vec::new());
        let mut line = Lines { at: 0, number: 1 };
        let mut record = StringRecord::new();
        loop {
            let start = usize::try_from(reader.position().byte()).unwrap_or(usize::MAX);
            let number = line.of(text, start);
            match reader.read_record(&mut record) {
                Ok(false) => break,
                Ok(true) => {}
                Err(error) => return reject(number, 1, error.to_string()),
            }
            if let Some(header) = rows.first()
                && header.len() != record.len()
            {
                let (cells, columns) = (record.len(), header.len());
                let reason = format!("{cells} cells, but the header has {columns} columns");
                return reject(number, cells.min(columns) + 1, reason);
            }
            lines.push(number);
            rows.push(record.iter().map(str::to_owned).collect());
        }
        if rows.len() < 2 {
            let reason = "no condition: give a header with the names and a row for each condition";
            return reject(lines.len() + 1, 1, reason.to_owned());
        }
        let header = rows.remove(0);
        Ok(Self {
            file: file.to_owned(),
            lines,
            rows,
            header,
            first,
        })
    }

    /// Returns the line and the column of a cell, from 1; none if the span is not of a cell.
    pub fn place(&self, span: &Range<usize>) -> Option<(usize, usize)> {
        let cell = span.start.checked_sub(self.first)?;
        let line = self.lines.get(cell / self.header.len())?;
        Some((*line, cell % self.header.len() + 1))
    }

    /// Returns a grid for each row, with one value on each axis.
    ///
    /// # Errors
    ///
    /// [`PlanError::Points`] with the first cell that is wrong.
    pub fn grids(
        &self,
        source: Source<'_>,
        used: &BTreeSet<String>,
        replicates: u64,
    ) -> Result<Vec<Grid>, PlanError> {
        let columns = self.header.len();
        for (column, name) in self.header.iter().enumerate() {
            let span = self.span(column);
            if name.is_empty() {
                let reason = "the column has no name: name it, or write the file without an index";
                return Err(source.reject(&span, reason));
            }
            if self.header[..column].contains(name) {
                let reason = format!("duplicate column {name:?}: leave out one of them");
                return Err(source.reject(&span, reason));
            }
            if !AXES.contains(&name.as_str()) && !used.contains(name) {
                let separated = match name.contains([';', '\t']) {
                    true => "separate columns by commas, and ",
                    false => "",
                };
                let axes = AXES.join(", ");
                let reason = format!(
                    "unknown column {name:?}: {separated}use {axes}, or a variable that an [[at]] or \
                     [stop] uses as \"$name\""
                );
                return Err(source.reject(&span, reason));
            }
            check_axis(source, name, &span, used)?;
        }
        let rows = self.rows.iter().enumerate();
        rows.map(|(row, cells)| {
            let mut grid = Grid {
                axes: Vec::with_capacity(columns),
                replicates,
                span: self.span((row + 1) * columns),
            };
            for (column, text) in cells.iter().enumerate() {
                let span = self.span((row + 1) * columns + column);
                let value = value(text).map_err(|reason| source.reject(&span, reason))?;
                grid.add(
                    source,
                    &self.header[column],
                    vec![Spanned::new(span, value)],
                )?;
            }
            grid.finished(source)
        })
        .collect()
    }

    fn span(&self, cell: usize) -> Range<usize> {
        self.first + cell..self.first + cell + 1
    }
}

/// The number of the line at a byte, for ascending bytes.
struct Lines {
    at: usize,
    number: usize,
}

impl Lines {
    /// Returns the line of the first character after `start` that is no line break.
    fn of(&mut self, text: &str, start: usize) -> usize {
        let rest = text.get(start..).unwrap_or_default();
        let blank = rest.len() - rest.trim_start_matches(['\n', '\r']).len();
        let passed = text.get(self.at..start + blank).unwrap_or_default();
        self.number += passed.bytes().filter(|&byte| byte == b'\n').count();
        self.at = start + blank;
        self.number
    }
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

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
