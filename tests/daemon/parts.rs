//! Parts of an experiment, executed by several processes and merged: the same bytes as one machine's.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use crate::apart::{Process, jostled};
use crate::crash::disk::Small;
use crate::experiment::until;

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
touch = true
"#;

const RUNS: usize = 24;

const TABLES: [&str; 4] = [
    "results.csv",
    "results.parquet",
    "order.parquet",
    "touch.csv",
];

struct Fixture(tempfile::TempDir);

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
        let program = Path::new(env!("CARGO_BIN_EXE_jostled")).with_file_name("jostle");
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
        TABLES.iter().map(read).collect()
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
    let told = fixture.merge(&["parts"], &["-o", "merged"]).unwrap();
    assert_eq!(
        told,
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
    expect(&["one", "two"], 2, &["two has runs of model version 999"]);
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
fn a_verified_merge_finds_a_run_with_another_result() {
    let fixture = Fixture::new();
    for (name, part) in [("one", "1/2"), ("two", "2/2")] {
        fixture.run(name, &["--part", part, "--threads", "2"]);
    }
    let told = fixture.merge(&["one", "two"], &["-o", "verified", "--verify", "20%"]);
    let told = told.unwrap();
    assert!(
        told.contains("executed 6 runs again, with the same results"),
        "{told}"
    );
    // The last digit of a number, as a faulty processor would have it.
    fixture.edit("two", |text| {
        let (before, after) = text.rsplit_once("\"v\":").unwrap();
        let (number, after) = after.split_once(',').unwrap();
        let (digits, last) = number.split_at(number.len() - 1);
        let last = if last == "3" { "4" } else { "3" };
        format!("{before}\"v\":{digits}{last},{after}")
    });
    let all = ["-o", "rejected", "--verify", "100%"];
    let (code, message) = fixture.merge(&["one", "two"], &all).unwrap_err();
    assert_eq!(code, 9, "{message}");
    assert!(
        message.contains("1 of 24 runs have another result"),
        "{message}"
    );
    assert!(message.contains(" of two (state hash "), "{message}");
    assert!(message.contains("on both, other measurements"), "{message}");
    assert!(!fixture.path("rejected").exists());
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

#[test]
fn a_killed_merge_leaves_no_folder_of_results() {
    let fixture = Fixture::new();
    let series = EXPERIMENT.replace("order_every = 2", "order_every = 1");
    fs::write(fixture.path("parts.toml"), series).unwrap();
    for (name, part) in [("one", "1/2"), ("two", "2/2")] {
        fixture.run(name, &["--part", part, "--threads", "2"]);
    }
    let parts = ["one", "two"];
    let program = Path::new(env!("CARGO_BIN_EXE_jostled")).with_file_name("jostle");
    let mut killed = 0;
    let temporary = fixture.path(".jostle-killed.merge");
    for _ in 0..8 {
        let mut command = Command::new(&program);
        command.current_dir(fixture.0.path());
        command.args(["results", "merge", "one", "two", "-o", "killed"]);
        let mut process = Process::of(command.stdout(Stdio::null()));
        until("the merge", || {
            temporary.exists() || fixture.path("killed").exists()
        });
        process.signal("-KILL");
        process.end();
        if fixture.path("killed").exists() {
            fixture.tables("killed");
            fs::remove_dir_all(fixture.path("killed")).unwrap();
        } else {
            killed += 1;
        }
    }
    assert!(killed > 0, "no merge was killed before its end");
    fixture.merge(&parts, &["-o", "killed"]).unwrap();
    assert!(!temporary.exists());
    fixture.merge(&parts, &["-o", "again"]).unwrap();
    assert_eq!(fixture.tables("killed"), fixture.tables("again"));
    let (code, message) = fixture.merge(&parts, &["-o", "again"]).unwrap_err();
    assert_eq!(code, 4);
    assert!(
        message.contains("again exists and is not empty"),
        "{message}"
    );
    let (code, message) = fixture.merge(&parts, &["-o", "/proc/merged"]).unwrap_err();
    assert_eq!(code, 3, "{message}");
    assert!(message.contains("/proc"), "{message}");
}

#[test]
fn a_merge_on_a_full_disk_leaves_nothing() {
    let fixture = Fixture::new();
    for (name, part) in [("one", "1/2"), ("two", "2/2")] {
        fixture.run(name, &["--part", part, "--threads", "2"]);
    }
    let parts = ["one", "two"];
    let whole = fixture.merge(&parts, &["-o", "whole"]);
    whole.unwrap();
    let size = |name: &str| {
        fs::metadata(fixture.path("whole").join(name))
            .unwrap()
            .len()
    };
    let list = size("runs.jsonl");
    let all: u64 = list + TABLES.iter().map(|name| size(name)).sum::<u64>();
    // Full while the list is written, and while the tables are.
    for room in [list / 2, (list + all) / 2] {
        let Some(disk) = Small::mount(all.div_ceil(1 << 20) + 1) else {
            return;
        };
        disk.fill();
        let ballast = disk.path().join("ballast");
        let filled = fs::metadata(&ballast).unwrap().len();
        let file = fs::File::options().write(true).open(&ballast).unwrap();
        file.set_len(filled - room).unwrap();
        let merged = disk.path().join("merged");
        let to = ["-o", merged.to_str().unwrap()];
        let (code, message) = fixture.merge(&parts, &to).unwrap_err();
        assert_eq!(code, 8, "{message}");
        assert!(message.contains("No space left"), "{message}");
        let left = fs::read_dir(disk.path()).unwrap().count();
        assert_eq!(left, 1, "more than the ballast");
    }
}

#[test]
fn folders_that_cannot_be_written_are_named_and_nothing_is_left() {
    let fixture = Fixture::new();
    for (name, part) in [("one", "1/2"), ("two", "2/2")] {
        fixture.run(name, &["--part", part, "--threads", "2"]);
    }
    let Some(disk) = Small::mount(1) else {
        return;
    };
    let options = ["-o", "remount,ro"];
    let mount = Command::new("mount")
        .args(options)
        .arg(disk.path())
        .status();
    assert!(mount.unwrap().success());
    let target = disk.path().join("folder");
    let target = target.to_str().unwrap();
    let (code, message) = fixture.merge(&["one", "two"], &["-o", target]).unwrap_err();
    assert_eq!(code, 5, "{message}");
    assert!(message.contains("Read-only file system"), "{message}");
    let output = fixture
        .command(target, &["--part", "1/2"])
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("folder.1-of-2: Read-only"), "{message}");
    assert_eq!(fs::read_dir(disk.path()).unwrap().count(), 0);

    // An empty folder behind a link.
    fs::create_dir(fixture.path("behind")).unwrap();
    std::os::unix::fs::symlink("behind", fixture.path("link")).unwrap();
    fixture.merge(&["one", "two"], &["-o", "link"]).unwrap();
    assert_eq!(fixture.tables("behind"), fixture.tables("link"));

    // A folder without results.
    fs::create_dir(fixture.path("empty")).unwrap();
    let (code, message) = fixture
        .merge(&["one", "empty"], &["-o", "none"])
        .unwrap_err();
    assert_eq!(code, 3, "{message}");
    assert!(
        message.contains("empty contains no results: use folders"),
        "{message}"
    );
}

#[test]
fn a_part_that_cannot_be_read_is_named() {
    let fixture = Fixture::new();
    for (name, part) in [("one", "1/2"), ("two", "2/2")] {
        fixture.run(&format!("parts/{name}"), &["--part", part]);
    }
    let two = fixture.path("parts/two");
    let set_mode = |mode| fs::set_permissions(&two, fs::Permissions::from_mode(mode)).unwrap();
    set_mode(0o000);
    let program = Path::new(env!("CARGO_BIN_EXE_jostled")).with_file_name("jostle");
    let merge = ["results", "merge", "parts", "-o", "merged"];
    let plan = ["experiment", "plan", "parts.toml", "--missing", "parts"];
    for arguments in [&merge[..], &plan] {
        // With these capabilities the superuser may read everywhere.
        let capabilities = "=-dac_override,-dac_read_search";
        let mut command = Command::new("setpriv");
        command.args(["bounding-set", "inh-caps"].map(|it| format!("--{it}{capabilities}")));
        if !rustix::process::geteuid().is_root() {
            command = Command::new("env");
        }
        let command = command.arg(&program).args(arguments);
        let output = command.current_dir(fixture.0.path()).output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(5), "{message}");
        assert!(
            message.contains("parts/two: Permission denied"),
            "{message}"
        );
    }
    set_mode(0o755);
    assert!(!fixture.path("merged").exists());
}

#[test]
fn a_damaged_line_of_the_first_part_is_named() {
    let fixture = Fixture::new();
    let parts = ["one", "three", "two"];
    for (name, part) in parts.iter().zip(["1/3", "2/3", "3/3"]) {
        fixture.run(name, &["--part", part]);
    }
    let damage = |text: String| {
        let mut lines: Vec<&str> = text.split_inclusive('\n').collect();
        lines[1] = "{\"run\": 3}\n";
        lines.concat()
    };
    fixture.edit("one", damage);
    let message = fixture.rejected(&parts, 2);
    assert!(message.contains("one/runs.jsonl, line 2: "), "{message}");
    assert!(
        message.contains("restore the file from a copy"),
        "{message}"
    );
}

#[test]
fn a_merge_that_cannot_be_renamed_names_the_folder_of_its_results() {
    let fixture = Fixture::new();
    fixture.run("one", &["--part", "1/1"]);
    // A mount point cannot be replaced.
    let Some(disk) = Small::mount(1) else {
        return;
    };
    let target = disk.path().to_str().unwrap();
    let (_, message) = fixture.merge(&["one"], &["-o", target]).unwrap_err();
    let (folder, name) = target.rsplit_once('/').unwrap();
    let results = format!("{folder}/.jostle-{name}.merge");
    assert!(message.contains(&format!("failed to rename {results} to {target}: ")));
    assert!(message.contains("the results are complete in the former"));
    let table = fs::read(Path::new(&results).join("results.csv")).unwrap();
    fs::remove_dir_all(&results).unwrap();
    assert_eq!(table, fixture.tables("one")["results.csv"]);
}

#[test]
fn names_in_a_script_are_neither_options_nor_commands() {
    let fixture = Fixture::new();
    fs::copy(fixture.path("parts.toml"), fixture.path("-p.toml")).unwrap();
    let plan = ["experiment", "plan", "--parts", "2", "--emit", "slurm"];
    let planned = |more: &[&str]| fixture.jostle(&[&plan[..], more].concat());
    let script = planned(&["--out=-o", "--", "-p.toml"]).stdout;
    let script = String::from_utf8(script).unwrap();
    assert!(
        script.contains("\nexec jostled run ./-p.toml --part "),
        "{script}"
    );
    assert!(script.contains("\n  -o ./-o/part-"), "{script}");
    fs::copy(fixture.path("parts.toml"), fixture.path("p\nrm.toml")).unwrap();
    for more in [["p\nrm.toml", "--out=o"], ["parts.toml", "--out=o\rrm"]] {
        let output = planned(&more);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(
            message.contains("a script cannot contain control characters"),
            "{message}"
        );
        assert!(output.stdout.is_empty());
    }
}

/// The text of the blocks of a kind in a section of the page.
fn blocks(section: &str, kind: &str) -> Vec<String> {
    let page = include_str!("../../docs/cluster.md");
    let start = page.find(&format!("\n## {section}\n")).unwrap();
    let text = &page[start + 1..];
    let text = &text[..text.find("\n## ").unwrap_or(text.len())];
    let open = format!("```{kind}\n");
    let blocks = text.split(open.as_str()).skip(1);
    blocks
        .map(|it| it.split("```").next().unwrap().to_owned())
        .collect()
}

#[test]
fn the_commands_of_the_page_about_clusters_write_one_table() {
    let page = include_str!("../../docs/cluster.md");
    let toml = page.split("```toml\n").nth(1).unwrap();
    let toml = toml.split("```").next().unwrap();
    // In place of a job array, its elements one after the other; `tests/try-slurm` has a real one.
    let sbatch = "sbatch() { for it in 1 2 3 4; do SLURM_ARRAY_TASK_ID=$it bash \"$1\"; done; }\n";
    let mut tables = Vec::new();
    for (section, count, results) in [
        ("On one machine", 1, "results"),
        ("On several machines, by hand", 1, "merged"),
        ("Slurm", 2, "order-results"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("order.toml"), toml).unwrap();
        let blocks = blocks(section, "sh");
        assert_eq!(blocks.len(), count, "{section}");
        let programs = Path::new(env!("CARGO_BIN_EXE_jostled")).parent().unwrap();
        let path = std::env::var("PATH").unwrap();
        let output = Command::new("bash")
            .args(["-euc", &format!("{sbatch}{}", blocks.concat())])
            .current_dir(folder.path())
            .env("PATH", format!("{}:{path}", programs.display()))
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{section}: {output:?}");
        tables.push(fs::read(folder.path().join(results).join("results.csv")).unwrap());
    }
    assert!(tables.iter().all(|it| *it == tables[0]));
    let lines = tables[0].iter().filter(|&&byte| byte == b'\n').count();
    assert_eq!(lines, 41);
}
