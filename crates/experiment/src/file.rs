//! The file that describes an experiment, read but not yet understood: every value with its line.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::Deserialize;
use toml::{Spanned, Value};

use crate::error::PlanError;

/// Keys with their values, each with its place in the file.
pub type Table = BTreeMap<Spanned<String>, Spanned<Value>>;

/// A file as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    /// The experiment's name.
    pub name: Spanned<String>,
    /// What every run's seed is derived from.
    #[serde(default)]
    pub seed: Option<Spanned<u64>>,
    /// Runs at each point.
    #[serde(default)]
    pub replicates: Option<Spanned<u64>>,
    /// How long a run is.
    pub duration: Spanned<f64>,
    /// What all runs have in common.
    #[serde(default)]
    pub spec: Table,
    /// What varies.
    #[serde(default)]
    pub grid: Vec<Table>,
    /// What is measured beside the table of results.
    #[serde(default)]
    pub measure: Measure,
}

/// What is measured beside the table of results.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measure {
    /// Steps between two entries of the order's time series.
    #[serde(default)]
    pub order_every: Option<Spanned<u64>>,
    /// Whether what contacts do to bodies is a table too.
    #[serde(default)]
    pub touch: bool,
}

/// The text of a file, to say where something is wrong.
#[derive(Clone, Copy)]
pub struct Source<'a>(pub &'a str);

impl Source<'_> {
    /// Reads the file.
    ///
    /// # Errors
    ///
    /// [`PlanError::Field`] with the line at which it is no TOML, or no experiment.
    pub fn read(self) -> Result<File, PlanError> {
        toml::from_str(self.0).map_err(|error| {
            let place = error.span().unwrap_or_default();
            self.refuse(&place, error.message())
        })
    }

    /// Refuses what stands at a place.
    pub fn refuse(self, place: &Range<usize>, reason: impl Into<String>) -> PlanError {
        let reason = reason.into().trim_end().replace('\n', " ");
        let line = self.line(place);
        PlanError::Field { line, reason }
    }

    /// The line of a place, from 1.
    pub fn line(self, place: &Range<usize>) -> usize {
        let before = self.0.bytes().take(place.start);
        before.filter(|&byte| byte == b'\n').count() + 1
    }

    /// A whole number within a range, or `default` where there is none.
    ///
    /// # Errors
    ///
    /// [`PlanError::Field`].
    pub fn whole(
        self,
        field: &str,
        value: Option<&Spanned<u64>>,
        default: u64,
        [least, most]: [u64; 2],
    ) -> Result<u64, PlanError> {
        let Some(given) = value else {
            return Ok(default);
        };
        let value = *given.get_ref();
        if (least..=most).contains(&value) {
            return Ok(value);
        }
        let reason = format!("{field} = {value} is outside [{least}, {most}]");
        Err(self.refuse(&given.span(), reason))
    }
}
