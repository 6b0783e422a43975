//! Files of comma-separated text.

use std::path::Path;

use csv::ErrorKind;

use super::write_to;
use crate::table::{TableError, axes, io_error};
use crate::{COLUMNS, Cell, CellKind, ExtraValue, FAULT, ResultRow, rename_fault};

pub fn write(path: &Path, runs: &[ResultRow], extra: &[String]) -> Result<(), TableError> {
    let io = |source| io_error(path, source);
    let mut file = jostle_atomic_file::begin(path).map_err(io)?;
    write_to(&mut file, runs, extra).map_err(|error| explain(path, error))?;
    jostle_atomic_file::publish(file, path).map_err(io)
}

pub fn read(path: &Path) -> Result<Vec<ResultRow>, TableError> {
    let explain = |error| explain(path, error);
    let mut reader = csv::Reader::from_path(path).map_err(explain)?;
    let header = reader.headers().map_err(explain)?;
    let mut places = Vec::with_capacity(COLUMNS.len());
    for column in COLUMNS {
        let place = header.iter().position(|name| name == column.name);
        places.push(place.ok_or_else(|| TableError::MissingColumn {
            path: path.to_owned(),
            column: column.name.to_owned(),
        })?);
    }
    let is_extra =
        |name: &&str| COLUMNS.iter().all(|column| column.name != *name) && !axes::is_axis(name);
    let extra: Vec<(usize, String)> = (0..)
        .zip(header.iter())
        .filter(|(_, name)| is_extra(name))
        .map(|(place, name)| (place, name.to_owned()))
        .collect();
    let mut runs = Vec::new();
    for record in reader.records() {
        let record = record.map_err(explain)?;
        let mut cells = Vec::with_capacity(COLUMNS.len());
        for (column, &place) in COLUMNS.iter().zip(&places) {
            let cell = parse(column.kind, record.get(place).unwrap_or_default());
            cells.push(cell.map_err(|reason| TableError::Value {
                path: path.to_owned(),
                place: "line",
                row: record.position().map_or(0, csv::Position::line),
                column: column.name.to_owned(),
                reason,
            })?);
        }
        let mut run = ResultRow::from_cells(cells).expect("`parse` returns a value of its kind");
        for (place, name) in &extra {
            let field = record.get(*place).unwrap_or_default();
            let value = match (field.parse().ok(), &**name) {
                (None, FAULT) if field.is_empty() => continue,
                (None, FAULT) => {
                    run.fault = Some(field.to_owned());
                    continue;
                }
                (value, _) if value.is_some() || field.is_empty() => value,
                // A field that is no number is not of this program, and is left out.
                _ => continue,
            };
            let name = name.clone();
            run.extra.push(ExtraValue { name, value });
        }
        rename_fault(&mut run.extra);
        runs.push(run);
    }
    Ok(runs)
}

/// Parses a field. The error is the reason.
fn parse(kind: CellKind, field: &str) -> Result<Cell, String> {
    match kind {
        CellKind::Text => Ok(Cell::Text(field.into())),
        CellKind::Count => field
            .parse()
            .map(Cell::Count)
            .map_err(|error| error.to_string()),
        CellKind::OptionalNumber if field.is_empty() => Ok(Cell::Absent),
        CellKind::Number | CellKind::OptionalNumber => field
            .parse()
            .map(Cell::Number)
            .map_err(|error| error.to_string()),
    }
}

/// Converts a parser error.
fn explain(path: &Path, error: csv::Error) -> TableError {
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
    use crate::samples::{sample, samples};

    #[test]
    fn rows_round_trip_exactly() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("results.csv");
        for runs in [vec![], samples()] {
            write(&path, &runs, &[]).unwrap();
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
        write(&path, &[sample(), sample()], &[]).unwrap();
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
