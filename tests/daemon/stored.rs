//! Stored files of earlier builds are opened, verified and replayed. Every expectation is a reply
//! that the earlier build gave: `tests/stored/make.py` writes both.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::support::daemon_process::{DaemonProcess, copy_all, daemon};
use crate::support::playback::upload_and_open;
use crate::support::process::jostled;
use crate::support::programs::ROOT;
use crate::support::{Client, NODE, PREFIX, TIMEOUT, until};

pub mod accepted;

/// The fixtures, one folder for each build.
pub fn builds() -> Vec<PathBuf> {
    let stored = Path::new(ROOT).join("tests/stored");
    let entries = fs::read_dir(stored).unwrap();
    let folders = entries.map(|entry| entry.unwrap().path());
    let builds: Vec<PathBuf> = folders
        .filter(|path| path.join("expected.json").exists())
        .collect();
    assert!(!builds.is_empty());
    builds
}

pub fn expected(build: &Path) -> Value {
    serde_json::from_slice(&fs::read(build.join("expected.json")).unwrap()).unwrap()
}

/// A copy of one of a build's folders, since a daemon changes its data.
pub fn copy(build: &Path, folder: &str) -> TempDir {
    let copy = tempfile::tempdir().unwrap();
    copy_all(&build.join(folder), copy.path());
    copy
}

/// Starts a daemon on a copy of the build's data folder.
async fn start(build: &Path) -> (DaemonProcess, Client, TempDir) {
    let data = copy(build, "data");
    let process = DaemonProcess::start(&mut daemon(data.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    (process, client, data)
}

async fn stop(mut process: DaemonProcess, client: Client) {
    client.session.close().await.unwrap();
    process.stop();
    assert_eq!(process.end(), Some(0));
}

/// Whether `new` has every field of `old` with its value; it may have more.
fn has_all(new: &Value, old: &Value) -> bool {
    match (new, old) {
        (Value::Object(new), Value::Object(old)) => old
            .iter()
            .all(|(name, old)| new.get(name).is_some_and(|new| has_all(new, old))),
        (Value::Array(new), Value::Array(old)) => {
            new.len() == old.len() && new.iter().zip(old).all(|(new, old)| has_all(new, old))
        }
        (new, old) => new == old,
    }
}

#[track_caller]
pub fn assert_has_all(new: &Value, old: &Value) {
    assert!(has_all(new, old), "not all of\n{old:#}\n is in\n{new:#}");
}

#[test]
fn a_missing_field_and_another_value_are_noticed() {
    let old = json!({"a": [{"b": 1}], "c": null});
    assert!(has_all(&json!({"a": [{"b": 1, "d": 2}], "c": null}), &old));
    for other in [
        json!({"a": [{"b": 2}], "c": null}),
        json!({"a": [{"b": 1}]}),
        json!({"a": [], "c": null}),
        json!({"a": [{"b": 1}, {"b": 1}], "c": null}),
    ] {
        assert!(!has_all(&other, &old), "{other}");
    }
}

/// Checks that the swarms, their history and the replies of a build are there.
pub async fn assert_recovered(client: &Client, expected: &Value) {
    let swarms = expected["swarms"].as_object().unwrap();
    let listed = client.node("swarms").await["swarms"].clone();
    assert_eq!(listed.as_array().unwrap().len(), swarms.len());
    for (name, old) in swarms {
        // Steps that were not in the checkpoint are taken again.
        until(&format!("{name} is where it was"), async || {
            client.get(name, "status").await["step"] == old["status"]["step"]
        })
        .await;
        let status = client.get(name, "status").await;
        assert!(status["epoch"].as_u64() > old["status"]["epoch"].as_u64());
        for field in ["step", "seq", "time", "phase"] {
            assert_eq!(status[field], old["status"][field], "{name} {field}");
        }
        let (now, before) = (&status["result"], &old["status"]["result"]);
        for field in ["state_hash", "n", "seed", "fault"] {
            assert_eq!(now[field], before[field], "{name} {field}");
        }
        assert!(
            before["when"].is_null() || now["when"] == before["when"],
            "{name}"
        );
        // This version may have more of them.
        assert_has_all(&now["parameters"], &before["parameters"]);
        assert_has_all(&client.get(name, "spec").await["result"], &old["spec"]);
        let journal = client.get(name, "journal?limit=1000").await;
        assert_has_all(&journal["result"]["entries"], &old["journal"]);
        // Earlier builds journaled no wall-clock time, and none is made up.
        if old["journal"][0]["unix_secs"].is_null() {
            let entries = journal["result"]["entries"].as_array().unwrap();
            assert!(entries.iter().all(|entry| entry["unix_secs"].is_null()));
        }
        let controllers = client.get(name, "controllers").await;
        assert_has_all(&controllers["result"], &old["controllers"]);
    }
    // Each request is known, and its reply is the first one.
    let requests = expected["requests"].as_array().unwrap();
    assert!(requests.len() > 20);
    for request in requests {
        let key = request["key"].as_str().unwrap();
        let payload = request["request"].to_string();
        let reply = client.query(key, Some(payload.as_bytes())).await;
        assert_eq!(reply.unwrap(), request["reply"], "{payload}");
    }
    for (name, old) in swarms {
        let status = client.get(name, "status").await;
        assert_eq!(status["seq"], old["status"]["seq"], "{name} executed twice");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn swarms_their_history_and_their_replies_are_recovered() {
    for build in builds() {
        let expected = expected(&build);
        let (process, client, _data) = start(&build).await;
        assert_recovered(&client, &expected).await;
        for name in expected["swarms"].as_object().unwrap().keys() {
            let verified = client.get(name, "verify").await;
            assert_eq!(verified["result"]["differs_at"], Value::Null, "{name}");
            let status = client.get(name, "status").await;
            assert_eq!(verified["result"]["to_step"], status["step"], "{name}");
        }
        stop(process, client).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn swarms_of_earlier_builds_are_as_protected_as_they_were_and_can_be_protected() {
    for build in builds() {
        let expected = expected(&build);
        let (mut process, client, data) = start(&build).await;
        let swarms = expected["swarms"].as_object().unwrap();
        for (name, old) in swarms {
            let status = client.get(name, "status").await;
            let was = &old["status"]["result"]["protected"];
            assert_eq!(status["result"]["protected"], *was, "{name}");
            client.ok(name, "protect", json!({"on": true})).await;
        }
        process.kill();
        let process = DaemonProcess::start(&mut daemon(data.path())).unwrap();
        let client = Client::open(&process.endpoint).await;
        for name in swarms.keys() {
            let status = client.get(name, "status").await;
            assert_eq!(status["result"]["protected"], true, "{name}");
            let (code, _) = client.err(name, "delete", json!({})).await;
            assert_eq!(code, ErrorCode::IncorrectState, "{name}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn snapshots_restore_and_the_future_is_the_same() {
    for build in builds() {
        let expected = &expected(&build)["snapshot"];
        let (process, client, _data) = start(&build).await;
        let snapshot = fs::read(build.join("school.snapshot")).unwrap();
        let request = json!({"name": "restored", "snapshot": STANDARD.encode(snapshot)});
        let key = keys::node_cmd(PREFIX, NODE, "restore");
        let restored = client
            .query(&key, Some(request.to_string().as_bytes()))
            .await;
        restored.unwrap();
        // The journal and the snapshot both hold a command that waits for step 2000.
        for swarm in ["restored", "school"] {
            let steps = json!({"steps": expected["steps"]});
            let reply = client.ok(swarm, "step", steps).await;
            assert_eq!(reply["step"], expected["step"], "{swarm}");
            assert_eq!(client.hash(swarm).await, expected["state_hash"], "{swarm}");
            let verified = client.get(swarm, "verify").await;
            assert_eq!(verified["result"]["differs_at"], Value::Null, "{swarm}");
        }
        // The controller is still a member: with "again" it takes its place and advances.
        let token = client.session.liveliness();
        let key = format!("{PREFIX}/led/ctl/ada/alive");
        let token = token.declare_token(key).await.unwrap();
        let join = json!({"controller": "ada", "select": {"ids": [0, 1]}, "again": true});
        client.ok("led", "join", join).await;
        let advance = json!({"expect_step": 50, "args": {"controller": "ada", "steps": 5}});
        assert_eq!(client.ok("led", "advance", advance).await["step"], 55);
        token.undeclare().await.unwrap();
        stop(process, client).await;
    }
}

/// Checks that the recordings of a build are there, and that the one that was not stopped goes on.
pub async fn assert_recorded(client: &Client, expected: &Value) {
    let expected = &expected["recordings"]["recordings"];
    let recordings = client.node("recordings").await["recordings"].clone();
    for (new, old) in recordings
        .as_array()
        .unwrap()
        .iter()
        .zip(expected.as_array().unwrap())
    {
        for field in ["recording", "swarm", "format", "every", "phase", "missed"] {
            assert_eq!(new[field], old[field], "{old}");
        }
        assert!(
            new["frames"].as_u64() >= old["frames"].as_u64(),
            "{new} {old}"
        );
    }
    assert_eq!(recordings.as_array().unwrap().len(), 3);
    // The recording that was not stopped continues with another frame.
    client.ok("filmed", "step", json!({"steps": 20})).await;
    let key = keys::node_cmd(PREFIX, NODE, "record");
    let stop_it = json!({"stop": {"recording": "going"}}).to_string();
    let stopped = client.query(&key, Some(stop_it.as_bytes())).await.unwrap();
    assert_eq!(stopped["result"]["phase"], "ended");
    let mut listed = recordings.as_array().unwrap().iter();
    let before = listed.find(|it| it["recording"] == "going").unwrap();
    assert!(
        stopped["result"]["frames"].as_u64() > before["frames"].as_u64(),
        "{stopped} {before}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn recordings_are_listed_resumed_and_played() {
    for build in builds() {
        let expected = expected(&build);
        let (process, client, data) = start(&build).await;
        assert_recorded(&client, &expected).await;
        // Every complete part is played, and so is the recording of a client.
        let mut frames = 0;
        let mut parts = fs::read_dir(data.path().join("recordings/film"))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|it| it == "mcap"))
            .collect::<Vec<_>>();
        parts.sort();
        for (number, part) in parts.iter().enumerate() {
            let name = format!("part-{number}");
            let shown = upload_and_open(&client, &name, &fs::read(part).unwrap()).await;
            let shown = match shown {
                // The recording was stopped after the last frame of the part before.
                Err(error) if error.message.contains("it has no frame") => continue,
                shown => shown.unwrap(),
            };
            let replay = &shown["result"]["replay"];
            assert_eq!(replay["of"], "filmed");
            frames += replay["frames"].as_u64().unwrap();
        }
        assert_eq!(
            json!(frames),
            expected["recordings"]["recordings"][0]["frames"]
        );
        let file = fs::read(build.join("filmed.mcap")).unwrap();
        let shown = upload_and_open(&client, "client", &file).await.unwrap();
        assert!(shown["result"]["replay"]["frames"].as_u64() > Some(1));
        client.ok("client", "seek", json!({"fraction": 1.0})).await;
        stop(process, client).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn experiments_continue_and_their_results_are_the_same() {
    for build in builds() {
        let old = &expected(&build)["experiment"];
        let (process, client, _data) = start(&build).await;
        let key = keys::experiment(PREFIX, NODE, "half", "results");
        let began = Instant::now();
        let page = loop {
            let page = client.query(&key, None).await.unwrap();
            if page["finished"] == 6 {
                break page;
            }
            assert!(began.elapsed() < 3 * TIMEOUT, "{page}");
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        };
        let (rows, old) = (
            page["rows"].as_array().unwrap(),
            old["rows"].as_array().unwrap(),
        );
        assert!(!old.is_empty() && old.len() < rows.len());
        for old in old {
            let new = rows.iter().find(|new| new["run"] == old["run"]);
            assert_has_all(new.unwrap(), old);
        }
        stop(process, client).await;

        let results = copy(&build, "results");
        let table = results.path().join("results.csv");
        let before = fs::read_to_string(&table).unwrap();
        fs::remove_file(&table).unwrap();
        let file = build.join("results.toml");
        let mut command = jostled(&["run", file.to_str().unwrap(), "--threads", "1", "-o"]);
        let run = command.arg(results.path()).output().unwrap();
        assert!(run.status.success(), "{run:?}");
        assert_eq!(fs::read_to_string(&table).unwrap(), before);
    }
}
