//! Measures over time, run by run.

#[cfg(feature = "files")]
mod file;

#[cfg(feature = "files")]
pub(super) use file::{ROWS_OF_GROUP, ValueColumn};
#[cfg(feature = "files")]
pub use file::{SeriesWriter, for_each_part, read, read_part};

/// The file name of the table within its directory.
pub const SERIES_NAME: &str = "series.parquet";

/// The columns before the measures.
const FIXED: [&str; 3] = ["run", "step", "time"];

/// Measures of one run over time, in columns of one length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// The run's name, as in the table of runs.
    pub run: String,
    /// The steps.
    pub steps: Vec<u64>,
    /// The time of each step.
    pub times: Vec<f64>,
    /// The measures, each with its value at each step; none where it is undefined.
    pub measures: Vec<MeasureSeries>,
}

impl Series {
    /// Adds later rows of the same run.
    pub fn extend(&mut self, later: Self) {
        self.steps.extend(later.steps);
        self.times.extend(later.times);
        for (measure, later) in self.measures.iter_mut().zip(later.measures) {
            measure.values.extend(later.values);
        }
    }
}

/// One measure over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasureSeries {
    /// The name of the measure.
    pub name: String,
    /// Its value at each step; none where it is undefined.
    pub values: Vec<Option<f64>>,
}

/// A part of the series of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeriesPart {
    /// Its rows.
    pub rows: Series,
    /// The number of rows of the whole series.
    pub total: u64,
    /// Whether each measure has a value anywhere in the whole series.
    pub is_defined: Vec<bool>,
}

impl SeriesPart {
    /// Returns at most `limit` rows of a series after the first `after`.
    #[must_use]
    pub fn of(series: &Series, after: u64, limit: usize) -> Self {
        let count = series.steps.len();
        let first = usize::try_from(after).map_or(count, |after| after.min(count));
        let rows = first..first.saturating_add(limit).min(count);
        let measures = series.measures.iter();
        Self {
            rows: Series {
                run: series.run.clone(),
                steps: series.steps[rows.clone()].to_vec(),
                times: series.times[rows.clone()].to_vec(),
                measures: measures
                    .clone()
                    .map(|measure| MeasureSeries {
                        name: measure.name.clone(),
                        values: measure.values[rows.clone()].to_vec(),
                    })
                    .collect(),
            },
            total: count as u64,
            is_defined: measures
                .map(|measure| measure.values.iter().any(Option::is_some))
                .collect(),
        }
    }
}

/// Returns series as CSV: `run`, `step`, `time`, and a column for each measure, empty where it is
/// undefined.
#[must_use]
pub fn csv(all: &[Series]) -> String {
    let mut writer = csv::WriterBuilder::new().from_writer(Vec::new());
    let mut write = || -> Result<(), csv::Error> {
        let measures = all.first().into_iter().flat_map(|series| &series.measures);
        let names = measures.map(|measure| measure.name.as_str());
        writer.write_record(FIXED.into_iter().chain(names))?;
        for series in all {
            for (row, (step, time)) in series.steps.iter().zip(&series.times).enumerate() {
                let values = series.measures.iter().map(|measure| measure.values[row]);
                let values =
                    values.map(|value| value.map_or_else(String::new, |it| it.to_string()));
                let fixed = [series.run.clone(), step.to_string(), time.to_string()];
                writer.write_record(fixed.into_iter().chain(values))?;
            }
        }
        Ok(())
    };
    write().expect("writing to memory cannot fail");
    let bytes = writer.into_inner().expect("writing to memory cannot fail");
    String::from_utf8(bytes).expect("CSV is UTF-8")
}
