//! Parquet tables, for data frames.

use std::io::Write;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, Type as Physical};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;
use tempfile::NamedTempFile;

use super::checksums::{self, Checked};
use super::column::{CellError, ParquetValue, failed};
use super::{TableError, axes, extra_names, has_faults, io_error};
use crate::{COLUMNS, Cell, CellKind, Column, ExtraValue, FAULT, ResultRow, rename_fault};

fn schema(extra: &[&str], has_faults: bool) -> Result<Type, ParquetError> {
    let columns = COLUMNS.iter().map(|column| match column.kind {
        CellKind::Text => String::schema(column.name),
        CellKind::Count => u64::schema(column.name),
        CellKind::Number => f64::schema(column.name),
        CellKind::OptionalNumber => Option::<f64>::schema(column.name),
    });
    let extra = extra.iter().map(|name| match axes::is_text(name) {
        true => Option::<String>::schema(name),
        false => Option::<f64>::schema(name),
    });
    let fault = has_faults.then(|| Option::<String>::schema(FAULT));
    group("run", columns.chain(extra).chain(fault).collect())
}

pub fn write(path: &Path, runs: &[ResultRow], extra: &[String]) -> Result<(), TableError> {
    let extra = extra_names(runs, extra);
    let has_faults = has_faults(runs);
    let mut writer = begin(path, schema(&extra, has_faults))?;
    let malformed = |error| malformed(path, &error);
    // An empty row group is valid, but some readers fail on it.
    if !runs.is_empty() {
        let mut group = writer.next_row_group().map_err(malformed)?;
        for column in COLUMNS {
            write_cells(path, &mut group, column, runs)?;
        }
        for name in extra {
            if axes::is_text(name) {
                let texts = runs.iter().map(|run| axes::value(run, name));
                let texts: Vec<_> = texts.map(|it| it.map(str::to_owned)).collect();
                write_column(path, &mut group, name, &texts)?;
                continue;
            }
            let values: Vec<_> = runs.iter().map(|run| axes::number(run, name)).collect();
            write_column(path, &mut group, name, &values)?;
        }
        if has_faults {
            let faults: Vec<Option<String>> = runs.iter().map(|run| run.fault.clone()).collect();
            write_column(path, &mut group, FAULT, &faults)?;
        }
        group.close().map_err(malformed)?;
    }
    finish(path, writer)
}

pub fn read(path: &Path) -> Result<Vec<ResultRow>, TableError> {
    let mut runs = Vec::new();
    for_each_group(path, |group| {
        let first = runs.len();
        let mut columns = Vec::with_capacity(COLUMNS.len());
        for column in COLUMNS {
            columns.push(read_cells(path, group, column, first)?.into_iter());
        }
        for _ in 0..rows(group) {
            let cells = columns.iter_mut().filter_map(Iterator::next);
            let row = ResultRow::from_cells(cells);
            runs.push(row.expect("`read_cells` returns a value of its kind for each row"));
        }
        let is_fixed =
            |name: &str| COLUMNS.iter().any(|column| column.name == name) || axes::is_axis(name);
        for name in extra_numbers(group, is_fixed) {
            let values: Vec<Option<f64>> = read_column(path, group, &name, first)?;
            for (run, value) in runs[first..].iter_mut().zip(values) {
                let name = name.clone();
                run.extra.push(ExtraValue { name, value });
            }
        }
        for run in &mut runs[first..] {
            rename_fault(&mut run.extra);
        }
        if let Some(index) = text_column(group, FAULT) {
            let rows = (first, 0..rows(group));
            let faults: Vec<Option<String>> = read_rows_at(path, group, (index, FAULT), rows)?;
            for (run, fault) in runs[first..].iter_mut().zip(faults) {
                run.fault = fault;
            }
        }
        Ok(())
    })?;
    Ok(runs)
}

/// Returns the index of a column of text.
fn text_column(group: &dyn RowGroupReader, name: &str) -> Option<usize> {
    let mut columns = group.metadata().columns().iter();
    columns.position(|chunk| {
        chunk.column_type() == Physical::BYTE_ARRAY && chunk.column_path().parts() == [name]
    })
}

/// Returns the names of the columns of numbers that only some experiments have.
pub fn extra_numbers(group: &dyn RowGroupReader, is_fixed: impl Fn(&str) -> bool) -> Vec<String> {
    let columns = group.metadata().columns().iter();
    let numbers = columns.filter(|chunk| chunk.column_type() == Physical::DOUBLE);
    let names = numbers.map(|chunk| chunk.column_path().parts().join("."));
    names.filter(|name| !is_fixed(name)).collect()
}

/// Writes `column` of `runs` as the next column of a row group.
fn write_cells<W: Write + Send>(
    path: &Path,
    group: &mut SerializedRowGroupWriter<'_, W>,
    column: &Column,
    runs: &[ResultRow],
) -> Result<(), TableError> {
    let name = column.name;
    match column.kind {
        CellKind::Text => write_column(path, group, name, &values::<String>(path, column, runs)?),
        CellKind::Count => write_column(path, group, name, &values::<u64>(path, column, runs)?),
        CellKind::Number => write_column(path, group, name, &values::<f64>(path, column, runs)?),
        CellKind::OptionalNumber => {
            let values = values::<Option<f64>>(path, column, runs)?;
            write_column(path, group, name, &values)
        }
    }
}

/// Returns the values of `runs` in `column`.
fn values<T: TryFrom<Cell>>(
    path: &Path,
    column: &Column,
    runs: &[ResultRow],
) -> Result<Vec<T>, TableError> {
    let values = runs.iter().enumerate().map(|(row, run)| {
        T::try_from(column.get(run)).map_err(|_| {
            let reason = "missing, or of another kind than the column".to_owned();
            CellError::Value(row, reason).within(path, column.name, 0)
        })
    });
    values.collect()
}

/// Reads `column` of a row group; `first` is the number of rows in the groups before it.
fn read_cells(
    path: &Path,
    group: &dyn RowGroupReader,
    column: &Column,
    first: usize,
) -> Result<Vec<Cell>, TableError> {
    fn cells<T: Into<Cell>>(values: Vec<T>) -> Vec<Cell> {
        values.into_iter().map(Into::into).collect()
    }
    let name = column.name;
    Ok(match column.kind {
        CellKind::Text => cells(read_column::<String>(path, group, name, first)?),
        CellKind::Count => cells(read_column::<u64>(path, group, name, first)?),
        CellKind::Number => cells(read_column::<f64>(path, group, name, first)?),
        CellKind::OptionalNumber => cells(read_column::<Option<f64>>(path, group, name, first)?),
    })
}

/// Begins a file of `schema`. Its bytes depend only on its values.
pub fn begin(
    path: &Path,
    schema: Result<Type, ParquetError>,
) -> Result<SerializedFileWriter<NamedTempFile>, TableError> {
    let properties = WriterProperties::builder().set_compression(Compression::SNAPPY);
    begin_with(path, schema, properties.build())
}

/// As [`begin`], with other properties.
pub fn begin_with(
    path: &Path,
    schema: Result<Type, ParquetError>,
    properties: WriterProperties,
) -> Result<SerializedFileWriter<NamedTempFile>, TableError> {
    let file = jostle_atomic_file::begin(path).map_err(|source| io_error(path, source))?;
    schema
        .and_then(|schema| SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties)))
        .map_err(|error| malformed(path, &error))
}

/// Ends the file with its checksums and gives it its name.
pub fn finish(path: &Path, writer: SerializedFileWriter<NamedTempFile>) -> Result<(), TableError> {
    let unfinished = writer.inner().path().to_owned();
    let file = checksums::finish(writer, &unfinished).map_err(|error| malformed(path, &error))?;
    jostle_atomic_file::publish(file, path).map_err(|source| io_error(path, source))
}

/// Calls `each` with the row groups of `path`, in order.
pub fn for_each_group(
    path: &Path,
    mut each: impl FnMut(&dyn RowGroupReader) -> Result<(), TableError>,
) -> Result<(), TableError> {
    let reader = open(path)?;
    for index in 0..reader.num_row_groups() {
        let group = reader.get_row_group(index);
        each(&*group.map_err(|error| malformed(path, &error))?)?;
    }
    Ok(())
}

/// Opens a file. Its checksums are checked, if it has them: those of a row group before it is read.
pub fn open(path: &Path) -> Result<SerializedFileReader<Checked>, TableError> {
    Checked::open(path)
        .and_then(SerializedFileReader::new)
        .map_err(|error| malformed(path, &error))
}

/// Checks all bytes of a file that has checksums, and the footer of one that has none.
pub fn check(path: &Path) -> Result<(), TableError> {
    let whole = Checked::open(path).and_then(|file| {
        file.check_all()?;
        SerializedFileReader::new(file)
    });
    whole.map(drop).map_err(|error| malformed(path, &error))
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
pub fn write_column<C: ParquetValue, W: Write + Send>(
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
pub fn read_column<C: ParquetValue>(
    path: &Path,
    group: &dyn RowGroupReader,
    column: &str,
    first: usize,
) -> Result<Vec<C>, TableError> {
    read_rows(path, group, column, (first, 0..rows(group)))
}

/// Reads `rows` of a column of a row group; `first` is the number of rows in the groups before it.
pub fn read_rows<C: ParquetValue>(
    path: &Path,
    group: &dyn RowGroupReader,
    column: &str,
    rows: (usize, Range<usize>),
) -> Result<Vec<C>, TableError> {
    let columns = group.metadata().columns();
    let index = columns
        .iter()
        .position(|chunk| chunk.column_path().parts() == [column])
        .ok_or_else(|| TableError::MissingColumn {
            path: path.to_owned(),
            column: column.to_owned(),
        })?;
    read_rows_at(path, group, (index, column), rows)
}

fn read_rows_at<C: ParquetValue>(
    path: &Path,
    group: &dyn RowGroupReader,
    (index, column): (usize, &str),
    (first, rows): (usize, Range<usize>),
) -> Result<Vec<C>, TableError> {
    let first = first + rows.start;
    group
        .get_column_reader(index)
        .map_err(CellError::from)
        .and_then(|reader| C::read(reader, rows))
        .map_err(|error| error.within(path, column, first))
}

/// Returns the number of rows of a group.
pub fn rows(group: &dyn RowGroupReader) -> usize {
    usize::try_from(group.metadata().num_rows()).unwrap_or(0)
}

pub fn malformed(path: &Path, error: &ParquetError) -> TableError {
    failed(path, error, "")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::samples::{sample, samples};

    #[test]
    fn rows_round_trip_exactly() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("results.parquet");
        for runs in [vec![], samples()] {
            write(&path, &runs, &[]).unwrap();
            assert_eq!(read(&path).unwrap(), runs);
        }
    }

    #[test]
    fn the_same_rows_give_the_same_bytes() {
        let directory = tempfile::tempdir().unwrap();
        let bytes = ["one.parquet", "two.parquet"].map(|name| {
            let path = directory.path().join(name);
            write(&path, &samples(), &[]).unwrap();
            std::fs::read(path).unwrap()
        });
        assert_eq!(bytes[0], bytes[1]);
    }

    #[test]
    fn a_seed_that_does_not_fit_is_rejected_and_leaves_no_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("results.parquet");
        let mut run = sample();
        run.seed = u64::MAX;
        match write(&path, &[sample(), run], &[]).unwrap_err() {
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
                ("elsewhere", TableError::MissingColumn { column, .. }) if column == "run" => {}
                ("run", TableError::MissingColumn { column, .. }) if column == "seed" => {}
                (_, other) => panic!("{other}"),
            }
        }
        std::fs::write(&path, "run,seed").unwrap();
        let foreign = read(&path).unwrap_err();
        assert!(matches!(foreign, TableError::Malformed { .. }), "{foreign}");
    }
}
