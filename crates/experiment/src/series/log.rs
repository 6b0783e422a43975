//! The rows of a series in memory: for each the step and a value of each measure, little-endian, NaN
//! where it is undefined.

use jostle_results::table::{MeasureSeries, Series};
use serde::{Deserialize, Serialize};

use super::{MAX_INLINE, SeriesKind};
use crate::plan::{Plan, PlannedRun};
use crate::run::Recorder;

/// The rows of a series that the recorder does not have. A checkpoint contains them.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct SeriesLog {
    /// Bytes of a row.
    width: usize,
    #[serde(with = "serde_bytes")]
    rows: Vec<u8>,
    /// Bytes of earlier rows, which the recorder has.
    passed: u64,
    /// The step of the last row.
    last: Option<u64>,
}

impl SeriesLog {
    /// Returns a log of so many measures.
    pub fn new(measures: usize) -> Self {
        Self {
            width: 8 * (1 + measures),
            rows: Vec::new(),
            passed: 0,
            last: None,
        }
    }

    /// Returns whether it is one of so many measures.
    pub fn is_of(&self, measures: usize) -> bool {
        self.width == 8 * (1 + measures) && self.rows.len().is_multiple_of(self.width)
    }

    /// Adds a row.
    pub fn add(&mut self, step: u64, values: impl IntoIterator<Item = f64>) {
        self.rows.extend(step.to_le_bytes());
        for value in values {
            self.rows.extend(value.to_le_bytes());
        }
        self.last = Some(step);
    }

    /// Returns the step of the last row.
    pub fn last(&self) -> Option<u64> {
        self.last
    }

    /// Returns whether its rows no longer fit the line of the run.
    pub fn is_long(&self) -> bool {
        self.passed + self.rows.len() as u64 > MAX_INLINE
    }

    /// Returns whether so many rows are in memory that they are to be passed to the recorder.
    pub fn is_full(&self) -> bool {
        self.rows.len() as u64 > MAX_INLINE
    }

    /// Returns the bytes of the rows that the recorder has.
    #[cfg(feature = "files")]
    pub fn passed(&self) -> u64 {
        self.passed
    }

    /// Passes the rows in memory to the recorder.
    pub fn pass_rows(&mut self, kind: SeriesKind, recorder: &dyn Recorder) {
        recorder.add_rows(kind, &self.rows, self.passed);
        self.passed += self.rows.len() as u64;
        self.rows.clear();
    }

    /// Returns the rows in memory as a series.
    pub fn series(&self, kind: SeriesKind, plan: &Plan, run: &PlannedRun) -> Series {
        decode(&self.rows, kind, plan, run)
    }
}

/// Decodes whole rows of a series.
pub fn decode(rows: &[u8], kind: SeriesKind, plan: &Plan, run: &PlannedRun) -> Series {
    let names = kind.measures(plan);
    let (words, _) = rows.as_chunks::<8>();
    let rows = words.chunks_exact(1 + names.len());
    let dt = plan.point(run).spec.parameters.dt;
    let steps: Vec<u64> = rows.clone().map(|row| u64::from_le_bytes(row[0])).collect();
    let measures = names.into_iter().enumerate();
    Series {
        run: run.name.clone(),
        times: steps.iter().map(|&step| step as f64 * dt).collect(),
        steps,
        measures: measures
            .map(|(column, name)| MeasureSeries {
                name,
                values: rows
                    .clone()
                    .map(|row| f64::from_le_bytes(row[1 + column]))
                    .map(|value| (!value.is_nan()).then_some(value))
                    .collect(),
            })
            .collect(),
    }
}
