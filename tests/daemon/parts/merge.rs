//! Merges that fail or are killed leave no folder of results, and say what to do.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Command, Stdio};

use super::{EXPERIMENT, Fixture, TABLES};
use crate::experiment::until;
use crate::support::process::Process;
use crate::support::programs::program;
use crate::support::small_disk::SmallDisk;

#[test]
fn a_verified_merge_finds_a_run_with_another_result() {
    let fixture = Fixture::new();
    for (name, part) in [("one", "1/2"), ("two", "2/2")] {
        fixture.run(name, &["--part", part, "--threads", "2"]);
    }
    let output = fixture.merge(&["one", "two"], &["-o", "verified", "--verify", "20%"]);
    let output = output.unwrap();
    assert!(
        output.contains("executed 6 runs again, with the same results"),
        "{output}"
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
fn a_killed_merge_leaves_no_folder_of_results() {
    let fixture = Fixture::new();
    let series = EXPERIMENT.replace("order_every = 2", "order_every = 1");
    fs::write(fixture.path("parts.toml"), series).unwrap();
    for (name, part) in [("one", "1/2"), ("two", "2/2")] {
        fixture.run(name, &["--part", part, "--threads", "2"]);
    }
    let parts = ["one", "two"];
    let program = program("jostle");
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
        let Some(disk) = SmallDisk::mount(all.div_ceil(1 << 20) + 1) else {
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
    let Some(disk) = SmallDisk::mount(1) else {
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
    let program = program("jostle");
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
    let Some(disk) = SmallDisk::mount(1) else {
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
