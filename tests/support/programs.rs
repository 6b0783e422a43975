//! The root of the checkout, and the programs that Cargo has built from it.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// The root of the checkout.
pub const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// Folders with sources of each program: Cargo links it again if one of them changes.
const SOURCES: [(&str, &[&str]); 2] = [
    (
        "jostled",
        &[
            "src",
            "proto/src",
            "clients/rust/src",
            "crates/atomic-file/src",
            "crates/conditions/src",
            "crates/convert/src",
            "crates/experiment/src",
            "crates/measures/src",
            "crates/physics/src",
            "crates/results/src",
            "third_party/zenoh-link-tls/src",
        ],
    ),
    (
        "jostle",
        &[
            "clients/cli/src",
            "clients/rust/src",
            "proto/src",
            "third_party/zenoh-link-tls/src",
        ],
    ),
];

/// The path of a program that Cargo built beside this test.
///
/// # Panics
///
/// If it does not exist, or one of its sources was changed after it was built.
pub fn program(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let program = test.parent().unwrap().parent().unwrap().join(name);
    let remedy = "`cargo test --release --no-run` builds it";
    let built = fs::metadata(&program).and_then(|it| it.modified());
    let built = built.unwrap_or_else(|error| panic!("{}: {error}: {remedy}", program.display()));
    let (_, folders) = SOURCES.iter().find(|(it, _)| *it == name).unwrap();
    for folder in *folders {
        if let Some(source) = newer(&Path::new(ROOT).join(folder), built) {
            panic!("{} is older than {source:?}: {remedy}", program.display());
        }
    }
    program
}

/// A file below a folder that was changed after `time`.
fn newer(folder: &Path, time: SystemTime) -> Option<PathBuf> {
    for entry in fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let is_newer = || entry.metadata().unwrap().modified().unwrap() > time;
        let found = match entry.file_type().unwrap().is_dir() {
            true => newer(&entry.path(), time),
            false => is_newer().then(|| entry.path()),
        };
        if found.is_some() {
            return found;
        }
    }
    None
}
