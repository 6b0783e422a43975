//! The order over time, run by run.

use std::path::Path;

use super::TableError;
use super::series::{MeasureSeries, Series, SeriesWriter, ValueColumn};

/// The names of the measures.
const ORDER: &str = "order";
const DRIFT: &str = "drift";

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

/// Writes a file of rows `run, step, time, order, drift`. All rows of a run are in one row group.
///
/// [`OrderWriter::finish`] gives the file its name; if the writer is dropped before, the file is
/// deleted.
pub struct OrderWriter(SeriesWriter);

impl OrderWriter {
    /// Begins the file.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`].
    pub fn begin(path: &Path) -> Result<Self, TableError> {
        let column = |name: &str, is_optional| ValueColumn {
            name: name.to_owned(),
            is_optional,
        };
        let columns = vec![column(ORDER, false), column(DRIFT, true)];
        SeriesWriter::begin_columns(path, "order", columns).map(Self)
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
        self.0.append(&series.clone().into())
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`].
    pub fn finish(self) -> Result<(), TableError> {
        self.0.finish()
    }
}

impl From<OrderSeries> for Series {
    fn from(series: OrderSeries) -> Self {
        let drifts = match series.drifts.is_empty() {
            true => vec![None; series.steps.len()],
            false => series
                .drifts
                .into_iter()
                .map(|drift| (!drift.is_nan()).then_some(drift))
                .collect(),
        };
        let measure = |name: &str, values| MeasureSeries {
            name: name.to_owned(),
            values,
        };
        Self {
            run: series.run,
            steps: series.steps,
            times: series.times,
            measures: vec![
                measure(ORDER, series.orders.into_iter().map(Some).collect()),
                measure(DRIFT, drifts),
            ],
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::table::parquet::for_each_group;
    use crate::table::series::{self, ROWS_OF_GROUP};

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
        let expected = [quiet, long, led].map(Series::from);
        assert_eq!(series::read(&path).unwrap(), expected);
    }
}
