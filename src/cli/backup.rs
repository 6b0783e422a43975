//! `jostled backup` and `jostled restore`.

use std::path::Path;
use std::process::ExitCode;

use crate::backup::{BackupError, Manifest};
use crate::cli::{fail, print};

/// Prints that a backup of swarms was `done` in `folder`.
pub fn report(
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
