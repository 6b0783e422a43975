//! What `jostled doctor` says of a folder, and whether that happens.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use serde_json::{Value, json};

use crate::models::EARLIER;
use crate::support::Client;
use crate::support::daemon_process::{DaemonProcess, daemon};
use crate::support::process::jostled;

/// The files below a folder, and their bytes.
pub fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => {
                found.insert(path.clone(), Vec::new());
                found.extend(files(&path));
            }
            false => _ = found.insert(path.clone(), fs::read(path).unwrap()),
        }
    }
    found
}

/// The exit code, the report, the errors and the text of `jostled doctor` on a data folder and other arguments.
pub struct Said {
    pub code: i32,
    pub report: Value,
    pub errors: String,
    pub text: String,
}

pub fn ask(data: &Path, folders: &[&Path]) -> Said {
    let run = |more: &[&str]| {
        let mut command = jostled(&["doctor", "--data-dir"]);
        command.arg(data).args(folders).args(more);
        command.stderr(Stdio::piped()).output().unwrap()
    };
    let (text, output) = (run(&[]), run(&["--json"]));
    assert_eq!(text.status, output.status);
    assert_eq!(text.stderr, output.stderr);
    Said {
        code: output.status.code().unwrap(),
        report: serde_json::from_slice(&output.stdout).unwrap(),
        errors: String::from_utf8(output.stderr).unwrap(),
        text: String::from_utf8(text.stdout).unwrap(),
    }
}

/// As [`ask`], of a folder that no daemon uses, in which nothing may change.
pub fn ask_unchanged(data: &Path, folders: &[&Path]) -> Said {
    let all = |data: &Path| match data.is_dir() {
        true => files(data),
        false => BTreeMap::new(),
    };
    let before: Vec<_> = [&[data], folders].concat().into_iter().map(all).collect();
    let said = ask(data, folders);
    let after: Vec<_> = [&[data], folders].concat().into_iter().map(all).collect();
    assert!(before == after, "it changed {}", data.display());
    said
}

/// What is said of the swarms, by name.
pub fn swarms(said: &Said) -> BTreeMap<String, Value> {
    let swarms = said.report["swarms"].as_array().unwrap().iter();
    swarms
        .map(|it| (it["name"].as_str().unwrap().to_owned(), it.clone()))
        .collect()
}

pub fn last_line(text: &str) -> &str {
    text.lines().last().unwrap()
}

/// Checks that a daemon on this folder goes on with the swarms and experiments as was said.
pub async fn assert_happens(data: &Path, said: &Said) {
    let mut process = DaemonProcess::start(&mut daemon(data)).unwrap();
    let client = Client::open(&process.endpoint).await;
    let foretold = swarms(said);
    let listed = client.node("swarms").await["swarms"].clone();
    assert_eq!(listed.as_array().unwrap().len(), foretold.len(), "{listed}");
    for swarm in listed.as_array().unwrap() {
        let said = &foretold[swarm["swarm"].as_str().unwrap()];
        let mark = match said["marked"].as_bool().unwrap() {
            false => Value::Null,
            true => json!([{
                "model_version": said["model_version"],
                "epoch": said["epoch"],
                "step": said["step"],
            }]),
        };
        assert_eq!(swarm["earlier_models"], mark, "{said} {swarm}");
        // One that was running may have reached its end.
        if let Some(phase) = said.get("phase").filter(|it| *it != "running") {
            assert_eq!(swarm["phase"], *phase, "{said} {swarm}");
        }
    }
    let experiments = client.node("experiments").await["experiments"].clone();
    let foretold = said.report["experiments"].as_array().unwrap();
    assert_eq!(experiments.as_array().unwrap().len(), foretold.len());
    for said in foretold {
        let mut found = experiments.as_array().unwrap().iter();
        let found = found.find(|it| it["name"] == said["name"]).unwrap();
        let is_over =
            ["finished", "cancelled", "failed"].contains(&said["phase"].as_str().unwrap());
        let is_marked = said["marked"].as_bool().unwrap();
        assert_eq!(
            found["phase"] == "failed",
            is_marked && !is_over,
            "{said} {found}"
        );
        let is_earlier = said["model_version"] == EARLIER;
        let version = is_earlier.then(|| said["model_version"].clone());
        assert_eq!(found["model_version"], json!(version), "{said} {found}");
        if let Some(again) = said["again"].as_str().filter(|_| !is_over) {
            assert!(
                found["message"].as_str().unwrap().contains(again),
                "{said} {found}"
            );
        }
    }
    process.kill();
}
