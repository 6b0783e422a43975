//! `jostled run`: killed, interrupted, executed twice and concurrently.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::TIMEOUT;
use crate::support::process::{Process, jostled};

/// Some seconds of one core: long enough to be killed during the execution.
const EXPERIMENT: &str = r#"
name = "killed"
seed = 3
replicates = 3
duration = 150

[[grid]]
pi1 = [1, 4]
n = [20, 5]
contacts = ["endpoints", "closest"]
informed_fraction = 0.4

[measure]
order_every = 100
"#;

/// Its runs.
const RUNS: usize = 24;

/// A folder with the experiment's file in it.
fn write_experiment() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("killed.toml"), EXPERIMENT).unwrap();
    folder
}

fn command(folder: &Path, output: &str, more: &[&str]) -> Command {
    let [file, output] = ["killed.toml", output].map(|name| folder.join(name));
    let mut command = jostled(&["run"]);
    command.arg(file).arg("-o").arg(output).args(more);
    command
}

fn run(folder: &Path, output: &str, more: &[&str]) -> Output {
    let mut command = command(folder, output, more);
    command.stderr(Stdio::piped()).output().unwrap()
}

fn tables(folder: &Path, output: &str) -> BTreeMap<&'static str, Vec<u8>> {
    let names = ["results.csv", "results.parquet", "order.parquet"];
    let read = |name: &str| fs::read(folder.join(output).join(name)).unwrap();
    names.into_iter().map(|name| (name, read(name))).collect()
}

/// The complete lines of the list of finished runs, without its header.
fn finished(folder: &Path, output: &str) -> Vec<String> {
    let text = fs::read_to_string(folder.join(output).join("runs.jsonl")).unwrap_or_default();
    let lines = text.split_inclusive('\n').skip(1);
    let whole = lines.filter(|line| line.ends_with('\n'));
    whole.map(str::to_owned).collect()
}

/// Waits until `is_true`, or fails.
pub fn until(what: &str, mut is_true: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is_true() {
        assert!(began.elapsed() < TIMEOUT, "waiting for {what}");
        sleep(Duration::from_millis(2));
    }
}

#[test]
fn tables_are_the_same_bytes_however_often_it_is_killed_and_on_any_number_of_threads() {
    let folder = write_experiment();
    let folder = folder.path();
    let whole = run(folder, "whole", &["--threads", "1"]);
    assert_eq!(whole.status.code(), Some(0), "{whole:?}");
    let expected = tables(folder, "whole");
    let rows = String::from_utf8(expected["results.csv"].clone()).unwrap();
    assert_eq!(rows.lines().count(), RUNS + 1);

    for done in [1, 4, 8] {
        let mut process =
            Process::of(command(folder, "killed", &["--threads", "2"]).stdout(Stdio::null()));
        until("some runs", || finished(folder, "killed").len() >= done);
        process.signal("-KILL");
        process.end();
    }
    let before = finished(folder, "killed");
    assert!(before.len() < RUNS, "it was killed too late");
    // A truncated line is not a run.
    let list = folder.join("killed").join("runs.jsonl");
    let mut torn = fs::read(&list).unwrap();
    torn.extend(&before[0].as_bytes()[..20]);
    fs::write(&list, torn).unwrap();

    let rest = run(folder, "killed", &["--threads", "2"]);
    assert_eq!(rest.status.code(), Some(0), "{rest:?}");
    assert_eq!(tables(folder, "killed"), expected);
    let after = finished(folder, "killed");
    assert_eq!((after.len(), &after[..before.len()]), (RUNS, &before[..]));

    // A further execution changes nothing, and restores a missing table.
    fs::remove_file(folder.join("killed").join("results.csv")).unwrap();
    let again = run(folder, "killed", &[]);
    assert_eq!(again.status.code(), Some(0), "{again:?}");
    assert_eq!(tables(folder, "killed"), expected);
    assert_eq!(finished(folder, "killed"), after);
}

#[test]
fn ctrl_c_keeps_finished_runs_and_prints_how_to_resume() {
    let folder = write_experiment();
    let folder = folder.path();
    let mut interrupted = command(folder, "out", &["--threads", "2"]);
    let interrupted = interrupted.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut process = Process::of(interrupted);
    until("a run", || !finished(folder, "out").is_empty());

    let beside = run(folder, "out", &[]);
    assert_eq!(beside.status.code(), Some(1));
    let reason = String::from_utf8(beside.stderr).unwrap();
    assert!(reason.contains("another process"), "{reason}");

    process.signal("-INT");
    assert_eq!(process.end().0, Some(130));
    let mut stderr = String::new();
    let errors = process.0.stderr.take().unwrap();
    std::io::Read::read_to_string(&mut { errors }, &mut stderr).unwrap();
    assert!(
        stderr.contains("jostled run") && stderr.contains("-o"),
        "{stderr}"
    );
    let rows = tables(folder, "out")["results.csv"].clone();
    let rows = String::from_utf8(rows).unwrap().lines().count() - 1;
    assert_eq!(rows, finished(folder, "out").len());
    assert!((1..RUNS).contains(&rows));
}

#[test]
fn another_file_in_the_same_folder_is_rejected_and_changes_nothing() {
    let folder = write_experiment();
    let folder = folder.path();
    let output = folder.join("out");
    fs::create_dir(&output).unwrap();
    fs::write(output.join("experiment.toml"), "another").unwrap();
    let ended = run(folder, "out", &[]);
    assert_eq!(ended.status.code(), Some(1));
    let reason = String::from_utf8(ended.stderr).unwrap();
    assert!(reason.contains("choose another folder"), "{reason}");
    assert!(!output.join("runs.jsonl").exists());
}

#[test]
fn a_dry_run_lists_the_runs_and_their_seeds() {
    let folder = write_experiment();
    let file = folder.path().join("killed.toml");
    let listed = |more: &[&str]| {
        let mut command = jostled(&["run", "--dry-run"]);
        let output = command.arg(&file).args(more).output().unwrap();
        assert_eq!(output.status.code(), Some(0));
        String::from_utf8(output.stdout).unwrap()
    };
    let plain = listed(&[]);
    assert_eq!(plain.lines().count(), RUNS);
    let name = "pi1=1 n=20 informed_fraction=0.4 contacts=endpoints #0";
    let fields: Vec<&str> = plain.lines().next().unwrap().split('\t').collect();
    let [number, seed, first] = fields.try_into().unwrap();
    assert_eq!((number, first), ("1", name));
    let json = listed(&["--json"]);
    let first: serde_json::Value = serde_json::from_str(json.lines().next().unwrap()).unwrap();
    assert_eq!((&first["number"], &first["run"]), (&1.into(), &name.into()));
    assert_eq!(first["seed"].to_string(), seed);
    assert_eq!(
        (&first["informed"], &first["steps"]),
        (&8.into(), &7500.into())
    );

    fs::write(&file, EXPERIMENT.replace("duration", "durable")).unwrap();
    let mut command = jostled(&["run", "--dry-run"]);
    let output = command.arg(&file).stderr(Stdio::piped()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let reason = String::from_utf8(output.stderr).unwrap();
    assert!(
        reason.contains("line 5") && reason.contains("durable"),
        "{reason}"
    );
}

#[test]
fn a_file_outside_the_folder_has_a_warning_and_its_content_is_not_quoted() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("inner");
    fs::create_dir(&inner).unwrap();
    let (file, table) = (inner.join("a.toml"), folder.path().join("secret.csv"));
    let toml = "name = \"a\"\nduration = 1\nspec = { n = 5 }\npoints = \"../secret.csv\"\n";
    fs::write(&file, toml).unwrap();
    let output = inner.join("out");
    let results = ["-o", output.to_str().unwrap()];
    for more in [&["--dry-run"][..], &results] {
        for (content, code) in [("marmot:x:0\n1\n", 1), ("pi1\n2\n", 0)] {
            fs::write(&table, content).unwrap();
            let mut command = jostled(&["run"]);
            let command = command.arg(&file).args(more);
            let ended = command.stderr(Stdio::piped()).output().unwrap();
            let said = String::from_utf8(ended.stderr).unwrap();
            assert_eq!(ended.status.code(), Some(code), "{said}");
            let warning = "jostled: warning: points = \"../secret.csv\" is outside the folder";
            assert!(said.contains(warning), "{said}");
            assert!(!said.contains("marmot"), "{said}");
            assert_eq!(
                said.contains("line 1, column 1: what is wrong"),
                code == 1,
                "{said}"
            );
        }
    }
}
