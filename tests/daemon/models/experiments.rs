//! Experiments and result folders of an earlier version of the model: no table has runs of two versions.

use std::fs;
use std::path::Path;
use std::process::Output;

use jostle_physics::model::MODEL_VERSION;
use jostle_proto::ErrorCode;
use serde_json::{Value, json};

use super::folders::{EARLIER, age_experiment};
use crate::experiments::{ok, progress, rows, send, submit, wait_for_phase};
use crate::support::daemon_process::{self, DaemonProcess};
use crate::support::process::jostled;
use crate::support::{Client, until};

/// Two short runs, and one that takes longer.
fn half(name: &str) -> String {
    format!("name = \"{name}\"\nseed = 3\nduration = 300\n[[grid]]\nn = [3, 4, 80]\n")
}

const SHORT: &str = "name = \"short\"\nseed = 3\nduration = 5\nreplicates = 2\nspec = { n = 4 }\n";

/// Submits an experiment, and waits until some of its runs are finished.
async fn begin(client: &Client, name: &str) {
    submit(client, &half(name)).await;
    until("a run is finished", async || {
        progress(client, name).await["finished"].as_u64() >= Some(1)
    })
    .await;
}

async fn assert_conflict(client: &Client, args: Value, again: &str) {
    let error = send(client, &args).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::Conflict, "{args}: {error:?}");
    let details = (&error.details["model_version"], &error.details["again"]);
    assert_eq!(
        details,
        (&json!(EARLIER), &json!(again)),
        "{args}: {error:?}"
    );
    assert!(error.message.contains("--again"), "{error:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_half_done_experiment_ends_and_is_executed_again_beside_its_finished_runs() {
    let folder = tempfile::tempdir().unwrap();
    let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    for (name, verb) in [("paused", "pause"), ("cancelled", "cancel")] {
        begin(&client, name).await;
        let args: Value = [(verb, json!({"name": name}))].into_iter().collect();
        ok(&client, args).await;
    }
    begin(&client, "running").await;
    submit(&client, SHORT).await;
    process.kill();
    let names = ["paused", "cancelled", "running"];
    for name in names.into_iter().chain(["short"]) {
        age_experiment(&folder.path().join("experiments").join(name));
    }

    let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    // Without a finished run, it starts from its beginning.
    let short = wait_for_phase(&client, "short", "finished").await;
    assert_eq!(short["model_version"], Value::Null, "{short}");
    for name in names {
        let now = progress(&client, name).await;
        let phase = if name == "cancelled" { name } else { "failed" };
        assert_eq!(
            (&now["phase"], &now["model_version"]),
            (&json!(phase), &json!(EARLIER)),
            "{now}"
        );
        let count = now["finished"].as_u64().unwrap();
        assert!((1..3).contains(&count), "{now}");
        assert_eq!(rows(&client, name, 9).await.len() as u64, count);
        let again = format!("{name}-model{MODEL_VERSION}");
        assert_conflict(&client, json!({"resume": {"name": name}}), &again).await;
        assert_conflict(&client, json!({"submit": {"toml": half(name)}}), &again).await;
        assert_eq!(progress(&client, name).await, now, "nothing has changed");
    }
    let message = progress(&client, "running").await["message"].clone();
    assert!(message.as_str().unwrap().contains("--again"), "{message}");
    let log = daemon_process::log(folder.path());
    assert!(
        log.contains("executed the finished runs of experiment"),
        "{log}"
    );

    // Another file does not continue it.
    let other = half("running").replace("300", "200");
    let args = json!({"submit": {"toml": other, "again": true}});
    let error = send(&client, &args).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::AlreadyExists, "{error:?}");
    let args = json!({"submit": {"toml": half("running"), "again": true}});
    let new = format!("running-model{MODEL_VERSION}");
    // Nor does one of a user that has the name.
    let own = json!({"submit": {"toml": SHORT, "name": format!("cancelled-model{MODEL_VERSION}")}});
    assert_eq!(ok(&client, own).await["created"], true);
    let taken = json!({"submit": {"toml": half("cancelled"), "again": true}});
    let error = send(&client, &taken).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::AlreadyExists, "{error:?}");
    for is_first in [true, false] {
        let reply = ok(&client, args.clone()).await;
        assert_eq!(
            (&reply["created"], &reply["progress"]["name"]),
            (&json!(is_first), &json!(new)),
            "{reply}"
        );
    }
    // A kill changes nothing of that.
    process.kill();
    let process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    assert_eq!(progress(&client, "running").await["phase"], "failed");
    assert_eq!(ok(&client, args).await["created"], false);
    let done = wait_for_phase(&client, &new, "finished").await;
    assert_eq!(done["model_version"], Value::Null, "{done}");
    // Here both versions compute the same rows.
    let all = rows(&client, &new, 9).await;
    assert_eq!(all.len(), 3);
    for row in rows(&client, "running", 9).await {
        assert!(all.contains(&row), "{row}");
    }
    // What is not of another version is submitted as without `again`.
    let args = json!({"submit": {"toml": SHORT, "again": true}});
    let reply = ok(&client, args).await;
    assert_eq!(reply["progress"]["name"], "short", "{reply}");
    drop(process);
}

/// Executes `jostled run` in a folder.
fn run(folder: &Path, options: &[&str]) -> Output {
    let mut command = jostled(&["run", "short.toml", "--threads", "1", "--json"]);
    let command = command.args(options).current_dir(folder);
    command.stderr(std::process::Stdio::piped());
    command.output().unwrap()
}

fn document(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {output:?}"))
}

#[test]
fn a_folder_of_an_earlier_version_keeps_its_runs_and_again_executes_all_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("short.toml"), SHORT).unwrap();
    let csv = |name: &str| fs::read(path(name).join("results.csv")).unwrap();
    let list = |name: &str| fs::read(path(name).join("runs.jsonl")).unwrap();
    for (output, selection) in [("out", vec![]), ("part", vec!["--part", "1/2"])] {
        let options = |more: &[&'static str]| {
            let options = [&["-o", output], selection.as_slice(), more];
            run(folder.path(), &options.concat())
        };
        assert!(options(&[]).status.success());
        age_experiment(&path(output));
        let before = list(output);
        let rejected = options(&[]);
        assert_eq!(rejected.status.code(), Some(1), "{rejected:?}");
        let error = document(&rejected)["error"].clone();
        let new = format!("{output}-model{MODEL_VERSION}");
        assert_eq!(error["code"], "conflict", "{error}");
        let details = json!({"model_version": EARLIER, "again": new});
        assert_eq!(error["details"], details, "{error}");
        let message = String::from_utf8(rejected.stderr).unwrap();
        assert!(message.contains("--again"), "{message}");
        assert!(!path(&new).exists());
        let first = options(&["--again"]);
        assert!(first.status.success(), "{first:?}");
        assert_eq!(document(&first)["folder"], json!(new), "{first:?}");
        // Here both versions compute the same rows.
        assert_eq!(csv(&new), csv(output));
        let computed = list(&new);
        assert!(options(&["--again"]).status.success());
        assert_eq!(list(&new), computed, "no run was executed twice");
        assert_eq!(
            list(output),
            before,
            "the runs of the earlier version remain"
        );
    }
    // A folder of the user that has the name stays.
    let own = path(&format!("taken-model{MODEL_VERSION}"));
    fs::rename(path(&format!("out-model{MODEL_VERSION}")), &own).unwrap();
    let toml = own.join("experiment.toml");
    fs::write(&toml, format!("{SHORT}# another\n")).unwrap();
    fs::rename(path("out"), path("taken")).unwrap();
    let rejected = run(folder.path(), &["-o", "taken", "--again"]);
    let message = String::from_utf8(rejected.stderr).unwrap();
    assert!(
        message.contains("results of another experiment.toml"),
        "{message}"
    );
    // An interrupted part is in a folder of its own.
    let hidden = jostle_experiment::unfinished(&path("hidden"), "1-of-2");
    fs::rename(path("part"), &hidden).unwrap();
    let options = ["-o", "hidden", "--part", "1/2"];
    let error = document(&run(folder.path(), &options))["error"].clone();
    let new = format!("hidden-model{MODEL_VERSION}");
    assert_eq!(error["details"]["again"], json!(new), "{error}");
    let first = run(folder.path(), &[&options[..], &["--again"]].concat());
    assert_eq!(document(&first)["folder"], json!(new), "{first:?}");
    assert!(hidden.exists() && !path("hidden").exists());
    // Without an earlier one it is as without the option.
    let fresh = run(folder.path(), &["-o", "fresh", "--again"]);
    assert_eq!(document(&fresh)["folder"], "fresh", "{fresh:?}");
}
