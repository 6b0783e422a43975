//! What earlier builds accepted and this one rejects is executed and read as it was.
//! `tests/stored/make_accepted.py` writes it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use jostle_proto::{ErrorCode, EventKind, Events};
use serde_json::{Value, json};

use super::{assert_has_all, copy, start, stop};
use crate::experiments::{error_of, ok, rows, wait_for_phase};
use crate::support::process::jostled;
use crate::support::programs::ROOT;
use crate::support::{Client, until};

const WEIGHTLESS: &str = "a weight of 0 informs no individual: set pi2 above 0";

pub fn fixture() -> PathBuf {
    Path::new(ROOT).join("tests/stored/accepted")
}

pub fn replies() -> Value {
    serde_json::from_slice(&fs::read(fixture().join("replies.json")).unwrap()).unwrap()
}

/// The steps and errors of the scheduled commands that were rejected.
pub async fn rejected(client: &Client, swarm: &str) -> Vec<(u64, String)> {
    let reply = client.get(swarm, "events").await;
    let events: Events = serde_json::from_value(reply["result"].clone()).unwrap();
    let rejected = events.events.into_iter().filter_map(|it| match it.event {
        EventKind::Refused { error, .. } => Some((it.step, error.message)),
        _ => None,
    });
    rejected.collect()
}

/// Checks that the swarm is where it was, with all its commands.
pub async fn assert_replayed(client: &Client, expected: &Value) {
    until("school is where it was", async || {
        client.get("school", "status").await["step"] == expected["status"]["step"]
    })
    .await;
    let hash = &expected["status"]["result"]["state_hash"];
    let status = client.get("school", "status").await;
    assert_eq!(&status["result"]["state_hash"], hash);
    assert_eq!(status["seq"], expected["status"]["seq"]);
    let journal = client.get("school", "journal?limit=1000").await;
    assert_has_all(&journal["result"]["entries"], &expected["journal"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_journal_of_weightless_changes_is_replayed_and_the_rest_of_its_schedule_is_not_executed()
{
    let expected = replies()["school"].clone();
    let (process, client, _data) = start(&fixture()).await;
    assert_replayed(&client, &expected).await;
    let status = client.get("school", "status").await;
    let verified = client.get("school", "verify").await["result"].clone();
    assert_eq!(verified["differs_at"], Value::Null, "{verified}");
    assert_eq!(verified["to_step"], status["step"]);
    // One that was scheduled before is executed in an epoch of this version.
    client.ok("school", "step", json!({"steps": 41})).await;
    let expected = [(100, WEIGHTLESS.to_owned())];
    assert_eq!(rejected(&client, "school").await, expected);
    let verified = client.get("school", "verify").await["result"].clone();
    assert_eq!(verified["differs_at"], Value::Null, "{verified}");
    stop(process, client).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn experiments_with_weightless_changes_and_a_variable_named_fault_go_on() {
    let expected = replies()["experiments"].clone();
    let (process, client, data) = start(&fixture()).await;
    for name in ["weightless", "faults"] {
        let file = data
            .path()
            .join("experiments")
            .join(name)
            .join("experiment.toml");
        let toml = fs::read_to_string(file).unwrap();
        let again = ok(&client, json!({"submit": {"toml": toml}})).await;
        assert_eq!(again["created"], false, "{name}");
        let other = toml.replace(&format!("\"{name}\""), "\"other\"");
        let (code, message) = error_of(&client, json!({"submit": {"toml": other}})).await;
        let reason = match name {
            "weightless" => WEIGHTLESS,
            _ => "\"fault\" is a column of the results, a measure or a field of [spec]",
        };
        assert_eq!(code, ErrorCode::InvalidArgument);
        assert!(message.contains(reason), "{message}");
        ok(&client, json!({"resume": {"name": name}})).await;
        wait_for_phase(&client, name, "finished").await;
        let new = rows(&client, name, 100).await;
        assert_eq!(new.len(), 4);
        for old in expected[name]["rows"].as_array().unwrap() {
            let new = new.iter().find(|new| new["run"] == old["run"]).unwrap();
            assert_eq!(new["state_hash"], old["state_hash"], "{name}");
        }
        let extra = |row: &Value| row["extra"][0].clone();
        let named = |value: f64| json!({"name": "fault_", "value": value});
        let found: Vec<Value> = new.iter().map(extra).collect();
        match name {
            "weightless" => assert_eq!(found, [const { Value::Null }; 4]),
            _ => assert_eq!(found, [1.0, 1.0, 3.0, 3.0].map(named)),
        }
    }
    let folder = data.path().join("experiments/faults");
    let csv = fs::read_to_string(folder.join("results.csv")).unwrap();
    assert!(
        csv.lines().next().unwrap().ends_with(",fault_,fault"),
        "{csv}"
    );
    stop(process, client).await;
}

#[test]
fn a_folder_of_runs_with_a_variable_named_fault_goes_on_and_a_new_one_is_rejected() {
    let results = copy(&fixture(), "small");
    let file = fixture().join("small.toml");
    let run = |folder: &Path| {
        let mut command = jostled(&["run", file.to_str().unwrap(), "-o"]);
        command.arg(folder).stderr(Stdio::piped()).output().unwrap()
    };
    let again = run(results.path());
    assert!(again.status.success(), "{again:?}");
    let csv = fs::read_to_string(results.path().join("results.csv")).unwrap();
    assert!(
        csv.lines().next().unwrap().ends_with(",fault_,fault"),
        "{csv}"
    );
    let elsewhere = tempfile::tempdir().unwrap();
    let new = run(&elsewhere.path().join("new"));
    assert!(!new.status.success());
    let message = String::from_utf8(new.stderr).unwrap();
    assert!(message.contains("rename the variable"), "{message}");
    assert!(!elsewhere.path().join("new").exists());
}
