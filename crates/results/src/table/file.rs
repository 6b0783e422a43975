//! Files with tables of results, of both kinds.

use std::path::Path;

use super::{CSV_NAME, PARQUET_NAME, TableError, csv, parquet};
use crate::ResultRow;

/// Writes `runs` to both files of `directory`, which must exist. `extra` are columns that only some
/// experiments have, as [`occasional`](super::occasional) returns them: a table has them even if no run does.
///
/// # Errors
///
/// [`TableError::Io`], or [`TableError::Value`] for a whole number beyond 2^63.
pub fn write(directory: &Path, runs: &[ResultRow], extra: &[String]) -> Result<(), TableError> {
    parquet::write(&directory.join(PARQUET_NAME), runs, extra)?;
    csv::write(&directory.join(CSV_NAME), runs, extra)
}

/// Writes `runs` as Parquet, as [`write()`] does.
///
/// # Errors
///
/// [`TableError::Io`], or [`TableError::Value`] for a whole number beyond 2^63.
pub fn write_parquet(path: &Path, runs: &[ResultRow], extra: &[String]) -> Result<(), TableError> {
    parquet::write(path, runs, extra)
}

/// Writes `runs` as CSV, as [`write()`] does, numbers in the shortest form that is read back exactly.
///
/// # Errors
///
/// [`TableError::Io`].
pub fn write_csv(path: &Path, runs: &[ResultRow], extra: &[String]) -> Result<(), TableError> {
    csv::write(path, runs, extra)
}

/// Reads a table: a file of either kind, or the one that a directory holds.
///
/// Columns are found by name; others are ignored.
///
/// # Errors
///
/// [`TableError`] with the file and, if applicable, the column and the row.
pub fn read(path: &Path) -> Result<Vec<ResultRow>, TableError> {
    if path.is_dir() {
        let found = [PARQUET_NAME, CSV_NAME].map(|name| path.join(name));
        let Some(file) = found.iter().find(|file| file.exists()) else {
            let directory = path.to_owned();
            return Err(TableError::Absent { directory });
        };
        return read(file);
    }
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("parquet") => parquet::read(path),
        Some("csv") => csv::read(path),
        _ => Err(TableError::UnknownKind {
            path: path.to_owned(),
        }),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::fs;

    use ::parquet::file::metadata::RowGroupMetaData;
    use ::parquet::file::reader::{FileReader as _, SerializedFileReader};
    use jostle_proto::OccasionalColumns;

    use super::*;
    use crate::samples::sample;
    use crate::table::{checksums, occasional};
    use crate::{COLUMNS, ExtraValue, FAULT, Measure};

    #[test]
    fn a_directory_is_read_from_parquet_else_from_csv() {
        let directory = tempfile::tempdir().unwrap();
        let absent = read(directory.path()).unwrap_err();
        assert!(matches!(absent, TableError::Absent { .. }), "{absent}");

        let (one, two) = (vec![sample()], vec![sample(), sample()]);
        write_csv(&directory.path().join(CSV_NAME), &one, &[]).unwrap();
        assert_eq!(read(directory.path()).unwrap(), one);
        write_parquet(&directory.path().join(PARQUET_NAME), &two, &[]).unwrap();
        assert_eq!(read(directory.path()).unwrap(), two);
    }

    #[test]
    fn stored_tables_of_both_kinds_are_read_and_written_to_the_byte_but_for_checksums() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/stored");
        for version in ["bf41dde", "1a581a9"] {
            let stored = root.join(version).join("results");
            let rows = read(&stored.join(CSV_NAME)).unwrap();
            assert_eq!(rows.len(), 16, "{version}");
            assert_eq!(read(&stored.join(PARQUET_NAME)).unwrap(), rows, "{version}");

            let directory = tempfile::tempdir().unwrap();
            write(directory.path(), &rows, &[]).unwrap();
            let both = |name| [&stored, directory.path()].map(|it: &Path| it.join(name));
            let [old, new] = both(CSV_NAME).map(|it| fs::read(it).unwrap());
            assert!(old == new, "{version}");
            let [old, new] = both(PARQUET_NAME).map(|it| parts(&it));
            assert!(old.before_footer == new.before_footer, "{version}");
            assert_eq!(old.row_groups, new.row_groups, "{version}");
            assert_eq!(old.described, new.described, "{version}");
            assert_eq!(old.keys, [""; 0], "{version}");
            assert_eq!(new.keys, [checksums::KEY], "{version}");
        }
    }

    #[test]
    fn an_axis_that_varies_has_a_column_if_rows_have_no_field_of_it() {
        let columns = OccasionalColumns {
            varied: ["pi1", "stepping", "noise", "share"]
                .map(str::to_owned)
                .into(),
            extra: vec!["share".to_owned()],
            series: Vec::new(),
        };
        let row = |run: &str, share| ResultRow {
            run: run.to_owned(),
            extra: vec![ExtraValue {
                name: "share".to_owned(),
                value: Some(share),
            }],
            ..sample()
        };
        let rows = [
            row("pi1=4 stepping=velocity noise=0.3 share=1 #0", 1.0),
            row("pi1=4 stepping=position noise=0 share=2 #0", 2.0),
        ];
        let last = |text: &str| -> Vec<String> {
            let lines = text.lines().map(|line| line.split(',').skip(COLUMNS.len()));
            lines
                .map(|cells| cells.collect::<Vec<_>>().join(" "))
                .collect()
        };
        let names = "stepping noise share";
        let extra = occasional(&columns);
        assert_eq!(last(&csv(&[], &extra)), [names]);
        // A daemon of an earlier version does not say what varies.
        for extra in [&extra[..], &[]] {
            let expected = [names, "velocity 0.3 1.0", "position 0.0 2.0"];
            assert_eq!(last(&csv(&rows, extra)), expected);
            let directory = tempfile::tempdir().unwrap();
            write(directory.path(), &rows, extra).unwrap();
            for name in [CSV_NAME, PARQUET_NAME] {
                assert_eq!(read(&directory.path().join(name)).unwrap(), rows, "{name}");
            }
            let reader = parquet::open(&directory.path().join(PARQUET_NAME)).unwrap();
            let row = reader.get_row_iter(None).unwrap().next().unwrap().unwrap();
            let cells = row.get_column_iter().skip(COLUMNS.len());
            let cells: Vec<String> = cells.map(|(name, it)| format!("{name} {it}")).collect();
            assert_eq!(cells, ["stepping \"velocity\"", "noise 0.3", "share 1.0"]);
        }
        // Not every grid of an experiment has each axis.
        let given = ["informed_fraction=0.5 #0", "informed=3 #0"].map(|run| row(run, 1.0));
        let expected = ["informed_fraction share", "0.5 1.0", " 1.0"];
        assert_eq!(last(&csv(&given, &[])), expected);
    }

    #[test]
    fn a_variable_with_the_name_of_the_faults_is_renamed_in_stored_tables() {
        let stored =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/stored/accepted/small");
        for name in [CSV_NAME, PARQUET_NAME] {
            let rows = read(&stored.join(name)).unwrap();
            let values = |name: &str| rows.iter().map(|row| row.extra(name)).collect::<Vec<_>>();
            assert_eq!(values("fault_"), [Some(1.0), Some(3.0)], "{name}");
            assert_eq!(values(FAULT), [None, None], "{name}");
            assert_eq!(rows[0].fault, None, "{name}");
            let reason = rows[1].fault.as_deref().unwrap();
            assert!(reason.contains("step 75"), "{name}: {reason}");
        }
    }

    /// A Parquet file: the bytes before its footer, and what the footer says.
    struct Parts {
        before_footer: Vec<u8>,
        row_groups: Vec<RowGroupMetaData>,
        described: String,
        keys: Vec<String>,
    }

    fn parts(path: &Path) -> Parts {
        let mut bytes = fs::read(path).unwrap();
        let end = bytes.len() - 8;
        let footer = u32::from_le_bytes(*bytes[end..].first_chunk().unwrap());
        bytes.truncate(end - footer as usize);
        let reader = SerializedFileReader::new(fs::File::open(path).unwrap()).unwrap();
        let file = reader.metadata().file_metadata();
        let (version, rows) = (file.version(), file.num_rows());
        let (schema, orders) = (file.schema(), file.column_orders());
        let creator = file.created_by();
        let pairs = file.key_value_metadata().into_iter().flatten();
        Parts {
            before_footer: bytes,
            row_groups: reader.metadata().row_groups().to_vec(),
            described: format!("{version} {rows} {schema:?} {orders:?} {creator:?}"),
            keys: pairs.map(|pair| pair.key.clone()).collect(),
        }
    }

    #[test]
    fn faults_are_a_column_of_both_kinds_and_absent_from_tables_without_one() {
        let directory = tempfile::tempdir().unwrap();
        let mut faulted = sample();
        faulted.fault = Some("step 7: the axes of 1, and \"2\" cross".to_owned());
        let csv = directory.path().join(CSV_NAME);
        for (rows, has_column) in [
            (vec![sample()], false),
            (vec![sample(), faulted.clone()], true),
            (vec![faulted.clone(), sample()], true),
        ] {
            write(directory.path(), &rows, &[]).unwrap();
            assert_eq!(read(&directory.path().join(PARQUET_NAME)).unwrap(), rows);
            assert_eq!(read(&csv).unwrap(), rows);
            let text = fs::read_to_string(&csv).unwrap();
            let header = text.lines().next().unwrap();
            assert_eq!(header.ends_with(",fault"), has_column, "{header}");
        }
    }

    #[test]
    fn a_row_without_a_measure_is_rejected_where_its_column_requires_one() {
        let directory = tempfile::tempdir().unwrap();
        let mut row = sample();
        row.measures
            .retain(|(measure, _)| *measure != Measure::V_PD);
        write(directory.path(), &[row.clone()], &[]).unwrap();
        assert_eq!(read(directory.path()).unwrap(), [sample()]);

        row.measures.retain(|(measure, _)| *measure != Measure::V);
        match write(directory.path(), &[sample(), row], &[]).unwrap_err() {
            TableError::Value { row, column, .. } => assert_eq!((row, &*column), (2, "v")),
            other => panic!("{other}"),
        }
        assert_eq!(read(directory.path()).unwrap(), [sample()]);
    }

    #[test]
    fn unknown_extensions_and_missing_files_are_rejected() {
        let unknown = read(Path::new("results.txt")).unwrap_err();
        assert!(matches!(unknown, TableError::UnknownKind { .. }));
        let missing = read(Path::new("/nowhere/results.csv")).unwrap_err();
        assert!(matches!(missing, TableError::Io { .. }), "{missing}");
        let missing = write(Path::new("/nowhere"), &[], &[]).unwrap_err();
        assert!(matches!(missing, TableError::Io { .. }), "{missing}");
    }
}
