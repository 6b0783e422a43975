//! What is read page by page is the same whatever the size of a page.

use std::fs;

use serde_json::Value;

use crate::support::relay::Relay;
use crate::support::{Daemon, Running, until};

/// Eleven commands, with the creation of the swarm twelve events.
const COMMANDS: usize = 11;

/// Six runs, which differ in what they have.
const RUNS: &str = "name = \"runs\"\nseed = 3\nreplicates = 2\nduration = 4\n\
                    grid = [{ n = [3, 4, 5] }]\n\
                    measure = { series_every = 50, columns = [\"order\", \"milling\"] }\n";

/// One run: eleven entries of its order at 0, 2, …, 20, nine of its measures, six times three of its
/// trajectory.
const RUN: &str = "name = \"run\"\nseed = 3\nduration = 20\nspec = { n = 3 }\n\
                   measure = { order_every = 100, series_every = 125, record_every = 200, \
                   columns = [\"order\", \"milling\"] }\n";

/// A command line, and how many entries it prints.
const LINES: [(&str, usize); 16] = [
    ("--json events demo", COMMANDS + 1),
    ("--json events demo --after 3", COMMANDS - 2),
    ("--json events demo --limit 4", 4),
    ("--json journal demo --all", COMMANDS),
    ("--json journal demo --limit 4", 4),
    ("--json journal demo --after 5 --all", COMMANDS - 5),
    ("--json journal demo --verb step --all", 3),
    ("--json journal demo --verb set --limit 2", 2),
    ("--json audit --all --verb create", 7),
    ("--json audit --limit 5 --verb create", 5),
    ("experiment results runs --csv", 1 + 6),
    ("experiment results runs --series", 1 + 6 * 5),
    ("experiment results run --order #0", 1 + 11),
    ("experiment results run --series #0", 1 + 9),
    ("experiment results run --trajectory #0", 1 + 6 * 3),
    ("--json experiment results run --order #0 --limit 4", 4),
];

/// The number of entries on stdout.
fn count(line: &str, stdout: &str) -> usize {
    let lines: Vec<&str> = stdout.lines().collect();
    if !line.starts_with("--json") || line.contains("events") {
        return lines.len();
    }
    let document: Value = serde_json::from_str(stdout).unwrap();
    let place = match line {
        _ if line.contains("journal") => "/result/entries",
        _ if line.contains("audit") => "/result/lines",
        _ => "/order",
    };
    let entries = document.pointer(place).and_then(Value::as_array);
    entries
        .unwrap_or_else(|| panic!("{line}: {document}"))
        .len()
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_any_size_make_the_same_output() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 3").await;
    for number in 0..COMMANDS {
        let line = match number % 4 {
            0 => "step demo 5".to_owned(),
            _ => format!("set demo pi3=1.{number}"),
        };
        daemon.said(&line).await;
    }
    for name in ["a", "b", "c", "d", "e", "last"] {
        daemon.said(&format!("create {name} --n 1")).await;
    }
    until("the audit log has all lines", async || {
        daemon.said("audit").await.contains("last")
    })
    .await;
    for (name, text) in [("runs", RUNS), ("run", RUN)] {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        let run = format!("experiment run {}", path.display());
        assert_eq!(daemon.jostle(&run).await.code, Some(0));
    }
    let relay = Relay::to(&daemon.endpoint).await;
    for (line, expected) in LINES {
        let whole = daemon.said(line).await;
        assert_eq!(count(line, &whole), expected, "{line}: {whole}");
        for size in [1, 2, 3, 6, 11, 12, 100_000] {
            relay.ask_for(size);
            relay.asked();
            let ended = Running::begin(&relay.endpoint, line, "").end().await;
            assert_eq!(ended.code, Some(0), "{line}, {size}: {ended:?}");
            assert_eq!(ended.stdout, whole, "{line}, pages of {size}");
            let asked = relay.asked();
            assert!(asked >= 1, "{line}: nothing was paged");
            if size == 1 {
                assert!(asked >= expected.min(6), "{line}: {asked} pages");
            }
        }
    }
    // The same in files.
    for (line, file) in [
        ("experiment results run --trajectory #0 -o", "rows.csv"),
        ("experiment results runs -o", "results/results.csv"),
    ] {
        let written = async |endpoint: &str| {
            let folder = tempfile::tempdir().unwrap();
            let place = folder.path().join(file.split('/').next().unwrap());
            let line = format!("{line} {}", place.display());
            let ended = Running::begin(endpoint, &line, "").end().await;
            assert_eq!(ended.code, Some(0), "{line}: {ended:?}");
            fs::read_to_string(folder.path().join(file)).unwrap()
        };
        relay.ask_for(100_000);
        let whole = written(&relay.endpoint).await;
        let header = whole.lines().next().unwrap();
        assert_eq!(whole.matches(header).count(), 1, "{whole}");
        for size in [1, 2, 5] {
            relay.ask_for(size);
            relay.asked();
            assert_eq!(written(&relay.endpoint).await, whole, "{line}, {size}");
            assert!(relay.asked() > 1, "{line}: nothing was paged");
        }
    }
    daemon.stop().await;
}
