//! Copies of files of runs.

use std::fs::{self, File};
use std::path::Path;

use super::error::{FolderError, io_error};

/// Copies a file of a run from another folder. The copy is durable on return.
pub fn copy(from: &Path, to: &Path) -> Result<(), FolderError> {
    let mut source = File::open(from).map_err(|error| io_error(from, error))?;
    let fail = |error| io_error(to, error);
    fs::create_dir_all(parent(to)).map_err(fail)?;
    let mut file = jostle_atomic_file::begin(to).map_err(fail)?;
    std::io::copy(&mut source, &mut file).map_err(fail)?;
    jostle_atomic_file::publish(file, to).map_err(fail)
}

/// Returns the folder that contains `path`.
pub fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}
