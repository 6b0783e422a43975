//! Files of measurements of contacts.

use std::io::Write;
use std::path::Path;

use super::{CONTACT_STATISTICS_NAME, ContactStatistics};
use crate::table::TableError;

/// Writes `rows` to `path`.
///
/// # Errors
///
/// [`TableError::Io`], or [`TableError::Malformed`] if a row cannot be encoded.
pub fn write(path: &Path, rows: &[ContactStatistics]) -> Result<(), TableError> {
    let io = |source| TableError::Io {
        path: path.to_owned(),
        source,
    };
    let mut file = jostle_atomic_file::begin(path).map_err(io)?;
    let mut writer = csv::Writer::from_writer(Vec::new());
    let written = rows.iter().try_for_each(|row| writer.serialize(row));
    let bytes = written
        .map_err(|error| error.to_string())
        .and_then(|()| writer.into_inner().map_err(|error| error.to_string()))
        .map_err(|reason| malformed(path, reason))?;
    file.write_all(&bytes).map_err(io)?;
    jostle_atomic_file::publish(file, path).map_err(io)
}

/// Reads the table of `directory`. If the directory has none, the result is empty.
///
/// # Errors
///
/// [`TableError::Malformed`] if the file cannot be read.
pub fn read(directory: &Path) -> Result<Vec<ContactStatistics>, TableError> {
    let path = directory.join(CONTACT_STATISTICS_NAME);
    if !path.exists() {
        return Ok(Vec::new());
    }
    let explain = |error: csv::Error| malformed(&path, error.to_string());
    let mut reader = csv::Reader::from_path(&path).map_err(explain)?;
    reader
        .deserialize()
        .map(|row| row.map_err(explain))
        .collect()
}

fn malformed(path: &Path, reason: String) -> TableError {
    TableError::Malformed {
        path: path.to_owned(),
        reason,
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn rows_round_trip_exactly() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(read(folder.path()).unwrap(), []);
        let row = ContactStatistics {
            run: "pi4=1 #0".to_owned(),
            pushing: 1.0 / 3.0,
            ..ContactStatistics::default()
        };
        let rows = [row.clone(), row];
        write(&folder.path().join(CONTACT_STATISTICS_NAME), &rows).unwrap();
        assert_eq!(read(folder.path()).unwrap(), rows);
        std::fs::write(folder.path().join(CONTACT_STATISTICS_NAME), "run,n\na,b\n").unwrap();
        assert!(read(folder.path()).is_err());
    }
}
