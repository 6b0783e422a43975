//! `jostled backup` and `jostled restore`.

use std::path::Path;
use std::process::ExitCode;

use crate::backup::{self, BackupError, Manifest};
use crate::cli::{fail, print};

/// Backs up the data folder into `target`.
pub fn back_up(data_dir: &Path, target: &Path, as_json: bool) -> ExitCode {
    conclude("backed up", backup::take(data_dir, target), target, as_json)
}

/// Restores the backup in `source` into the data folder.
pub fn restore(source: &Path, data_dir: &Path, as_json: bool) -> ExitCode {
    conclude(
        "restored",
        backup::restore(source, data_dir),
        data_dir,
        as_json,
    )
}

fn conclude(
    done: &str,
    manifest: Result<Manifest, BackupError>,
    folder: &Path,
    as_json: bool,
) -> ExitCode {
    match manifest {
        Ok(manifest) if as_json => print(&format!("{}\n", manifest.summary(folder))),
        Ok(manifest) => {
            let Manifest { swarms, files, .. } = &manifest;
            let mebibytes = manifest.bytes().div_ceil(1024 * 1024);
            let (folder, files) = (folder.display(), files.len());
            print(&format!(
                "{done}: swarms: {swarms}, files: {files}, {mebibytes} MiB in {folder}\n"
            ))
        }
        Err(error) => fail(1, &error),
    }
}
