//! Parts of an experiment, executed by several processes and merged: the same bytes as one machine's.

mod merge;
mod scripts;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use crate::experiment::until;
use crate::support::process::{Process, jostled};
use crate::support::programs::program;

/// 24 runs of very different length, some seconds of one core in all.
const EXPERIMENT: &str = r#"
name = "parts"
seed = 7
replicates = 3
duration = 60

[[grid]]
pi1 = [1, 4]
n = [30, 5]
contacts = ["endpoints", "closest"]
informed_fraction = 0.4

[measure]
order_every = 2
series_every = 70
columns = ["milling", "msd(1)"]
touch = true
record_every = 200
"#;

const RUNS: usize = 24;

const TABLES: [&str; 5] = [
    "results.csv",
    "results.parquet",
    "order.parquet",
    "series.parquet",
    "touch.csv",
];

struct Fixture(tempfile::TempDir);

/// The names of all files of a folder, each followed by its bytes.
fn all_in(folder: &Path) -> Vec<u8> {
    let entries = fs::read_dir(folder).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let mut all = Vec::new();
    for path in paths {
        all.extend(path.file_name().unwrap().as_encoded_bytes());
        all.extend(fs::read(path).unwrap());
    }
    all
}

impl Fixture {
    fn new() -> Self {
        let fixture = Self(tempfile::tempdir().unwrap());
        fs::write(fixture.path("parts.toml"), EXPERIMENT).unwrap();
        fixture
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// `jostled run` of the experiment into a folder, not yet started.
    fn command(&self, folder: &str, more: &[&str]) -> Command {
        let mut command = jostled(&["run"]);
        command.arg(self.path("parts.toml")).arg("-o");
        command.arg(self.path(folder)).args(more);
        command.stdout(Stdio::null());
        command
    }

    fn run(&self, folder: &str, more: &[&str]) {
        let output = self.command(folder, more).stderr(Stdio::piped()).output();
        let output = output.unwrap();
        assert_eq!(output.status.code(), Some(0), "{output:?}");
    }

    fn jostle(&self, arguments: &[&str]) -> Output {
        let program = program("jostle");
        let mut command = Command::new(program);
        command.current_dir(self.0.path()).args(arguments);
        command.output().unwrap()
    }

    /// Merges folders. The error is the exit code and the message.
    fn merge(&self, parts: &[&str], more: &[&str]) -> Result<String, (i32, String)> {
        let arguments = [&["results", "merge"], parts, more].concat();
        let output = self.jostle(&arguments);
        let [out, error] = [output.stdout, output.stderr].map(|it| String::from_utf8(it).unwrap());
        match output.status.code() {
            Some(0) => Ok(out),
            code => Err((code.unwrap(), error)),
        }
    }

    /// Merges folders, which fails with this exit code and leaves nothing. Returns the message.
    fn rejected(&self, parts: &[&str], expected: i32) -> String {
        let (code, message) = self.merge(parts, &["-o", "rejected"]).unwrap_err();
        assert_eq!(code, expected, "{message}");
        assert!(!self.path("rejected").exists());
        assert!(!self.path(".jostle-rejected.merge").exists());
        message
    }

    fn tables(&self, folder: &str) -> BTreeMap<&'static str, Vec<u8>> {
        let read = |name: &&'static str| (*name, fs::read(self.path(folder).join(name)).unwrap());
        let trajectories = self.path(folder).join("trajectories");
        let mut read_all = TABLES.iter().map(read).collect::<BTreeMap<_, _>>();
        if trajectories.exists() {
            read_all.insert("trajectories", all_in(&trajectories));
        }
        read_all
    }

    /// Applies `change` to the list of finished runs of a folder.
    fn edit(&self, folder: &str, change: impl FnOnce(String) -> String) {
        let path = self.path(folder).join("runs.jsonl");
        let text = fs::read_to_string(&path).unwrap();
        fs::write(path, change(text)).unwrap();
    }
}

/// Number of complete lines of finished runs.
fn finished(folder: &Path) -> usize {
    let text = fs::read_to_string(folder.join("runs.jsonl")).unwrap_or_default();
    text.matches('\n').count().saturating_sub(1)
}

#[test]
fn killed_parts_merge_to_the_bytes_of_one_machine() {
    let fixture = Fixture::new();
    fixture.run("whole", &["--threads", "2"]);
    let expected = fixture.tables("whole");

    // The second part is interrupted, killed and resumed; it has its name only when it is complete.
    let part = ["--part", "2/3", "--threads", "1"];
    let unfinished = fixture.path("parts/.jostle-part-2.2-of-3");
    for signal in ["-TERM", "-KILL"] {
        let before = finished(&unfinished);
        let mut process = Process::of(&mut fixture.command("parts/part-2", &part));
        until("a run", || finished(&unfinished) > before);
        process.signal(signal);
        process.end();
        assert!(finished(&unfinished) > before && !fixture.path("parts/part-2").exists());
    }
    fixture.run("parts/part-1", &["--part", "1/3"]);
    fixture.run("parts/part-2", &part);
    assert!(!unfinished.exists());

    // One is missing: its runs are named, and the rest of them is planned.
    let message = fixture.rejected(&["parts"], 2);
    let listed = fixture.jostle(&["experiment", "plan", "parts.toml", "--parts", "3", "--json"]);
    let listed: serde_json::Value = serde_json::from_slice(&listed.stdout).unwrap();
    let runs = listed[2]["runs"].as_str().unwrap();
    let count = &listed[2]["count"];
    let expected_message = format!("{count} of {RUNS} runs are missing, {runs}: execute");
    assert!(message.contains(&expected_message), "{message}");
    let plan = ["experiment", "plan", "parts.toml", "--parts", "3", "--emit"];
    let missing = fixture.jostle(&[&plan[..], &["slurm", "--missing", "parts"]].concat());
    let script = String::from_utf8(missing.stdout).unwrap();
    assert!(script.contains("#SBATCH --array=3\n"), "{script}");

    // With another number of parts, and with the missing runs as new parts.
    let other = fixture.jostle(&[
        "experiment",
        "plan",
        "parts.toml",
        "--parts",
        "4",
        "--missing",
        "parts",
    ]);
    assert_eq!(other.status.code(), Some(2), "{other:?}");
    let error = String::from_utf8(other.stderr).unwrap();
    assert!(
        error.contains("/4 are finished: use the number of parts that"),
        "{error}"
    );
    let again = [
        "experiment",
        "plan",
        "parts.toml",
        "--json",
        "--missing",
        "parts",
    ];
    let again: serde_json::Value = serde_json::from_slice(&fixture.jostle(&again).stdout).unwrap();
    let first = runs.split([',', '-']).next().unwrap();
    let target = format!("parts-parts/runs-{first}");
    let command = [
        "jostled",
        "run",
        "parts.toml",
        "--runs",
        runs,
        "-o",
        &target,
    ];
    assert_eq!(again[0]["command"], serde_json::json!(command));

    fixture.run("parts/part-3", &["--runs", runs]);
    let output = fixture.merge(&["parts"], &["-o", "merged"]).unwrap();
    assert_eq!(
        output,
        format!("merged {RUNS} runs from 3 parts into merged\n")
    );
    assert_eq!(fixture.tables("merged"), expected);

    // The same commands again change nothing, nor does `jostled run` of all on the merged folder.
    let before = fs::read(fixture.path("merged/runs.jsonl")).unwrap();
    fixture.run("parts/part-2", &part);
    fixture.run("merged", &[]);
    assert_eq!(fs::read(fixture.path("merged/runs.jsonl")).unwrap(), before);
    assert_eq!(fixture.tables("merged"), expected);
}

#[test]
fn parts_that_do_not_fit_together_are_named_and_rejected() {
    let fixture = Fixture::new();
    for (name, part) in [("one", "1/2"), ("two", "2/2")] {
        fixture.run(name, &["--part", part, "--threads", "2"]);
    }
    let expect = |parts: &[&str], code: i32, pattern: &[&str]| {
        let message = fixture.rejected(parts, code);
        for part in pattern {
            assert!(message.contains(part), "{part}: {message}");
        }
    };
    fixture.run("three", &["--runs", "3,5-6"]);
    expect(&["one", "two", "three"], 2, &["both contain runs", "three"]);
    expect(
        &["one", "two", "one"],
        2,
        &["one and", "one both contain runs"],
    );
    expect(&["one", "absent"], 3, &["absent"]);

    let other = fixture.path("other");
    fs::create_dir(&other).unwrap();
    fs::write(
        other.join("experiment.toml"),
        EXPERIMENT.replace("seed = 7", "seed = 8"),
    )
    .unwrap();
    fs::write(other.join("runs.jsonl"), "").unwrap();
    expect(
        &["one", "other", "two"],
        2,
        &["of another experiment than", "other; merge only"],
    );

    // A worker with another version of the model.
    fixture.edit("two", |text| {
        let own = text.split_once("\"model_version\":").unwrap().1;
        let own = own.split_once('}').unwrap().0.to_owned();
        text.replacen(&format!(":{own}}}"), ":999}", 1)
    });
    expect(
        &["one", "two"],
        4,
        &[
            "different versions of the model: version",
            "version 999 in two",
        ],
    );
    fs::remove_dir_all(fixture.path("two")).unwrap();

    // A process is still executing a part in place.
    let whole = &["--threads", "1"];
    let mut running = Process::of(&mut fixture.command("two", whole));
    until("a run", || finished(&fixture.path("two")) > 0);
    expect(&["one", "two"], 4, &["two is in use: another process"]);
    running.signal("-TERM");
    let (code, took) = running.end();
    assert_eq!(code, Some(130));
    assert!(took < Duration::from_secs(1), "{took:?}");

    for arguments in [
        ["--part", "0/2"],
        ["--part", "3/2"],
        ["--part", "2"],
        ["--runs", "0"],
        ["--runs", "25"],
        ["--runs", "5-3"],
        ["--runs", ""],
    ] {
        let output = fixture.command("never", &arguments).output().unwrap();
        assert!(matches!(output.status.code(), Some(1 | 2)), "{arguments:?}");
        assert!(!fixture.path("never").exists());
    }
}

#[test]
fn a_plan_has_as_many_parts_as_requested() {
    let fixture = Fixture::new();
    let text = "name = \"many\"\nduration = 1\nreplicates = 30000\nspec = { n = 3 }\n";
    fs::write(fixture.path("many.toml"), text).unwrap();
    for (option, value, parts) in [("--parts", "2", 2), ("--secs", "1e9", 3)] {
        let plan = ["experiment", "plan", "many.toml", "--json", option, value];
        let output = fixture.jostle(&plan);
        let listed: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let listed = listed.as_array().unwrap();
        // A list of numbers, which `--secs` is for, is limited in length.
        assert_eq!(listed.len(), parts, "{option}");
        let counts = listed.iter().map(|part| part["count"].as_u64().unwrap());
        assert_eq!(counts.sum::<u64>(), 30_000);
    }
}

#[test]
fn a_run_continues_from_its_checkpoint_with_the_same_result() {
    let fixture = Fixture::new();
    let long = EXPERIMENT.replace("duration = 60", "duration = 600");
    let long = long.replace("order_every = 2", "order_every = 50");
    fs::write(fixture.path("parts.toml"), long).unwrap();
    // The first run: 30,000 steps of 30 individuals.
    let runs = ["--runs", "1", "--threads", "1"];
    fixture.run("whole", &runs);
    let expected = fixture.tables("whole");

    let label = format!("runs-{}", &blake3::hash(b"1").to_hex()[..8]);
    let unfinished = fixture.path(&format!(".jostle-killed.{label}"));
    let checkpoint = unfinished.join("checkpoints/000000.cbor");
    let often = [&runs[..], &["--checkpoint", "20ms"]].concat();
    let mut last = Vec::new();
    for signal in ["-KILL", "-TERM", "-KILL"] {
        let mut process = Process::of(&mut fixture.command("killed", &often));
        until("another checkpoint", || {
            fs::read(&checkpoint).is_ok_and(|bytes| bytes != last)
        });
        process.signal(signal);
        // `timeout` sends its signal twice.
        process.signal(signal);
        process.end();
        let now = fs::read(&checkpoint).unwrap();
        assert!(now != last && finished(&unfinished) == 0);
        last = now;
    }
    // Without the option, too.
    fixture.run("killed", &runs);
    assert_eq!(fixture.tables("killed"), expected);
    assert!(!fixture.path("killed/checkpoints").exists());

    // A checkpoint that cannot be read costs time, not the result.
    let checkpoints = fixture.path(&format!(".jostle-damaged.{label}/checkpoints"));
    fs::create_dir_all(&checkpoints).unwrap();
    fs::write(checkpoints.join("000000.cbor"), &last[..last.len() / 2]).unwrap();
    fixture.run("damaged", &runs);
    assert_eq!(fixture.tables("damaged"), expected);
}
