//! `jostled backup` and `jostled restore`.

use std::path::Path;
use std::process::ExitCode;

use crate::backup::{BackupError, Incomplete, Manifest};
use crate::cli::{fail, print};

/// The exit code of a restoration after which experiments or recordings lack files.
pub const EXIT_INCOMPLETE: u8 = 9;

/// Prints that a backup of swarms was `done` in `folder`, and what it lacks; the exit code is
/// `if_incomplete` then.
pub fn report(
    done: &str,
    manifest: Result<Manifest, BackupError>,
    folder: &Path,
    as_json: bool,
    if_incomplete: u8,
) -> ExitCode {
    let manifest = match manifest {
        Ok(manifest) => manifest,
        Err(error) => return fail(1, &error),
    };
    let printed = match as_json {
        true => print(&format!("{}\n", manifest.summary(folder))),
        false => {
            let Manifest { swarms, files, .. } = &manifest;
            let mebibytes = manifest.bytes().div_ceil(1024 * 1024);
            let (folder, files) = (folder.display(), files.len());
            print(&format!(
                "{done}: swarms: {swarms}, files: {files}, {mebibytes} MiB in {folder}\n"
            ))
        }
    };
    for Incomplete { path, reason } in &manifest.incomplete {
        eprintln!("jostled: {path} lacks files and is {done} without them: {reason}");
    }
    match manifest.incomplete.is_empty() || printed != ExitCode::SUCCESS {
        true => printed,
        false => ExitCode::from(if_incomplete),
    }
}
