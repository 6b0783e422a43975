//! `jostled`: a write error of standard output is an error of every command that prints, and a closed
//! pipe is none. The daemon itself serves without standard output and standard error.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

use jostled::cli::arguments::command_line;
use serde_json::json;

use crate::check;
use crate::support::process::jostled;
use crate::support::{Client, NODE, PREFIX, TIMEOUT, until};

/// What the system says of `/dev/full`.
const FULL: &str = "jostled: failed to write to standard output: No space left on device";

/// Command lines of each command but `serve`, to which [`the_daemon_serves_without`] belongs. `{}` is a
/// folder with an experiment, a data folder and a backup; `{new}` does not exist.
const LINES: [(&str, &str); 24] = [
    ("auth add", "auth add --auth-dir {}/auth eva=viewer"),
    ("auth address", "auth address --auth-dir {}/auth"),
    ("auth address", "auth address --auth-dir {}/auth --json"),
    (
        "auth address",
        "auth address --auth-dir {}/auth --host jostle.example",
    ),
    ("auth init", "auth init --auth-dir {new} ada=operator"),
    ("auth list", "auth list --auth-dir {}/auth"),
    ("auth list", "auth list --auth-dir {}/auth --json"),
    ("auth remove", "auth remove --auth-dir {}/auth ada"),
    ("backup", "backup --data-dir {}/data {new}"),
    ("backup", "backup --data-dir {}/data {new} --json"),
    ("check", "check {}/order.html"),
    ("check", "check {}/order.html --json"),
    ("config default", "config default"),
    ("config explain", "config explain"),
    ("config explain", "config explain --json"),
    ("demo", "demo --listen tcp/127.0.0.1:0 --for 0.1s"),
    ("doctor", "doctor --data-dir {}/data"),
    ("doctor", "doctor --data-dir {}/data --json"),
    ("man", "man"),
    ("restore", "restore --data-dir {new} {}/backup"),
    ("run", "run {}/order.toml --output {new}"),
    ("run", "run {}/order.toml --output {new} --json"),
    ("run", "run {}/order.toml --dry-run"),
    ("run", "run {}/order.toml --dry-run --json"),
];

/// The help and the version.
const HELP: [&str; 5] = ["--help", "--version", "help", "help run", "auth add --help"];

/// A device on which every write fails, as on a full disk.
fn full() -> Stdio {
    File::options()
        .write(true)
        .open("/dev/full")
        .unwrap()
        .into()
}

fn run(line: &str, stdout: Stdio, stderr: Stdio) -> Output {
    let arguments: Vec<&str> = line.split(' ').collect();
    let mut command = jostled(&arguments);
    let child = command.stdout(stdout).stderr(stderr).spawn().unwrap();
    child.wait_with_output().unwrap()
}

/// A folder for the lines.
fn files() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let toml = "name = \"order\"\nduration = 1\nspec = { n = 3 }\n";
    fs::write(path("order.toml"), toml).unwrap();
    fs::write(path("order.html"), check::claimed()).unwrap();
    for line in [
        format!("auth init --auth-dir {} ada=operator", path("auth")),
        format!(
            "demo --listen tcp/127.0.0.1:0 --data-dir {} --for 0.1s",
            path("data")
        ),
        format!("backup --data-dir {} {}", path("data"), path("backup")),
    ] {
        let done = run(&line, Stdio::piped(), Stdio::piped());
        assert!(done.status.success(), "{line}: {done:?}");
    }
    folder
}

fn copy(from: &Path, to: &Path) {
    let copied = std::process::Command::new("cp")
        .args(["-a"])
        .args([from, to])
        .status();
    assert!(copied.unwrap().success());
}

/// The commands without commands of their own.
fn commands() -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for command in command_line().get_subcommands() {
        let name = command.get_name();
        let nested = command.get_subcommands();
        let nested: Vec<String> = nested
            .map(|it| format!("{name} {}", it.get_name()))
            .collect();
        match nested.is_empty() {
            true => found.extend([name.to_owned()]),
            false => found.extend(nested),
        }
    }
    found
}

#[test]
fn every_command_that_prints_fails_if_standard_output_does_and_ends_quietly_if_it_is_closed() {
    let listed = LINES.iter().map(|(command, _)| (*command).to_owned());
    let listed: BTreeSet<String> = listed.chain(["serve".to_owned()]).collect();
    assert_eq!(listed, commands(), "each command has a line");
    let prepared = files();
    let fresh = |line: &str| {
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("own");
        copy(prepared.path(), &own);
        let new = folder.path().join("new");
        let line = line.replace("{new}", new.to_str().unwrap());
        (line.replace("{}", own.to_str().unwrap()), folder)
    };
    for line in LINES.iter().map(|(_, line)| *line).chain(HELP) {
        let (typed, _folder) = fresh(line);
        let ended = run(&typed, Stdio::piped(), Stdio::piped());
        assert!(ended.status.success(), "{line}: {ended:?}");
        assert!(!ended.stdout.is_empty(), "{line}: {ended:?}");

        let (typed, _folder) = fresh(line);
        let ended = run(&typed, full(), Stdio::piped());
        let stderr = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(1), "{line}: {stderr}");
        assert!(stderr.contains(FULL), "{line}: {stderr}");

        let (typed, _folder) = fresh(line);
        let closed = std::io::pipe().unwrap().1;
        let ended = run(&typed, closed.into(), Stdio::piped());
        let stderr = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(0), "{line}: {stderr}");
        assert!(!stderr.contains("standard output"), "{line}: {stderr}");

        // An error that cannot be reported has its exit code nevertheless.
        let (typed, _folder) = fresh(line);
        assert_eq!(run(&typed, full(), full()).status.code(), Some(1), "{line}");
    }
}

#[test]
fn an_error_that_cannot_be_printed_has_its_exit_code() {
    for (line, code) in [
        ("--no-such-option", 2),
        ("config explain --http nowhere", 2),
        ("run /no/such.toml -o /no/such", 1),
        ("check /no/such.html", 2),
        (
            "serve --data-dir /dev/null/folder --listen tcp/127.0.0.1:0",
            2,
        ),
    ] {
        assert_eq!(
            run(line, full(), full()).status.code(),
            Some(code),
            "{line}"
        );
    }
}

/// Starts a daemon that can write to neither, and returns how it ends after `act`.
async fn the_daemon_serves_without(
    failpoints: &str,
    act: impl AsyncFnOnce(&Client, u32),
) -> Option<i32> {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = format!("unixsock-stream/{}/bus", folder.path().display());
    let mut command = jostled(&[
        "serve", "--node", "test", "--log", "info", "--listen", &endpoint,
    ]);
    command.arg("--data-dir").arg(folder.path().join("data"));
    if !failpoints.is_empty() {
        command.env("FAILPOINTS", failpoints);
    }
    let mut child = command.stdout(full()).stderr(full()).spawn().unwrap();
    let deadline = Instant::now() + TIMEOUT;
    while !folder.path().join("bus").exists() {
        assert!(Instant::now() < deadline && child.try_wait().unwrap().is_none());
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    // The socket exists a moment before the daemon listens on it.
    let client = loop {
        match Client::try_open(&endpoint).await {
            Ok(client) => break client,
            Err(error) => assert!(Instant::now() < deadline, "{error}"),
        }
    };
    let key = jostle_proto::keys::node_get(PREFIX, NODE, "status");
    // While it recovers its swarms, the reply is an error.
    until("it serves", async || {
        matches!(client.query_all(&key, None).await[..], [Ok(_)])
    })
    .await;
    act(&client, child.id()).await;
    let ended = tokio::task::spawn_blocking(move || child.wait().unwrap())
        .await
        .unwrap();
    assert_eq!(ended.signal(), None);
    ended.code()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_daemon_serves_and_ends_if_its_log_cannot_be_written() {
    let served = the_daemon_serves_without("", async |client, id| {
        client.create("live", json!({"n": 5})).await;
        client.ok("live", "step", json!({"steps": 3})).await;
        crate::support::process::send_signal(id, "-TERM");
    });
    assert_eq!(served.await, Some(0));
    // The process exits if its store can no longer be trusted.
    let failed = the_daemon_serves_without("store-fsync=20*off->return", async |client, _| {
        let key = jostle_proto::keys::node_cmd(PREFIX, NODE, "create");
        for k in 0.. {
            let spec = json!({"name": format!("live-{k}"), "spec": {"n": 5}}).to_string();
            // It exits without a reply.
            if client
                .query_all(&key, Some(spec.as_bytes()))
                .await
                .is_empty()
            {
                break;
            }
        }
    });
    assert_eq!(failed.await, Some(8));
}
