//! A write error of standard output is an error of every verb that prints, and a closed pipe is none.

use std::collections::BTreeSet;
use std::fs::File;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tokio::task::JoinSet;

use crate::requests::{files, rows, surface, verb};
use crate::support::{Canned, Ended, Running};

/// How many command lines run at once.
const AT_ONCE: usize = 6;

/// What the system says of `/dev/full`.
const FULL: &str = "failed to write to standard output: No space left on device";

/// Verbs that print nothing on standard output.
const SILENT: [&str; 0] = [];

/// Verbs without a row that ends by itself and without an error.
const WITHOUT_ROWS: [&str; 1] = ["doctor"];

/// The verb without `--json`.
const WITHOUT_JSON: &str = "auth link";

/// A device on which every write fails, as on a full disk.
fn full() -> Stdio {
    File::options()
        .write(true)
        .open("/dev/full")
        .unwrap()
        .into()
}

/// A pipe whose reader is gone.
fn closed() -> Stdio {
    std::io::pipe().unwrap().1.into()
}

async fn run(canned: &Canned, line: &str, stdout: Stdio) -> Ended {
    Running::begin_on(&canned.endpoint, line, "", stdout)
        .end()
        .await
}

/// Runs a line three times; returns whether it prints.
async fn check(canned: &Canned, line: &str) -> bool {
    let typed = |folder: &tempfile::TempDir| line.replace("{}", folder.path().to_str().unwrap());
    let folder = files();
    let ended = run(canned, &typed(&folder), Stdio::piped()).await;
    assert_eq!(ended.code, Some(0), "{line}: {ended:?}");
    let prints = !ended.stdout.is_empty();
    for (stdout, code) in [(full(), i32::from(prints)), (closed(), 0)] {
        let folder = files();
        let ended = run(canned, &typed(&folder), stdout).await;
        assert_eq!(ended.code, Some(code), "{line}: {ended:?}");
        let is_reported = ended.stderr.contains(FULL);
        assert_eq!(is_reported, code == 1, "{line}: {ended:?}");
        assert!(
            !ended.stderr.contains("standard output is closed"),
            "{line}: {ended:?}"
        );
    }
    prints
}

#[tokio::test(flavor = "multi_thread")]
async fn every_verb_that_prints_fails_if_standard_output_does_and_ends_quietly_if_it_is_closed() {
    let mut lines = Vec::new();
    let all = rows();
    let mut left_out = BTreeSet::new();
    for name in surface().into_keys() {
        match all.iter().find(|row| verb(row) == name && row.ends()) {
            Some(row) => lines.push((name, row.clone())),
            None => left_out.extend([name]),
        }
    }
    assert_eq!(left_out, WITHOUT_ROWS.map(str::to_owned).into());
    let (lines, next) = (Arc::new(lines), Arc::new(AtomicUsize::new(0)));
    let mut workers = JoinSet::new();
    for _ in 0..AT_ONCE {
        let (lines, next) = (lines.clone(), next.clone());
        workers.spawn(async move {
            let (open, for_anna) = (
                Canned::start().await,
                Canned::start_for("anna", "word").await,
            );
            let mut silent = Vec::new();
            while let Some((name, row)) = lines.get(next.fetch_add(1, Ordering::SeqCst)) {
                let canned = if row.is_of_anna() { &for_anna } else { &open };
                row.prepare(canned);
                let line = row.typed("{}".as_ref());
                let mut prints = false;
                for json in ["", " --json"] {
                    if !json.is_empty() && name == WITHOUT_JSON {
                        continue;
                    }
                    prints |= check(canned, &format!("{line}{json}")).await;
                }
                if !prints {
                    silent.push(name.clone());
                }
            }
            open.stop().await;
            for_anna.stop().await;
            silent
        });
    }
    let mut silent = BTreeSet::new();
    while let Some(worker) = workers.join_next().await {
        silent.extend(worker.unwrap());
    }
    assert_eq!(silent, SILENT.map(str::to_owned).into());
}

#[tokio::test(flavor = "multi_thread")]
async fn help_version_and_completions_fail_if_standard_output_does() {
    let canned = Canned::start().await;
    for line in [
        "--help",
        "--version",
        "help exit-codes",
        "list --help",
        "help list",
    ] {
        assert!(check(&canned, line).await, "{line}");
    }
    canned.stop().await;
    // Without a newline at its end, and through clap_complete.
    for (variables, arguments) in [
        (
            vec![("_CLAP_COMPLETE_INDEX", "5")],
            vec!["--", "jostle", "create", "other", "--contacts", "=", "end"],
        ),
        (
            vec![("_CLAP_COMPLETE_INDEX", "1"), ("_CLAP_IFS", "\n")],
            vec!["--", "jostle", "li"],
        ),
        (vec![], vec![]),
    ] {
        for (stdout, code) in [(Stdio::null(), 0), (full(), 1), (closed(), 0)] {
            let ended = Command::new(env!("CARGO_BIN_EXE_jostle"))
                .args(&arguments)
                .env("JOSTLE_COMPLETE", "bash")
                .envs(variables.iter().copied())
                .stdout(stdout)
                .stderr(Stdio::piped())
                .spawn()
                .unwrap()
                .wait_with_output()
                .unwrap();
            let stderr = String::from_utf8(ended.stderr).unwrap();
            assert_eq!(ended.status.code(), Some(code), "{arguments:?}: {stderr}");
            assert_eq!(stderr.contains(FULL), code == 1, "{arguments:?}: {stderr}");
        }
    }
}
