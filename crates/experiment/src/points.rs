//! A CSV with the conditions of a plan: a row for each condition, a column for each axis or variable.

use std::ops::Range;

use csv::{ReaderBuilder, StringRecord, Trim};

use crate::error::PlanError;
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
            if rows.len() as u64 > MAX_RUNS {
                let reason = format!("more than {MAX_RUNS} conditions: that is the limit of runs");
                return reject(number, 1, reason);
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

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
