//! The generated files are those in the repository.

use std::collections::BTreeSet;
use std::fs;

use jostle_contract::{files, folder};

const COMMAND: &str = "cargo run --release -p jostle-contract";

#[test]
fn generated_files_are_up_to_date() {
    for (path, text) in files().unwrap() {
        let there = fs::read_to_string(folder().join(&path)).unwrap_or_default();
        assert!(
            there == text,
            "{} is out of date: run {COMMAND}",
            path.display()
        );
    }
}

#[test]
fn no_schema_is_left_of_a_message_that_is_gone() {
    let made: BTreeSet<_> = files().unwrap().into_keys().collect();
    for entry in fs::read_dir(folder().join("schema")).unwrap() {
        let path = entry.unwrap().path();
        let below = path.strip_prefix(folder()).unwrap();
        assert!(
            made.contains(below),
            "{} is of no message: run {COMMAND}",
            path.display()
        );
    }
}
