//! Parquet tables, for data frames.

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;
use tempfile::NamedTempFile;

use super::column::{Cell, CellError};
use super::{TableError, io_error};
use crate::Run;

/// Lists the columns of a [`Run`] once, and derives from the list their names, the schema, the
/// writer and the reader.
macro_rules! columns {
    ($($field:ident: $cell:ty),* $(,)?) => {
        /// The columns of a table, in their order.
        pub const COLUMNS: &[&str] = &[$(stringify!($field)),*];

        fn schema() -> Result<Type, ParquetError> {
            group("run", vec![$(<$cell as Cell>::schema(stringify!($field))),*])
        }

        fn write_group<W: Write + Send>(
            path: &Path,
            group: &mut SerializedRowGroupWriter<'_, W>,
            runs: &[Run],
        ) -> Result<(), TableError> {
            $(
                let values: Vec<$cell> = runs.iter().map(|run| run.$field.clone()).collect();
                write_column(path, group, stringify!($field), &values)?;
            )*
            Ok(())
        }

        fn read_group(
            path: &Path,
            group: &dyn RowGroupReader,
            runs: &mut Vec<Run>,
        ) -> Result<(), TableError> {
            let first = runs.len();
            $(
                let mut $field =
                    read_column::<$cell>(path, group, stringify!($field), first)?.into_iter();
            )*
            for _ in 0..rows(group) {
                let ($(Some($field),)*) = ($($field.next(),)*) else {
                    unreachable!("`read_column` returns as many values as the group has rows");
                };
                runs.push(Run { $($field),* });
            }
            Ok(())
        }
    };
}

columns! {
    run: String,
    seed: u64,
    n: u64,
    pi1: f64,
    pi2: f64,
    pi3: f64,
    pi4: f64,
    informed: u64,
    contacts: String,
    dt: f64,
    time: f64,
    v: f64,
    v_pd: Option<f64>,
    ordered_intervals: u64,
    ordered_time: f64,
    unordered_intervals: u64,
    unordered_time: f64,
    worst_overlap: f64,
    crossed_share: f64,
    worst_residual: f64,
    degraded: u64,
    fallbacks: u64,
    steps: u64,
    state_hash: String,
}

pub fn write(path: &Path, runs: &[Run]) -> Result<(), TableError> {
    let mut writer = begin(path, schema())?;
    let malformed = |error| malformed(path, &error);
    // An empty row group is valid, but some readers fail on it.
    if !runs.is_empty() {
        let mut group = writer.next_row_group().map_err(malformed)?;
        write_group(path, &mut group, runs)?;
        group.close().map_err(malformed)?;
    }
    finish(path, writer)
}

pub fn read(path: &Path) -> Result<Vec<Run>, TableError> {
    let mut runs = Vec::new();
    for_each_group(path, |group| read_group(path, group, &mut runs))?;
    Ok(runs)
}

/// Begins a file of `schema`. Its bytes depend only on its values.
pub fn begin(
    path: &Path,
    schema: Result<Type, ParquetError>,
) -> Result<SerializedFileWriter<NamedTempFile>, TableError> {
    let file = jostle_atomic_file::begin(path).map_err(|source| io_error(path, source))?;
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .build();
    schema
        .and_then(|schema| SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties)))
        .map_err(|error| malformed(path, &error))
}

/// Ends the file and gives it its name.
pub fn finish(path: &Path, writer: SerializedFileWriter<NamedTempFile>) -> Result<(), TableError> {
    let file = writer
        .into_inner()
        .map_err(|error| malformed(path, &error))?;
    jostle_atomic_file::publish(file, path).map_err(|source| io_error(path, source))
}

/// Calls `each` with the row groups of `path`, in order.
pub fn for_each_group(
    path: &Path,
    mut each: impl FnMut(&dyn RowGroupReader) -> Result<(), TableError>,
) -> Result<(), TableError> {
    let malformed = |error| malformed(path, &error);
    let file = File::open(path).map_err(|source| io_error(path, source))?;
    let reader = SerializedFileReader::new(file).map_err(malformed)?;
    for index in 0..reader.num_row_groups() {
        each(&*reader.get_row_group(index).map_err(malformed)?)?;
    }
    Ok(())
}

/// Builds the schema of a table from the schemas of its columns.
pub fn group(name: &str, columns: Vec<Result<Type, ParquetError>>) -> Result<Type, ParquetError> {
    let columns: Result<Vec<_>, _> = columns
        .into_iter()
        .map(|column| column.map(Arc::new))
        .collect();
    Type::group_type_builder(name).with_fields(columns?).build()
}

/// Writes the next column of a row group, which must be `column` in the schema.
pub fn write_column<C: Cell, W: Write + Send>(
    path: &Path,
    group: &mut SerializedRowGroupWriter<'_, W>,
    column: &str,
    values: &[C],
) -> Result<(), TableError> {
    let mut write = || -> Result<(), CellError> {
        let mut writer = group.next_column()?.ok_or_else(|| {
            ParquetError::General(format!("the schema has no column left for {column}"))
        })?;
        C::write(values, &mut writer)?;
        Ok(writer.close()?)
    };
    write().map_err(|error| error.within(path, column, 0))
}

/// Reads a column of a row group; `first` is the number of rows in the groups before it.
pub fn read_column<C: Cell>(
    path: &Path,
    group: &dyn RowGroupReader,
    column: &'static str,
    first: usize,
) -> Result<Vec<C>, TableError> {
    let columns = group.metadata().columns();
    let index = columns
        .iter()
        .position(|chunk| chunk.column_path().parts() == [column])
        .ok_or_else(|| TableError::MissingColumn {
            path: path.to_owned(),
            column,
        })?;
    group
        .get_column_reader(index)
        .map_err(CellError::from)
        .and_then(|reader| C::read(reader, rows(group)))
        .map_err(|error| error.within(path, column, first))
}

/// Returns the number of rows of a group.
pub fn rows(group: &dyn RowGroupReader) -> usize {
    usize::try_from(group.metadata().num_rows()).unwrap_or(0)
}

fn malformed(path: &Path, error: &ParquetError) -> TableError {
    TableError::Malformed {
        path: path.to_owned(),
        reason: error.to_string(),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::run::{sample, samples};

    #[test]
    fn rows_round_trip_exactly() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("results.parquet");
        for runs in [vec![], samples()] {
            write(&path, &runs).unwrap();
            assert_eq!(read(&path).unwrap(), runs);
        }
    }

    #[test]
    fn the_same_rows_give_the_same_bytes() {
        let directory = tempfile::tempdir().unwrap();
        let bytes = ["one.parquet", "two.parquet"].map(|name| {
            let path = directory.path().join(name);
            write(&path, &samples()).unwrap();
            std::fs::read(path).unwrap()
        });
        assert_eq!(bytes[0], bytes[1]);
    }

    #[test]
    fn a_seed_that_does_not_fit_is_refused_and_leaves_no_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("results.parquet");
        let mut run = sample();
        run.seed = u64::MAX;
        match write(&path, &[sample(), run]).unwrap_err() {
            TableError::Value { row, column, .. } => assert_eq!((row, &*column), (2, "seed")),
            other => panic!("{other}"),
        }
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_missing_or_mistyped_column_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("results.parquet");
        let text = |name: &str| vec![String::schema(name)];
        for column in ["elsewhere", "run"] {
            let mut writer = begin(&path, group("other", text(column))).unwrap();
            let mut rows = writer.next_row_group().unwrap();
            write_column(&path, &mut rows, column, &["x".to_owned()]).unwrap();
            rows.close().unwrap();
            finish(&path, writer).unwrap();
            match (column, read(&path).unwrap_err()) {
                ("elsewhere", TableError::MissingColumn { column: "run", .. }) => {}
                ("run", TableError::MissingColumn { column: "seed", .. }) => {}
                (_, other) => panic!("{other}"),
            }
        }
        std::fs::write(&path, "run,seed").unwrap();
        let foreign = read(&path).unwrap_err();
        assert!(matches!(foreign, TableError::Malformed { .. }), "{foreign}");
    }
}
