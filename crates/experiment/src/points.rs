//! A CSV with the conditions of a plan: a row for each condition, a column for each axis or variable.

use std::ops::Range;

use crate::cells::Cells;
use crate::error::PlanError;
use crate::files::shown;
use crate::limits::MAX_RUNS;

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
        let reject = |(line, column, reason)| PlanError::Points {
            file: file.to_owned(),
            line,
            column,
            reason: shown(file, reason),
        };
        let too_many = format!("more than {MAX_RUNS} conditions: that is the limit of runs");
        let Cells {
            header,
            rows,
            lines,
        } = Cells::read(text, MAX_RUNS, &too_many).map_err(reject)?;
        if rows.is_empty() {
            let reason = "no condition: give a header with the names and a row for each condition";
            return Err(reject((lines.len() + 1, 1, reason.to_owned())));
        }
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

    /// Returns the names in the header.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    /// Returns the rows after the header, each with a cell for each name.
    pub fn rows(&self) -> &[Vec<String>] {
        &self.rows
    }

    /// Returns the span of a cell, counted by rows from the first one of the header.
    pub fn span(&self, cell: usize) -> Range<usize> {
        self.first + cell..self.first + cell + 1
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
