//! Each argument of each verb has an effect on the request or on the output.

pub mod row;
mod rows;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use jostle_experiment::{Execution, ExecutionControl, Folder, Plan, Subset, execute};
use jostle_results::ResultRow;
use jostle_results::claims::bands;
use serde_json::{Value, json};
use tokio::task::JoinSet;

use self::row::{Added, Row};
pub use self::rows::rows;
use crate::exporting;
use crate::support::Canned;
use crate::support::canned;

/// How many command lines run at once.
const AT_ONCE: usize = 6;

/// The common options; [`everything_in_common_arrives`] and `options.rs` test them.
const IN_COMMON: [&str; 7] = [
    "--credentials",
    "--endpoint",
    "--json",
    "--node",
    "--prefix",
    "--timeout",
    "-e",
];

/// The options of commands to a swarm: option, field of the request, value on the command line, value
/// in the request.
fn sending() -> [(&'static str, &'static str, &'static str, Value); 3] {
    [
        ("--at-step", "at_step", "9001", json!(9001)),
        ("--expect-epoch", "expect_epoch", "3", json!(3)),
        ("--expect-step", "expect_step", "8002", json!(8002)),
    ]
}

/// The options about the sender, in the same form.
fn sender() -> [(&'static str, &'static str, &'static str, Value); 2] {
    [
        ("--request-id", "request_id", "order-17", json!("order-17")),
        ("--client", "client", "ada@desk", json!("ada@desk")),
    ]
}

/// Each verb with its own arguments, from the list that is compared with clap's.
pub fn surface() -> BTreeMap<String, BTreeSet<String>> {
    let lines: Vec<&str> = include_str!("../../../surface.txt").lines().collect();
    let is_argument = |word: &str| word.starts_with(['-', '<']);
    let mut verbs = BTreeMap::new();
    for line in &lines {
        let (verb, argument) = line.rsplit_once(' ').unwrap_or((line, ""));
        let (verb, argument) = match is_argument(argument) {
            true => (verb, argument),
            false => (*line, ""),
        };
        let arguments: &mut BTreeSet<String> = verbs.entry(verb.to_owned()).or_default();
        arguments.extend((!argument.is_empty()).then(|| argument.to_owned()));
    }
    let names: Vec<String> = verbs.keys().cloned().collect();
    let has_verbs = |verb: &str| names.iter().any(|it| it.starts_with(&format!("{verb} ")));
    verbs.retain(|verb, _| !has_verbs(verb));
    verbs
}

/// The verb of a command line.
pub fn verb(row: &Row) -> String {
    let words = row.line.split(' ');
    let is_word = |word: &&str| !word.starts_with(['-', '<']);
    let words: Vec<&str> = words.take_while(is_word).take(2).collect();
    let verbs = surface();
    match (verbs.get(&words.join(" ")), words.first()) {
        (Some(_), _) => words.join(" "),
        (None, Some(word)) => (*word).to_owned(),
        (None, None) => "jostle".to_owned(),
    }
}

/// An experiment of two short runs.
const GRID: &str = "name = \"grid\"\nduration = 1\nreplicates = 2\n[spec]\nn = 3\n";

/// Executes runs of [`GRID`] into a folder.
fn part(folder: &Path, runs: &str) {
    let plan = Plan::parse(GRID).unwrap();
    let execution = Execution {
        plan: &plan,
        subset: &Subset::parse(&plan, runs).unwrap(),
        threads: 1,
        checkpoint_every: None,
    };
    let mut folder = Folder::open(folder, &plan).unwrap();
    execute(execution, &mut folder, &ExecutionControl::new()).unwrap();
}

/// A folder with the files that the command lines read.
pub fn files() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &[u8]| fs::write(folder.path().join(name), text).unwrap();
    write("spec.json", br#"{"n": 9, "pi1": 4.5, "seed": 4}"#);
    write(
        "batch.json",
        br#"[{"verb": "set", "args": {"pi3": 2}},
            {"verb": "remove", "args": {"select": {"count": 1}}}]"#,
    );
    write("order.toml", b"name = \"order\"\n");
    write("tape.mcap", b"tape\n");
    write("killed.mcap.partial", b"\x89MCAP0\r\n");
    for name in ["present", "replaced", "present.mcap", "replaced.mcap"] {
        write(name, b"is there already");
    }
    let runs: Vec<ResultRow> =
        serde_json::from_value(canned::read("experiment.results")["rows"].take()).unwrap();
    let results = folder.path().join("results");
    fs::create_dir(&results).unwrap();
    jostle_results::table::write(&results, &runs, &[]).unwrap();
    write("grid.toml", GRID.as_bytes());
    write("jostle.wasm.gz", &exporting::MODULE);
    write("claimed.html", exporting::claimed(GRID).as_bytes());
    for (name, run) in [("one", "1"), ("two", "2")] {
        part(&folder.path().join("parts").join(name), run);
    }
    let bands = bands::make(&runs, &[], 4);
    bands::write(&folder.path().join("old-bands.csv"), &bands).unwrap();
    let snapshot = fs::read(canned::path("snapshot.reply.cbor")).unwrap();
    let reply: ciborium::Value = ciborium::from_reader(snapshot.as_slice()).unwrap();
    let fields = reply.as_map().unwrap();
    let result = fields
        .iter()
        .find(|(name, _)| name.as_text() == Some("result"));
    write("demo.snapshot", &jostle_proto::to_cbor(&result.unwrap().1));
    let me = folder.path().join("me");
    fs::create_dir(&me).unwrap();
    let credentials = json!({
        "person": "anna", "role": "operator", "endpoint": "tcp/127.0.0.1:1",
        "token": "secret", "password": "word",
    });
    fs::write(me.join("credentials.json"), credentials.to_string()).unwrap();
    folder
}

/// Checks rows concurrently, each with its additions.
async fn check_all(rows: Vec<(Row, Added)>) {
    assert!(rows.len() > 40, "{}", rows.len());
    let rows = Arc::new(rows);
    let next = Arc::new(AtomicUsize::new(0));
    let mut workers = JoinSet::new();
    for _ in 0..AT_ONCE {
        let (rows, next) = (rows.clone(), next.clone());
        workers.spawn(async move {
            let (open, folder) = (Canned::start().await, files());
            let for_anna = Canned::start_for("anna", "word").await;
            while let Some((row, added)) = rows.get(next.fetch_add(1, Ordering::SeqCst)) {
                let is_anna = added.token.is_some() || row.is_of_anna();
                let canned = if is_anna { &for_anna } else { &open };
                row.check(canned, folder.path(), added).await;
            }
            open.stop().await;
            for_anna.stop().await;
        });
    }
    while let Some(worker) = workers.join_next().await {
        worker.unwrap();
    }
    assert!(next.load(Ordering::SeqCst) >= rows.len());
}

#[test]
fn every_argument_of_every_verb_has_a_row() {
    let mut listed: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for row in rows() {
        listed
            .entry(verb(&row))
            .or_default()
            .extend(row.arguments());
    }
    let common: BTreeSet<String> = IN_COMMON.map(str::to_owned).into();
    let options = sending().into_iter().chain(sender());
    let how: BTreeSet<String> = options.map(|(option, ..)| option.to_owned()).collect();
    for (verb, arguments) in surface() {
        let rows = listed
            .remove(&verb)
            .unwrap_or_else(|| panic!("no row of {verb}"));
        // These are added to the first row of each verb that has them.
        let missing: Vec<_> = arguments
            .iter()
            .filter(|it| !rows.contains(*it) && !how.contains(*it) && !common.contains(*it))
            .collect();
        assert!(missing.is_empty(), "no row of {verb} has {missing:?}");
        let unknown: Vec<_> = rows.difference(&arguments).collect();
        let unknown: Vec<_> = unknown.iter().filter(|it| !common.contains(**it)).collect();
        assert!(unknown.is_empty(), "{verb} has no {unknown:?}");
    }
    assert!(listed.is_empty(), "no such verbs: {:?}", listed.keys());
}

#[tokio::test(flavor = "multi_thread")]
async fn every_argument_arrives_in_the_request_or_the_output() {
    check_all(
        rows()
            .into_iter()
            .map(|row| (row, Added::default()))
            .collect(),
    )
    .await;
}

/// The first row of each verb that sends anything.
pub fn bases() -> Vec<(String, Row)> {
    let mut bases: Vec<(String, Row)> = Vec::new();
    for row in rows() {
        let verb = verb(&row);
        if !row.sends.is_empty() && bases.iter().all(|(it, _)| *it != verb) {
            bases.push((verb, row));
        }
    }
    bases
}

#[tokio::test(flavor = "multi_thread")]
async fn everything_in_common_arrives() {
    let surface = surface();
    let mut rows = Vec::new();
    for (verb, mut row) in bases() {
        let has = |option: &str| surface[&verb].contains(option);
        let mut added = Added {
            options: " --prefix other --timeout 3.5 --credentials {}/me".to_owned(),
            prefix: Some("other"),
            token: Some("secret"),
            envelope: vec![("timeout_secs", json!(3.5))],
            ..Added::default()
        };
        // `fork --at-step` is an argument of its own, and so is `--client` of what was sent before.
        let sending = sending().into_iter().filter(|_| verb != "fork");
        let is_past = ["audit", "journal"].contains(&verb.as_str());
        let sender = sender().into_iter().filter(|_| !is_past);
        for (option, field, typed, value) in sending.chain(sender) {
            if has(option) {
                added.options.push_str(&format!(" {option} {typed}"));
                added.envelope.push((field, value));
            }
        }
        if has("--expect-step") {
            row = row.scheduled();
        }
        if is_of_a_daemon(&verb) {
            added.options.push_str(" --node second");
            added.node = Some("second");
        }
        rows.push((row, added));
    }
    check_all(rows).await;
}

/// The verbs that send requests to a daemon, and so offer `--node`. Of these `watch` lists the
/// swarms of a daemon only on a terminal, and `delete --node` has a row of its own.
fn is_of_a_daemon(verb: &str) -> bool {
    let group = verb.split(' ').next().unwrap_or_default();
    [
        "audit",
        "auth",
        "create",
        "experiment",
        "list",
        "record",
        "replay",
        "restore",
        "schema",
        "top",
    ]
    .contains(&group)
}
