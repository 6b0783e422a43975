//! Comma-separated text, for spreadsheets.

use std::io::Write;
use std::path::Path;

use csv::{ErrorKind, StringRecord};

use super::parquet::COLUMNS;
use super::{TableError, io_error};
use crate::Run;

pub fn write(path: &Path, runs: &[Run]) -> Result<(), TableError> {
    let io = |source| io_error(path, source);
    let mut file = jostle_atomic_file::begin(path).map_err(io)?;
    write_to(&mut file, runs).map_err(|error| explain(path, COLUMNS, error))?;
    jostle_atomic_file::publish(file, path).map_err(io)
}

pub fn write_to(to: impl Write, runs: &[Run]) -> Result<(), csv::Error> {
    let mut writer = csv::WriterBuilder::new()
        // The header is written below, so that a table without rows has one too.
        .has_headers(false)
        .from_writer(to);
    writer.write_record(COLUMNS)?;
    for run in runs {
        writer.serialize(run)?;
    }
    Ok(writer.flush()?)
}

pub fn read(path: &Path) -> Result<Vec<Run>, TableError> {
    let mut reader = csv::Reader::from_path(path).map_err(|error| explain(path, &[], error))?;
    let header = reader
        .headers()
        .map_err(|error| explain(path, &[], error))?
        .clone();
    let names: Vec<&str> = header.iter().collect();
    for column in COLUMNS {
        if !names.contains(column) {
            return Err(TableError::MissingColumn {
                path: path.to_owned(),
                column,
            });
        }
    }
    let mut runs = Vec::new();
    let mut record = StringRecord::new();
    while reader
        .read_record(&mut record)
        .map_err(|error| explain(path, &names, error))?
    {
        let run = record
            .deserialize(Some(&header))
            .map_err(|error| explain(path, &names, error))?;
        runs.push(run);
    }
    Ok(runs)
}

/// Converts a parser error; it names the line and, rather than by its index, the column.
fn explain(path: &Path, columns: &[&str], error: csv::Error) -> TableError {
    if let ErrorKind::Deserialize { pos, err } = error.kind() {
        let column = err
            .field()
            .and_then(|field| columns.get(usize::try_from(field).ok()?));
        return TableError::Value {
            path: path.to_owned(),
            place: "line",
            row: pos.as_ref().map_or(0, csv::Position::line),
            column: column.map_or("?", |column| column).to_owned(),
            reason: err.kind().to_string(),
        };
    }
    let reason = error.to_string();
    match error.into_kind() {
        ErrorKind::Io(source) => io_error(path, source),
        _ => TableError::Malformed {
            path: path.to_owned(),
            reason,
        },
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
        let path = directory.path().join("results.csv");
        for runs in [vec![], samples()] {
            write(&path, &runs).unwrap();
            assert_eq!(read(&path).unwrap(), runs);
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let header = text.lines().next().unwrap();
        assert!(header.starts_with("run,seed,n,pi1,"), "{header}");
        assert!(text.contains(",1e-9,"), "{text}");
    }

    #[test]
    fn an_invalid_value_is_reported_by_line_and_column() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("results.csv");
        write(&path, &[sample(), sample()]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let (head, last) = text.trim_end().rsplit_once('\n').unwrap();

        let broken = last.replace("endpoints,0.02", "endpoints,fast");
        std::fs::write(&path, format!("{head}\n{broken}\n")).unwrap();
        match read(&path).unwrap_err() {
            TableError::Value { row, column, .. } => assert_eq!((row, &*column), (3, "dt")),
            other => panic!("{other}"),
        }

        std::fs::write(&path, format!("{head}\nshort,1\n")).unwrap();
        let short = read(&path).unwrap_err();
        assert!(matches!(short, TableError::Malformed { .. }), "{short}");

        std::fs::write(&path, text.replace(",v_pd,", ",drift,")).unwrap();
        match read(&path).unwrap_err() {
            TableError::MissingColumn { column, .. } => assert_eq!(column, "v_pd"),
            other => panic!("{other}"),
        }
    }
}
