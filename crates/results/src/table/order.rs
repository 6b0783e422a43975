//! The order over time, run by run. It has far more rows than runs, so they are written in groups.

use std::path::{Path, PathBuf};

use parquet::errors::ParquetError;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use tempfile::NamedTempFile;

use super::TableError;
use super::column::{ParquetValue, failed};
use super::parquet::{begin, finish, for_each_group, group, read_column, write_column};

/// The file name of the table within its directory.
pub const ORDER_NAME: &str = "order.parquet";

/// The order of one run over time, in columns of one length.
#[derive(Clone, Debug, Default)]
pub struct OrderSeries {
    /// The run's name, as in the table of runs.
    pub run: String,
    /// The steps.
    pub steps: Vec<u64>,
    /// The time of each step.
    pub times: Vec<f64>,
    /// The order at each step.
    pub orders: Vec<f64>,
    /// The drift along the informed individuals' direction at each step, NaN where it is undefined;
    /// empty if it is undefined everywhere.
    pub drifts: Vec<f64>,
}

/// An undefined drift, NaN, equals itself.
impl PartialEq for OrderSeries {
    fn eq(&self, other: &Self) -> bool {
        let bits = |column: &[f64]| column.iter().map(|it| it.to_bits()).collect::<Vec<_>>();
        self.run == other.run
            && self.steps == other.steps
            && self.times == other.times
            && self.orders == other.orders
            && bits(&self.drifts) == bits(&other.drifts)
    }
}

/// Number of rows after which a row group is written. The metadata of a row group takes 540 bytes: with
/// a group for each of 100,000 short runs, `order.parquet` had 130 MB, 54 of them metadata.
const ROWS_OF_GROUP: usize = 1 << 16;

/// Writes a file of rows `run, step, time, order, drift`. All rows of a run are in one row group.
///
/// [`OrderWriter::finish`] gives the file its name; if the writer is dropped before, the file is
/// deleted.
pub struct OrderWriter {
    path: PathBuf,
    writer: SerializedFileWriter<NamedTempFile>,
    group: Columns,
}

/// The rows of the next row group.
#[derive(Default)]
struct Columns {
    runs: Vec<String>,
    steps: Vec<u64>,
    times: Vec<f64>,
    orders: Vec<f64>,
    drifts: Vec<Option<f64>>,
}

impl OrderWriter {
    /// Begins the file.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`].
    pub fn begin(path: &Path) -> Result<Self, TableError> {
        Ok(Self {
            path: path.to_owned(),
            writer: begin(path, schema())?,
            group: Columns::default(),
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
    /// If the columns differ in length.
    pub fn append(&mut self, series: &OrderSeries) -> Result<(), TableError> {
        let rows = series.steps.len();
        assert_eq!((rows, rows), (series.times.len(), series.orders.len()));
        assert!(series.drifts.is_empty() || series.drifts.len() == rows);
        let group = &mut self.group;
        group.runs.extend(vec![series.run.clone(); rows]);
        group.steps.extend(&series.steps);
        group.times.extend(&series.times);
        group.orders.extend(&series.orders);
        match series.drifts.len() {
            0 => group.drifts.extend(vec![None; rows]),
            _ => {
                let drifts = series.drifts.iter().copied();
                group
                    .drifts
                    .extend(drifts.map(|it| (!it.is_nan()).then_some(it)));
            }
        }
        match group.runs.len() {
            ROWS_OF_GROUP.. => self.write_group(),
            _ => Ok(()),
        }
    }

    fn write_group(&mut self) -> Result<(), TableError> {
        let Columns {
            runs,
            steps,
            times,
            orders,
            drifts,
        } = std::mem::take(&mut self.group);
        let malformed = |error| failed(&self.path, &error, "");
        let mut group = self.writer.next_row_group().map_err(malformed)?;
        let path = &self.path;
        write_column(path, &mut group, "run", &runs)?;
        write_column(path, &mut group, "step", &steps)?;
        write_column(path, &mut group, "time", &times)?;
        write_column(path, &mut group, "order", &orders)?;
        write_column(path, &mut group, "drift", &drifts)?;
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

/// Reads a file of an [`OrderWriter`]. Consecutive row groups of one run are joined.
///
/// # Errors
///
/// [`TableError`] with the file and, if applicable, the column and the row.
pub fn read(path: &Path) -> Result<Vec<OrderSeries>, TableError> {
    let mut all: Vec<OrderSeries> = Vec::new();
    let mut first = 0;
    for_each_group(path, |group| {
        let runs: Vec<String> = read_column(path, group, "run", first)?;
        let steps: Vec<u64> = read_column(path, group, "step", first)?;
        let times: Vec<f64> = read_column(path, group, "time", first)?;
        let orders: Vec<f64> = read_column(path, group, "order", first)?;
        let drifts: Vec<Option<f64>> = read_column(path, group, "drift", first)?;
        first += runs.len();
        for (row, run) in runs.into_iter().enumerate() {
            if all.last().is_none_or(|series| series.run != run) {
                all.push(OrderSeries {
                    run,
                    ..OrderSeries::default()
                });
            }
            if let Some(series) = all.last_mut() {
                series.steps.push(steps[row]);
                series.times.push(times[row]);
                series.orders.push(orders[row]);
                series.drifts.push(drifts[row].unwrap_or(f64::NAN));
            }
        }
        Ok(())
    })?;
    for series in &mut all {
        if series.drifts.iter().all(|drift| drift.is_nan()) {
            series.drifts.clear();
        }
    }
    Ok(all)
}

fn schema() -> Result<Type, ParquetError> {
    group(
        "order",
        vec![
            String::schema("run"),
            u64::schema("step"),
            f64::schema("time"),
            f64::schema("order"),
            Option::<f64>::schema("drift"),
        ],
    )
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn groups(path: &Path) -> usize {
        let mut groups = 0;
        for_each_group(path, |_| {
            groups += 1;
            Ok(())
        })
        .unwrap();
        groups
    }

    #[test]
    fn series_round_trip_run_by_run() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(ORDER_NAME);
        let quiet = OrderSeries {
            run: "quiet".to_owned(),
            steps: vec![0, 50],
            times: vec![0.0, 1.0],
            orders: vec![0.1 + 0.2, 1.0],
            drifts: vec![],
        };
        let led = OrderSeries {
            run: "led".to_owned(),
            drifts: vec![-0.5, 1.0 / 3.0],
            ..quiet.clone()
        };
        let mut writer = OrderWriter::begin(&path).unwrap();
        let long = OrderSeries {
            run: "long".to_owned(),
            steps: vec![7; ROWS_OF_GROUP - 1],
            times: vec![0.5; ROWS_OF_GROUP - 1],
            orders: vec![0.25; ROWS_OF_GROUP - 1],
            drifts: vec![],
        };
        // Two row groups: `quiet` and `long`, then `led`.
        for series in [&quiet, &long, &led] {
            writer.append(series).unwrap();
        }
        assert!(!path.exists(), "the file has its name before it is whole");
        writer.finish().unwrap();
        assert_eq!(groups(&path), 2);
        assert_eq!(read(&path).unwrap(), [quiet, long, led]);
    }
}
