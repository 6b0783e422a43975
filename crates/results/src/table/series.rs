//! Measures over time, run by run. They have far more rows than runs, so they are written in groups.

use std::path::{Path, PathBuf};

use parquet::errors::ParquetError;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use tempfile::NamedTempFile;

use super::TableError;
use super::column::{ParquetValue, failed};
use super::parquet::{
    begin, extra_numbers, finish, for_each_group, group, read_column, write_column,
};

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

/// One measure over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasureSeries {
    /// The name of the measure.
    pub name: String,
    /// Its value at each step; none where it is undefined.
    pub values: Vec<Option<f64>>,
}

/// Number of rows after which a row group is written. The metadata of a row group takes 540 bytes: with
/// a group for each of 100,000 short runs, `order.parquet` had 130 MB, 54 of them metadata.
pub(super) const ROWS_OF_GROUP: usize = 1 << 16;

/// A column of measured values.
#[derive(Clone, Debug)]
pub(super) struct ValueColumn {
    pub name: String,
    /// Whether values may be undefined.
    pub is_optional: bool,
}

/// Writes a file of rows `run, step, time` and the measures. All rows of a run are in one row group.
///
/// [`SeriesWriter::finish`] gives the file its name; if the writer is dropped before, the file is
/// deleted.
pub struct SeriesWriter {
    path: PathBuf,
    writer: SerializedFileWriter<NamedTempFile>,
    columns: Vec<ValueColumn>,
    group: Rows,
}

/// The rows of the next row group.
#[derive(Default)]
struct Rows {
    runs: Vec<String>,
    steps: Vec<u64>,
    times: Vec<f64>,
    values: Vec<Vec<Option<f64>>>,
}

impl SeriesWriter {
    /// Begins the file of the measures with these names.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`].
    pub fn begin(path: &Path, measures: impl Iterator<Item = String>) -> Result<Self, TableError> {
        let column = |name| ValueColumn {
            name,
            is_optional: true,
        };
        Self::begin_columns(path, "series", measures.map(column).collect())
    }

    pub(super) fn begin_columns(
        path: &Path,
        table: &str,
        columns: Vec<ValueColumn>,
    ) -> Result<Self, TableError> {
        Ok(Self {
            path: path.to_owned(),
            writer: begin(path, schema(table, &columns))?,
            columns,
            group: Rows::default(),
        })
    }

    /// Adds one run, and writes a row group if there are enough rows.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`] if the disk is full; the file is lost then.
    ///
    /// # Panics
    ///
    /// If the columns differ in length, or the measures in number from those of the file.
    pub fn append(&mut self, series: &Series) -> Result<(), TableError> {
        let rows = series.steps.len();
        assert_eq!(rows, series.times.len());
        assert_eq!(series.measures.len(), self.columns.len());
        let group = &mut self.group;
        group.runs.extend(vec![series.run.clone(); rows]);
        group.steps.extend(&series.steps);
        group.times.extend(&series.times);
        group.values.resize(self.columns.len(), Vec::new());
        for (values, measure) in group.values.iter_mut().zip(&series.measures) {
            assert_eq!(rows, measure.values.len());
            values.extend(&measure.values);
        }
        match group.runs.len() {
            ROWS_OF_GROUP.. => self.write_group(),
            _ => Ok(()),
        }
    }

    fn write_group(&mut self) -> Result<(), TableError> {
        let rows = std::mem::take(&mut self.group);
        let malformed = |error| failed(&self.path, &error, "");
        let mut group = self.writer.next_row_group().map_err(malformed)?;
        let path = &self.path;
        write_column(path, &mut group, "run", &rows.runs)?;
        write_column(path, &mut group, "step", &rows.steps)?;
        write_column(path, &mut group, "time", &rows.times)?;
        for (ValueColumn { name, is_optional }, values) in self.columns.iter().zip(rows.values) {
            match is_optional {
                true => write_column(path, &mut group, name, &values)?,
                false => {
                    let values: Vec<f64> = values.into_iter().flatten().collect();
                    write_column(path, &mut group, name, &values)?;
                }
            }
        }
        group.close().map_err(malformed)?;
        Ok(())
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`].
    pub fn finish(mut self) -> Result<(), TableError> {
        if !self.group.runs.is_empty() {
            self.write_group()?;
        }
        finish(&self.path, self.writer)
    }
}

/// Reads a file of a [`SeriesWriter`], or `order.parquet`, whose measures are the order and the
/// drift. Consecutive row groups of one run are joined.
///
/// # Errors
///
/// [`TableError`] with the file and, if applicable, the column and the row.
pub fn read(path: &Path) -> Result<Vec<Series>, TableError> {
    let mut all: Vec<Series> = Vec::new();
    let mut first = 0;
    for_each_group(path, |group| {
        let runs: Vec<String> = read_column(path, group, "run", first)?;
        let steps: Vec<u64> = read_column(path, group, "step", first)?;
        let times: Vec<f64> = read_column(path, group, "time", first)?;
        let mut columns: Vec<(String, Vec<Option<f64>>)> = Vec::new();
        for name in extra_numbers(group, |name| FIXED.contains(&name)) {
            let values = read_column(path, group, &name, first)?;
            columns.push((name, values));
        }
        first += runs.len();
        for (row, run) in runs.into_iter().enumerate() {
            if all.last().is_none_or(|series| series.run != run) {
                let names = columns.iter().map(|(name, _)| name.clone());
                all.push(Series {
                    run,
                    measures: names
                        .map(|name| MeasureSeries {
                            name,
                            values: Vec::new(),
                        })
                        .collect(),
                    ..Series::default()
                });
            }
            if let Some(series) = all.last_mut() {
                series.steps.push(steps[row]);
                series.times.push(times[row]);
                for (measure, (_, values)) in series.measures.iter_mut().zip(&columns) {
                    measure.values.push(values[row]);
                }
            }
        }
        Ok(())
    })?;
    Ok(all)
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

fn schema(table: &str, columns: &[ValueColumn]) -> Result<Type, ParquetError> {
    let fixed = [
        String::schema("run"),
        u64::schema("step"),
        f64::schema("time"),
    ];
    let values = columns.iter().map(|column| match column.is_optional {
        true => Option::<f64>::schema(&column.name),
        false => f64::schema(&column.name),
    });
    group(table, fixed.into_iter().chain(values).collect())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn series(run: &str, step: u64, values: [[Option<f64>; 2]; 2]) -> Series {
        let measures = ["order", "msd(5)"].into_iter().zip(values);
        Series {
            run: run.to_owned(),
            steps: vec![step, step + 50],
            times: vec![0.0, 1.0],
            measures: measures
                .map(|(name, values)| MeasureSeries {
                    name: name.to_owned(),
                    values: values.to_vec(),
                })
                .collect(),
        }
    }

    #[test]
    fn series_round_trip_with_undefined_values() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(SERIES_NAME);
        let all = [
            series(
                "n=3 #0",
                0,
                [[Some(0.1 + 0.2), Some(1.0)], [None, Some(2.5)]],
            ),
            series("n=3 #1", 7, [[None, None], [Some(-1e-9), None]]),
        ];
        let names = ["order", "msd(5)"].into_iter().map(str::to_owned);
        let mut writer = SeriesWriter::begin(&path, names).unwrap();
        all.iter().for_each(|it| writer.append(it).unwrap());
        writer.finish().unwrap();
        assert_eq!(read(&path).unwrap(), all);
        let expected = "run,step,time,order,msd(5)\nn=3 #0,0,0,0.30000000000000004,\n\
                        n=3 #0,50,1,1,2.5\nn=3 #1,7,0,,-0.000000001\nn=3 #1,57,1,,\n";
        assert_eq!(csv(&all), expected);
        assert_eq!(csv(&[]), "run,step,time\n");
    }
}
