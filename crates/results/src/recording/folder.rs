//! The parts of a recording in a folder.

use std::fs;
use std::path::{Path, PathBuf};

use super::error::io_error;
use super::temp_file::PARTIAL;
use super::{Format, RecordingError};

/// The prefix of a part's file name, before its number.
const PART: &str = "part-";

/// Lists the whole parts of a folder, ordered by number.
///
/// # Errors
///
/// [`RecordingError::Io`].
pub fn parts(folder: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let entries = fs::read_dir(folder).map_err(|source| io_error(folder, source))?;
    let mut parts = Vec::new();
    for entry in entries {
        let path = entry.map_err(|source| io_error(folder, source))?.path();
        let name = path.file_name().and_then(|name| name.to_str());
        if name.is_some_and(|name| name.starts_with(PART)) && Format::of(&path).is_ok() {
            parts.push(path);
        }
    }
    parts.sort_by_key(|part| (number_of(part), part.clone()));
    Ok(parts)
}

/// Returns the file name of a part.
#[must_use]
pub fn part_name(number: u64, format: Format) -> String {
    format!("{PART}{number:05}.{}", format.extension())
}

/// Returns the number in a part's file name.
#[must_use]
pub fn number_of(part: &Path) -> Option<u64> {
    let stem = part.file_stem()?.to_str()?;
    stem.strip_prefix(PART)?.parse().ok()
}

/// Removes the partial files that a crash left in a folder, and returns their paths.
///
/// # Errors
///
/// [`RecordingError::Io`].
pub fn sweep(folder: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let entries = fs::read_dir(folder).map_err(|source| io_error(folder, source))?;
    let mut removed = Vec::new();
    for entry in entries {
        let path = entry.map_err(|source| io_error(folder, source))?.path();
        if path
            .extension()
            .is_some_and(|extension| extension == PARTIAL)
        {
            fs::remove_file(&path).map_err(|source| io_error(&path, source))?;
            removed.push(path);
        }
    }
    Ok(removed)
}
