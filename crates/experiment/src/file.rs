//! The experiment's file as TOML, before its values are checked. Values keep their span, from which
//! errors get their line.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::Deserialize;
use toml::{Spanned, Value};

use crate::error::PlanError;
use crate::files::shown;
use crate::points::Points;

/// Keys and values, each with its span in the file.
pub type Table = BTreeMap<Spanned<String>, Spanned<Value>>;

/// The fields of a file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    /// The experiment's name.
    pub name: Spanned<String>,
    /// The seed from which the seeds of all runs are derived.
    #[serde(default)]
    pub seed: Option<Spanned<u64>>,
    /// Runs at each point.
    #[serde(default)]
    pub replicates: Option<Spanned<u64>>,
    /// The seeds of the runs at each point, instead of `replicates`.
    #[serde(default)]
    pub seeds: Option<Vec<Spanned<u64>>>,
    /// The duration of a run, in time units.
    pub duration: Spanned<f64>,
    /// The spec that all runs share.
    #[serde(default)]
    pub spec: Table,
    /// The CSV of the conditions, instead of `grid`.
    #[serde(default)]
    pub points: Option<Spanned<String>>,
    /// The snapshot from which every run starts.
    #[serde(default)]
    pub start: Option<Spanned<String>>,
    /// The CSV of the set-points of every run: its name, or its text.
    #[serde(default)]
    pub setpoints: Option<Spanned<String>>,
    /// The grids of values that vary.
    #[serde(default)]
    pub grid: Vec<Table>,
    /// The blocks of the protocol.
    #[serde(default)]
    pub at: Vec<Spanned<Table>>,
    /// What ends a run before its duration.
    #[serde(default)]
    pub stop: Table,
    /// Measurements in addition to the table of results.
    #[serde(default)]
    pub measure: Measure,
}

/// Measurements in addition to the table of results.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measure {
    /// Measures whose means are columns of the table of results.
    #[serde(default)]
    pub columns: Vec<Spanned<String>>,
    /// The time from which these are measured, in time units.
    #[serde(default)]
    pub from: Option<Spanned<f64>>,
    /// Steps between two measurements of these.
    #[serde(default)]
    pub every: Option<Spanned<u64>>,
    /// Steps between two entries of the order's time series.
    #[serde(default)]
    pub order_every: Option<Spanned<u64>>,
    /// Steps between two entries of the time series of `columns`.
    #[serde(default)]
    pub series_every: Option<Spanned<u64>>,
    /// Steps between two frames of the trajectories.
    #[serde(default)]
    pub record_every: Option<Spanned<u64>>,
    /// Whether contacts are measured, in a table of their own.
    #[serde(default)]
    pub touch: bool,
}

/// Returns whether a character can be in the name of a variable.
pub fn is_of_name(it: char) -> bool {
    it.is_ascii_alphanumeric() || it == '_'
}

/// An error of the parser, with a remedy instead of the names of types.
pub fn in_words(message: &str) -> String {
    match message.split_once(", expected ") {
        Some((found, "u64" | "usize" | "u32")) => {
            format!("{found}: give a whole number, 0 or more")
        }
        Some((found, "f64")) if found.contains('$') => {
            format!("{found}: give a number, or the name of a variable alone, such as \"$share\"")
        }
        Some((found, "f64")) => format!("{found}: give a number"),
        Some((found @ "unknown variant `uninformed`", _)) => {
            format!("{found}: write {{ informed = false }}")
        }
        _ => message.to_owned(),
    }
}

/// The text of a file, and the CSV that it names; errors get their place from it.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// The text of the TOML.
    pub toml: &'a str,
    /// The CSV, whose cells have spans after the end of the TOML.
    pub points: Option<&'a Points>,
    /// Whether the experiment is stored. What an earlier version accepted is then not rejected.
    pub is_stored: bool,
}

impl Source<'_> {
    /// Parses the file.
    ///
    /// # Errors
    ///
    /// [`PlanError::Field`] with the first line that is not TOML or not a field of an experiment.
    pub fn read(self) -> Result<File, PlanError> {
        toml::from_str(self.toml).map_err(|error| {
            let span = error.span().unwrap_or_default();
            // Only `grid` and `at` are lists of tables.
            let reason = match error.message().contains("map, expected a sequence") {
                true => {
                    let is_block = self
                        .toml
                        .get(span.clone())
                        .is_some_and(|it| it.contains("[at]"));
                    let key = if is_block { "at" } else { "grid" };
                    format!("[{key}] is one of several tables: write [[{key}]]")
                }
                false => in_words(error.message()),
            };
            self.reject(&span, reason)
        })
    }

    /// Returns the error for the value at `span`. Line breaks in `reason` become spaces.
    pub fn reject(self, span: &Range<usize>, reason: impl Into<String>) -> PlanError {
        let reason = reason.into().trim_end().replace('\n', " ");
        if let Some(points) = self.points
            && let Some((line, column)) = points.place(span)
        {
            return PlanError::Points {
                file: points.file.clone(),
                line,
                column,
                reason: shown(&points.file, reason),
            };
        }
        let (line, column) = self.place(span);
        PlanError::Field {
            line,
            column,
            reason,
        }
    }

    /// Adds the row of the CSV to an error of its condition, if it has none; `row` is its span.
    pub fn in_row(self, row: &Range<usize>, error: PlanError) -> PlanError {
        let Some(points) = self.points else {
            return error;
        };
        let (line, _) = points.place(row).unwrap_or_default();
        let file = &points.file;
        match error {
            PlanError::Field {
                line: at,
                column,
                reason,
            } => PlanError::Field {
                line: at,
                column,
                reason: format!("{} ({file}, line {line})", shown(file, reason)),
            },
            error @ PlanError::Run { .. } => self.reject(row, error.to_string()),
            other => other,
        }
    }

    /// Returns the span of `text` within `span`, or `span` itself if it does not contain that text.
    /// A longer name that begins with `text`, such as `$k2` for `$k`, is another text.
    pub fn find(self, span: &Range<usize>, text: &str) -> Range<usize> {
        let within = self.toml.get(span.clone()).unwrap_or_default();
        let is_whole = |at: &usize| {
            let rest = &within[at + text.len()..];
            !(text.ends_with(is_of_name) && rest.starts_with(is_of_name))
        };
        let mut found = within.match_indices(text).map(|(at, _)| at);
        match found.find(is_whole) {
            Some(at) => span.start + at..span.start + at + text.len(),
            None => span.clone(),
        }
    }

    /// Returns the line and the column at which `span` starts, in characters, from 1.
    pub fn place(self, span: &Range<usize>) -> (usize, usize) {
        let before = self.toml.get(..span.start).unwrap_or(self.toml);
        let line = before.rfind('\n').map_or(0, |newline| newline + 1);
        (self.line(span), before[line..].chars().count() + 1)
    }

    /// Returns the line at which `span` starts, from 1.
    pub fn line(self, span: &Range<usize>) -> usize {
        let before = self.toml.bytes().take(span.start);
        before.filter(|&byte| byte == b'\n').count() + 1
    }

    /// Returns a whole number, or `default` if `value` is none.
    ///
    /// # Errors
    ///
    /// [`PlanError::Field`] if the number is outside the range.
    pub fn whole(
        self,
        field: &str,
        value: Option<&Spanned<u64>>,
        default: u64,
        [min, max]: [u64; 2],
    ) -> Result<u64, PlanError> {
        let Some(given) = value else {
            return Ok(default);
        };
        let value = *given.get_ref();
        if (min..=max).contains(&value) {
            return Ok(value);
        }
        let reason = format!("{field} = {value} is outside [{min}, {max}]");
        Err(self.reject(&given.span(), reason))
    }
}
