//! Files of measures over time. They have far more rows than runs, so they are written in groups.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader as _, RowGroupReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use tempfile::NamedTempFile;

use super::{FIXED, MeasureSeries, Series, SeriesPart};
use crate::table::TableError;
use crate::table::column::{ParquetValue, failed};
use crate::table::parquet::{
    begin, extra_numbers, finish, for_each_group, group, malformed, open, read_column, read_rows,
    rows, write_column,
};

/// Number of rows of a row group. The metadata of a row group takes 540 bytes: with a group for each of
/// 100,000 short runs, `order.parquet` had 130 MB, 54 of them metadata.
pub(in crate::table) const ROWS_OF_GROUP: usize = 1 << 16;

/// Number of values that are read from a file at a time: 16 bytes each.
const VALUES_OF_PART: usize = 1 << 18;

/// A column of measured values.
#[derive(Clone, Debug)]
pub(in crate::table) struct ValueColumn {
    pub name: String,
    /// Whether values may be undefined.
    pub is_optional: bool,
}

/// Writes a file of rows `run, step, time` and the measures, in row groups of one size. The bytes
/// depend only on the rows.
///
/// [`SeriesWriter::finish`] gives the file its name; if the writer is dropped before, the file is
/// deleted.
pub struct SeriesWriter {
    path: PathBuf,
    writer: SerializedFileWriter<NamedTempFile>,
    columns: Vec<ValueColumn>,
    group: Rows,
}

/// The rows of the next row group. An undefined value is NaN, which takes half the memory of an
/// [`Option`].
#[derive(Default)]
struct Rows {
    /// The runs, each with its number of rows.
    runs: Vec<(Arc<str>, usize)>,
    steps: Vec<u64>,
    times: Vec<f64>,
    values: Vec<Vec<f64>>,
}

impl Rows {
    fn add(&mut self, series: &Series, rows: Range<usize>) {
        match self.runs.last_mut() {
            Some((run, count)) if **run == *series.run => *count += rows.len(),
            _ => self.runs.push((series.run.as_str().into(), rows.len())),
        }
        self.steps.extend(&series.steps[rows.clone()]);
        self.times.extend(&series.times[rows.clone()]);
        for (values, measure) in self.values.iter_mut().zip(&series.measures) {
            let added = measure.values[rows.clone()].iter();
            values.extend(added.map(|value| value.unwrap_or(f64::NAN)));
        }
    }

    /// Removes the rows; the memory is used again.
    fn clear(&mut self) {
        self.runs.clear();
        self.steps.clear();
        self.times.clear();
        self.values.iter_mut().for_each(Vec::clear);
    }
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

    pub(in crate::table) fn begin_columns(
        path: &Path,
        table: &str,
        columns: Vec<ValueColumn>,
    ) -> Result<Self, TableError> {
        Ok(Self {
            path: path.to_owned(),
            writer: begin(path, schema(table, &columns))?,
            group: Rows {
                values: vec![Vec::new(); columns.len()],
                ..Rows::default()
            },
            columns,
        })
    }

    /// Adds rows of a run, and writes row groups of one size while there are enough.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`] if the disk is full; the file is lost then.
    ///
    /// # Panics
    ///
    /// If the columns differ in length, or the measures in number from those of the file.
    pub fn append(&mut self, series: &Series) -> Result<(), TableError> {
        let count = series.steps.len();
        assert_eq!(count, series.times.len());
        assert_eq!(series.measures.len(), self.columns.len());
        let measures = series.measures.iter();
        measures.for_each(|measure| assert_eq!(count, measure.values.len()));
        let mut first = 0;
        while first < count {
            let end = count.min(first + ROWS_OF_GROUP - self.group.steps.len());
            self.group.add(series, first..end);
            if self.group.steps.len() == ROWS_OF_GROUP {
                self.write_group()?;
            }
            first = end;
        }
        Ok(())
    }

    /// Adds all rows of a file of one run, a part of them at a time.
    ///
    /// # Errors
    ///
    /// [`TableError`] with the file that cannot be read or written.
    ///
    /// # Panics
    ///
    /// If the measures differ in number from those of the file.
    pub fn append_file(&mut self, path: &Path) -> Result<(), TableError> {
        for_each_part(path, |part| self.append(part))
    }

    fn write_group(&mut self) -> Result<(), TableError> {
        let (rows, path) = (&self.group, &self.path);
        let malformed = |error| failed(path, &error, "");
        let mut group = self.writer.next_row_group().map_err(malformed)?;
        let runs = rows.runs.iter();
        let runs = runs.flat_map(|(run, count)| std::iter::repeat_n(run.clone(), *count));
        write_column(path, &mut group, "run", &runs.collect::<Vec<_>>())?;
        write_column(path, &mut group, "step", &rows.steps)?;
        write_column(path, &mut group, "time", &rows.times)?;
        for (ValueColumn { name, is_optional }, values) in self.columns.iter().zip(&rows.values) {
            match is_optional {
                true => {
                    let values = values.iter();
                    let values = values.map(|value| (!value.is_nan()).then_some(*value));
                    write_column(path, &mut group, name, &values.collect::<Vec<_>>())?;
                }
                false => write_column(path, &mut group, name, values)?,
            }
        }
        group.close().map_err(malformed)?;
        self.group.clear();
        Ok(())
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`].
    pub fn finish(mut self) -> Result<(), TableError> {
        if !self.group.steps.is_empty() {
            self.write_group()?;
        }
        finish(&self.path, self.writer)
    }
}

/// Calls `each` with the rows of a file of one run, in order, a part of them at a time.
///
/// # Errors
///
/// [`TableError`] with the file and, if applicable, the column and the row; or that of `each`.
pub fn for_each_part(
    path: &Path,
    mut each: impl FnMut(&Series) -> Result<(), TableError>,
) -> Result<(), TableError> {
    let mut first = 0;
    for_each_group(path, |group| {
        let count = rows(group);
        let limit = VALUES_OF_PART / group.num_columns().max(1);
        for begin in (0..count).step_by(limit.max(1)) {
            let end = count.min(begin + limit.max(1));
            each(&read_group(path, group, (first, begin..end))?)?;
        }
        first += count;
        Ok(())
    })
}

/// Reads at most `limit` rows of a file of one run after the first `after`. Only the row groups of
/// these rows are read, and only their pages are decoded.
///
/// # Errors
///
/// [`TableError`] with the file and, if applicable, the column and the row.
pub fn read_part(path: &Path, after: u64, limit: usize) -> Result<SeriesPart, TableError> {
    let (mut part, mut first) = (SeriesPart::default(), 0);
    let mut page: Option<Series> = None;
    let after = usize::try_from(after).unwrap_or(usize::MAX);
    let reader = open(path)?;
    for index in 0..reader.num_row_groups() {
        let group = reader.get_row_group(index);
        let group = &*group.map_err(|error| malformed(path, &error))?;
        let count = rows(group);
        let names = extra_numbers(group, |name| FIXED.contains(&name));
        part.is_defined.resize(names.len(), false);
        for (is_defined, name) in part.is_defined.iter_mut().zip(&names) {
            *is_defined |= nulls(group, name).is_none_or(|nulls| nulls < count as u64);
        }
        let taken = page.as_ref().map_or(0, |page| page.steps.len());
        let begin = after.saturating_sub(first).min(count);
        let end = count.min(begin.saturating_add(limit - taken));
        // The page of a series after its end has the names of the measures, too.
        if begin < end || page.is_none() && index + 1 == reader.num_row_groups() {
            let rows = read_group(path, group, (first, begin..end))?;
            match &mut page {
                None => page = Some(rows),
                Some(page) => page.extend(rows),
            }
        }
        first += count;
    }
    part.rows = page.unwrap_or_default();
    part.total = first as u64;
    Ok(part)
}

/// Returns the number of undefined values of a column of a row group, if the file has it.
fn nulls(group: &dyn RowGroupReader, name: &str) -> Option<u64> {
    let mut columns = group.metadata().columns().iter();
    let column = columns.find(|chunk| chunk.column_path().parts() == [name])?;
    column.statistics()?.null_count_opt()
}

/// Reads rows of a row group of a file of one run.
fn read_group(
    path: &Path,
    group: &dyn RowGroupReader,
    (first, rows): (usize, Range<usize>),
) -> Result<Series, TableError> {
    let mut measures = Vec::new();
    for name in extra_numbers(group, |name| FIXED.contains(&name)) {
        let values = read_rows(path, group, &name, (first, rows.clone()))?;
        measures.push(MeasureSeries { name, values });
    }
    let run = read_rows::<String>(
        path,
        group,
        "run",
        (first, rows.start..rows.end.min(rows.start + 1)),
    )?;
    Ok(Series {
        run: run.into_iter().next().unwrap_or_default(),
        steps: read_rows(path, group, "step", (first, rows.clone()))?,
        times: read_rows(path, group, "time", (first, rows))?,
        measures,
    })
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
    use crate::table::series::{SERIES_NAME, csv};

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
