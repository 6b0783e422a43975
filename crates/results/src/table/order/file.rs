//! The file of the order over time.

use std::path::Path;

use super::MEASURES;
use crate::table::TableError;
use crate::table::series::{SeriesWriter, ValueColumn};

/// Begins a file of rows `run, step, time, order, drift`. The order of each row has a value.
///
/// # Errors
///
/// [`TableError::Io`].
pub fn begin(path: &Path) -> Result<SeriesWriter, TableError> {
    let [order, drift] = MEASURES.map(str::to_owned);
    let columns = [(order, false), (drift, true)];
    let columns = columns.map(|(name, is_optional)| ValueColumn { name, is_optional });
    SeriesWriter::begin_columns(path, "order", columns.into())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::table::order::ORDER_NAME;
    use crate::table::parquet::{for_each_group, rows};
    use crate::table::series::{self, ROWS_OF_GROUP, SeriesPart};
    use crate::table::{MeasureSeries, Series};

    fn groups(path: &Path) -> Vec<usize> {
        let mut groups = Vec::new();
        for_each_group(path, |group| {
            groups.push(rows(group));
            Ok(())
        })
        .unwrap();
        groups
    }

    /// A series of `count` rows; the drift of each third row is undefined, or that of every row.
    fn series(run: &str, count: u32, is_led: bool) -> Series {
        let values = |value: &dyn Fn(u32) -> Option<f64>| (0..count).map(value).collect();
        let is_defined = |row| is_led && row % 3 != 0;
        let measures: [(&str, Vec<Option<f64>>); 2] = [
            ("order", values(&|row| Some(1.0 / f64::from(row + 1)))),
            (
                "drift",
                values(&|row| is_defined(row).then_some(0.1 - f64::from(row))),
            ),
        ];
        Series {
            run: run.to_owned(),
            steps: (0..u64::from(count)).map(|row| 5 * row).collect(),
            times: (0..count).map(|row| 0.1 * f64::from(row)).collect(),
            measures: measures
                .map(|(name, values)| MeasureSeries {
                    name: name.to_owned(),
                    values,
                })
                .into(),
        }
    }

    #[test]
    fn series_round_trip_in_row_groups_of_one_size() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(ORDER_NAME);
        let all = [
            series("quiet", 2, false),
            series("long", 150_000, true),
            series("led", 3, true),
        ];
        let mut writer = begin(&path).unwrap();
        for series in &all {
            writer.append(series).unwrap();
        }
        assert!(!path.exists(), "the file has its name before it is whole");
        writer.finish().unwrap();
        assert_eq!(
            groups(&path),
            [ROWS_OF_GROUP, ROWS_OF_GROUP, 150_005 - 2 * ROWS_OF_GROUP]
        );
        assert!(series::read(&path).unwrap() == all);
        let whole = std::fs::read(&path).unwrap();

        // The same bytes, if the long one is in a file of its own, or comes in parts.
        let file = directory.path().join("run.parquet");
        let mut writer = begin(&file).unwrap();
        for first in (0..150_000).step_by(7_000) {
            writer
                .append(&SeriesPart::of(&all[1], first, 7_000).rows)
                .unwrap();
        }
        writer.finish().unwrap();
        let mut writer = begin(&path).unwrap();
        writer.append(&all[0]).unwrap();
        writer.append_file(&file).unwrap();
        writer.append(&all[2]).unwrap();
        writer.finish().unwrap();
        assert!(std::fs::read(&path).unwrap() == whole);
    }

    #[test]
    fn a_part_of_a_file_is_that_of_its_series() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("run.parquet");
        for is_led in [true, false] {
            let series = series("n=3 #1", 140_000, is_led);
            let mut writer = begin(&path).unwrap();
            writer.append(&series).unwrap();
            writer.finish().unwrap();
            for (after, limit) in [
                (0, 1),
                (0, 70_000),
                (65_530, 10),
                (65_536, 65_536),
                (139_990, 100),
                (140_000, 10),
                (u64::MAX, 10),
            ] {
                let part = series::read_part(&path, after, limit).unwrap();
                let begin = usize::try_from(after).unwrap().min(140_000);
                let end = (begin + limit).min(140_000);
                assert_eq!(part.total, 140_000);
                assert_eq!(part.is_defined, [true, is_led]);
                assert_eq!(part.rows.steps, series.steps[begin..end]);
                assert_eq!(part.rows.times, series.times[begin..end]);
                assert_eq!(part.rows.measures.len(), 2);
                for (part, whole) in part.rows.measures.iter().zip(&series.measures) {
                    assert_eq!(part.name, whole.name);
                    assert!(part.values == whole.values[begin..end], "{after} {limit}");
                }
            }
        }
    }
}
