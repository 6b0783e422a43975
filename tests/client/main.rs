//! Tests of the Rust client against a daemon.

#![expect(clippy::unwrap_used, reason = "tests")]

mod controller;
#[path = "../../clients/rust/examples_daemon.rs"]
mod daemon;
mod follow;
mod outage_client;
mod outages;
#[path = "../support/programs.rs"]
mod programs;
mod waits;

/// Each public future of the client states what is left of it when it is dropped.
#[test]
fn each_public_future_states_its_cancel_safety() {
    let folder = std::path::Path::new(programs::ROOT).join("clients/rust/src");
    for file in std::fs::read_dir(folder).unwrap() {
        let path = file.unwrap().path();
        // The tests of a file.
        if path.is_dir() {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let mut docs = String::new();
        for line in text.lines().map(str::trim) {
            if line.starts_with("pub async fn ") {
                let place = format!("{}: {line}", path.display());
                assert!(docs.contains("/// Cancel safety: "), "{place}");
            }
            match line.starts_with("///") || line.starts_with("#[") {
                true => docs += line,
                false => docs.clear(),
            }
        }
    }
}
