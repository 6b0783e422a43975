//! A lab is upgraded: all that its folder has goes on or says why not, also if the first start after the
//! upgrade is killed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use jostle_physics::model::MODEL_VERSION;
use jostle_proto::ErrorCode;
use jostled::persistence::writer;
use jostled::swarm::journal::Record;
use rusqlite::{Connection, OpenFlags};
use serde_json::{Value, json};

use super::downgrade::assert_refused;
use super::folders::EARLIER;
use super::lab::{Lab, audit, journal, names};
use super::{assert_earlier, get};
use crate::experiments::{progress, rows, wait_for_phase};
use crate::support::daemon_process::{DaemonProcess, StoreCopy, copy_all, daemon, log, start};
use crate::support::{Client, recording, until};
use crate::when;

/// What a swarm that stands has in its status before and after.
const SAME: [&str; 13] = [
    "controllers",
    "fault",
    "informed",
    "n",
    "parameters",
    "protected",
    "rate",
    "reason",
    "scheduled",
    "seed",
    "state_hash",
    "waiting_for",
    "when",
];

/// The points of the first start at which it is killed, in their order.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Point {
    /// The tables are of the new schema, which is not committed.
    Migrating,
    Migrated,
    /// The new epoch of the first swarm is durable, and its checkpoint is not.
    Resumed,
    /// The checkpoint of the first swarm is durable, and no other swarm is recovered.
    Checkpointed,
    /// All swarms and experiments go on, and the daemon does not listen yet.
    Recovered,
}

impl Point {
    /// Starts a daemon on `data`, which is killed at the point.
    async fn kill(self, data: &Path) {
        let point = match self {
            Point::Migrating => "store-migrating=return",
            Point::Migrated => "store-migrated=return",
            Point::Resumed => "swarm-resumed=return",
            Point::Checkpointed => "recover-swarm=1*off->pause",
            Point::Recovered => "daemon-recovered=return",
        };
        let mut command = daemon(data);
        command.env("FAILPOINTS", point);
        if self == Point::Checkpointed {
            let mut child = command.stdout(Stdio::null()).spawn().unwrap();
            until("a new checkpoint is durable", async || {
                number(data, NEW_CHECKPOINTS) > Some(0)
            })
            .await;
            child.kill().unwrap();
            child.wait().unwrap();
        } else {
            // It has no exit code: it was killed, and at the point.
            let ended = DaemonProcess::start(&mut command).err();
            assert_eq!(ended, Some(None), "{self:?}");
        }
        // A copy: closing the database would move its log into it.
        let left = tempfile::tempdir().unwrap();
        copy_all(data, left.path());
        let number = |query| number(left.path(), query).unwrap();
        let is_old = self == Point::Migrating;
        assert_eq!(number("PRAGMA user_version") == 3, is_old, "{self:?}");
        let is_early = [Point::Migrating, Point::Migrated, Point::Resumed].contains(&self);
        assert!(number(NEW_CHECKPOINTS) == 0 || !is_early, "{self:?}");
    }
}

/// A number in the database of a folder; none while the daemon has it locked.
fn number(folder: &Path, query: &str) -> Option<i64> {
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE;
    let file = folder.join("jostle.sqlite");
    let number = Connection::open_with_flags(file, flags)
        .and_then(|it| it.query_row(query, [], |row| row.get(0)));
    number.ok()
}

/// The number of checkpoints that were written since the upgrade.
const NEW_CHECKPOINTS: &str = "SELECT count(*) FROM checkpoint WHERE epoch > 1";

#[tokio::test(flavor = "multi_thread")]
async fn a_lab_goes_on_after_an_upgrade_and_after_a_kill_at_each_point_of_its_first_start() {
    let lab = Lab::new().await;
    for point in [
        None,
        Some(Point::Migrating),
        Some(Point::Migrated),
        Some(Point::Resumed),
        Some(Point::Checkpointed),
        Some(Point::Recovered),
    ] {
        let data = tempfile::tempdir().unwrap();
        copy_all(lab.folder.path(), data.path());
        if let Some(point) = point {
            point.kill(data.path()).await;
        }
        println!("{point:?}");
        assert_upgraded(data.path(), &lab, point).await;
    }
}

/// Starts a daemon on `data`, whose first start was killed at `point`, and checks that each part of the lab goes
/// on or says why not.
async fn assert_upgraded(data: &Path, lab: &Lab, point: Option<Point>) {
    let (mut process, client) = start(data).await;
    // A playback ends with its daemon.
    assert!(names(&client).await.iter().eq(lab.statuses.keys()));
    let mut epochs = BTreeMap::new();
    for (name, before) in &lab.statuses {
        let status = client.get(name, "status").await;
        assert_goes_on(lab, name, &status, before);
        epochs.insert(name.clone(), status["epoch"].as_u64().unwrap());
        let entries = journal(&client, name).await;
        let old = lab.journals[name].as_array().unwrap();
        assert_eq!(entries.as_array().unwrap()[..old.len()], old[..], "{name}");
        assert_earlier(get(&client, name, "verify").await, name);
        assert_events(&client, name, point).await;
    }
    assert_remembered(&client, lab).await;
    assert_controller(&client, lab).await;
    assert_still(&client, lab).await;
    assert_moves(&client, lab).await;
    assert_recorded(&client, lab).await;
    assert_experiments(&client, lab).await;
    let lines = audit(&client).await;
    assert!(lab.audit.iter().all(|it| lines.contains(it)), "{lines:?}");
    client.session.close().await.unwrap();
    process.stop();
    assert_eq!(process.end(), Some(0));

    assert_epochs(data, lab, &epochs, point);
    // The next start is as any other.
    let (process, client) = start(data).await;
    for name in lab.statuses.keys() {
        let status = client.get(name, "status").await;
        let expected = match name.as_str() {
            "faulted" => Value::Null,
            name => mark(lab, name),
        };
        assert_eq!(status["result"]["earlier_models"], expected, "{status}");
    }
    drop(process);
    assert_refused(data);
}

/// The mark of a swarm: the version that stored its newest checkpoint.
fn mark(lab: &Lab, name: &str) -> Value {
    let (epoch, step) = lab.checkpoints[name];
    json!([{"model_version": EARLIER, "epoch": epoch, "step": step}])
}

/// Checks a status after the upgrade: of a swarm that stands it is the one before.
fn assert_goes_on(lab: &Lab, name: &str, status: &Value, before: &Value) {
    let (now, then) = (&status["result"], &before["result"]);
    assert_eq!(now["earlier_models"], mark(lab, name), "{status}");
    assert_eq!(then["earlier_models"], Value::Null);
    assert_eq!(status["seq"], before["seq"], "{status}");
    assert_eq!(status["phase"], before["phase"], "{status}");
    assert_eq!(now["until_step"], then["until_step"], "{status}");
    if ["running", "stepping"].contains(&name) {
        // From the step of the last command on.
        let last = lab.journals[name].as_array().unwrap().last().unwrap();
        assert!(status["step"].as_u64() >= last["step"].as_u64(), "{status}");
        for field in ["scheduled", "parameters", "rate"] {
            assert_eq!(now[field], then[field], "{field}: {status}");
        }
    } else {
        assert_eq!(status["step"], before["step"], "{status}");
        for field in SAME {
            assert_eq!(now[field], then[field], "{field}: {status}");
        }
    }
}

/// Checks that no event and no command is there twice, and that the swarm says once that it is marked.
async fn assert_events(client: &Client, name: &str, point: Option<Point>) {
    let events = client.get(name, "events?limit=1000").await;
    let events = events["result"]["events"].as_array().unwrap().clone();
    let numbers: Vec<_> = events.iter().map(|it| it["number"].as_u64()).collect();
    assert!(numbers.is_sorted_by(|a, b| a < b), "{name}: {events:?}");
    let seqs = events.iter().filter_map(|it| it["event"]["seq"].as_u64());
    let seqs: Vec<_> = seqs.collect();
    assert_eq!(
        seqs.iter().collect::<BTreeSet<_>>().len(),
        seqs.len(),
        "{name}: {events:?}"
    );
    let marks = events.iter().filter(|it| it["event"]["kind"] == "model");
    let marks: Vec<_> = marks.map(|it| it["event"].clone()).collect();
    let event = json!({"kind": "model", "from": EARLIER, "to": MODEL_VERSION});
    let was_said = matches!(point, Some(Point::Checkpointed | Point::Recovered));
    assert!(
        marks == [event] || was_said && marks.is_empty(),
        "{name}: {events:?}"
    );
}

/// Checks that each request is known, and not executed again.
async fn assert_remembered(client: &Client, lab: &Lab) {
    for (key, request, reply) in &lab.requests {
        let again = client
            .query(key, Some(request.to_string().as_bytes()))
            .await;
        assert_eq!(again.as_ref(), Ok(reply), "{key} {request}");
    }
    for (name, before) in &lab.statuses {
        let status = client.get(name, "status").await;
        assert_eq!(status["seq"], before["seq"], "{name} executed twice");
    }
}

/// Checks that the controller, which has sent its `join` again, drives its swarm.
async fn assert_controller(client: &Client, lab: &Lab) {
    let controllers = client.get("driven", "controllers").await;
    assert_eq!(controllers["result"], lab.controllers);
    let advance = json!({"expect_step": 10, "args": {"controller": "ada", "steps": 5}});
    assert_eq!(client.ok("driven", "advance", advance).await["step"], 15);
}

/// Checks the swarms that stood.
async fn assert_still(client: &Client, lab: &Lab) {
    for name in ["paused", "copy"] {
        client.ok(name, "step", json!({"steps": 5})).await;
    }
    for verb in ["delete", "reset"] {
        let (code, _) = client.err("protected", verb, json!({})).await;
        assert_eq!(code, ErrorCode::IncorrectState);
    }

    assert!(
        lab.statuses["faulted"]["result"]["fault"].is_object(),
        "{:?}",
        lab.statuses["faulted"]
    );
    let reset = client.ok("faulted", "reset", json!({})).await;
    assert_eq!(
        (&reset["phase"], &reset["step"]),
        (&json!("paused"), &json!(0))
    );
    let status = client.get("faulted", "status").await;
    assert_eq!(status["result"]["earlier_models"], Value::Null, "{status}");

    assert_eq!(lab.statuses["scheduled"]["result"]["scheduled"], 3);
    client.ok("scheduled", "step", json!({"steps": 45})).await;
    let entries = journal(client, "scheduled").await;
    let entries = entries.as_array().unwrap().iter();
    let executed: Vec<_> = entries
        .map(|it| (it["step"].clone(), it["verb"].clone()))
        .collect();
    for at in [(30, "set"), (40, "inform"), (50, "remove")] {
        let at = (json!(at.0), json!(at.1));
        assert_eq!(
            executed.iter().filter(|it| **it == at).count(),
            1,
            "{executed:?}"
        );
    }
    let status = client.get("scheduled", "status").await;
    let result = &status["result"];
    assert_eq!(
        (&result["n"], &result["informed"]),
        (&json!(11), &json!(2)),
        "{status}"
    );

    assert_eq!(
        lab.statuses["waiting"]["result"]["when"],
        json!([when::CONDITION, "order > 1"])
    );
    client.ok("waiting", "run", json!({"rate": null})).await;
    let status = client.get("waiting", "wait?phase=paused").await;
    assert_eq!(status["step"], when::expected_step(), "{status}");
    assert_eq!(status["result"]["reason"], "condition", "{status}");
    assert_eq!(status["result"]["when"], json!(["order > 1"]), "{status}");
}

/// Checks the swarms that moved.
async fn assert_moves(client: &Client, lab: &Lab) {
    // A retry waits for the rest of the steps, which a pause cuts short.
    let (key, request) = &lab.pending;
    let request = request.to_string();
    let retry = async || client.query(key, Some(request.as_bytes())).await.unwrap();
    let paused = async || {
        tokio::time::sleep(Duration::from_millis(50)).await;
        client.ok("stepping", "pause", json!({})).await
    };
    let (reply, paused) = tokio::join!(retry(), paused());
    assert_eq!(reply["step"], paused["step"], "{reply}");
    assert_eq!(
        reply["result"]["steps"], reply["step"],
        "all of both epochs"
    );
    assert_eq!(retry().await, reply);

    let step = client.get("running", "status").await["step"].as_u64();
    until("it runs on", async || {
        client.get("running", "status").await["step"].as_u64() > step
    })
    .await;
    client.ok("running", "pause", json!({})).await;
    client
        .ok("running", "run", json!({"rate": null, "until_step": 1300}))
        .await;
    client.wait_for_step("running", 1300).await;
    let entries = journal(client, "running").await;
    let entries = entries.as_array().unwrap();
    let executed = entries.iter().filter(|it| it["step"] == 1200);
    let executed: Vec<_> = executed.map(|it| &it["verb"]).collect();
    assert_eq!(executed, ["set"]);
}

/// Checks that the recording goes on, and counts what the first kill lost.
async fn assert_recorded(client: &Client, lab: &Lab) {
    assert_eq!(lab.film["phase"], "recording", "{}", lab.film);
    let now = recording::recording_status(client, "film").await;
    assert_eq!(now["phase"], "recording", "{now}");
    client.ok("filmed", "step", json!({"steps": 10})).await;
    let stopped = recording::stop(client, "film").await;
    assert_eq!(stopped["phase"], "ended", "{stopped}");
    // Each fifth from 0 to 60, of which the first part has 0 to 20 and the last one 55 and 60.
    assert_eq!(
        (&stopped["frames"], &stopped["missed"]),
        (&json!(7), &json!(6)),
        "{stopped}"
    );
}

/// Checks that the half-done experiment says why it ends, and that the finished runs are there.
async fn assert_experiments(client: &Client, lab: &Lab) {
    for (name, phase) in [("done", "finished"), ("half", "failed")] {
        let now = progress(client, name).await;
        assert_eq!(
            (&now["phase"], &now["model_version"]),
            (&json!(phase), &json!(EARLIER)),
            "{now}"
        );
        assert_eq!(rows(client, name, 100).await, lab.rows[name], "{name}");
    }
    let half = progress(client, "half").await;
    assert_eq!((&half["finished"], &half["runs"]), (&json!(3), &json!(4)));
    let why = half["message"].as_str().unwrap();
    assert!(why.contains("jostle experiment run --again"), "{why}");
    // One without a finished run begins.
    let next = wait_for_phase(client, "next", "finished").await;
    assert_eq!(next["model_version"], Value::Null, "{next}");
}

/// Checks that each start that recovered a swarm has begun an epoch, and nothing else has.
fn assert_epochs(data: &Path, lab: &Lab, epochs: &BTreeMap<String, u64>, point: Option<Point>) {
    let store = StoreCopy::of(data);
    let mut twice = 0;
    for (name, before) in &lab.statuses {
        let rows = store.rows(name, 0);
        let begun = rows
            .iter()
            .filter_map(|row| match writer::read_record(&row.body).unwrap() {
                Record::Resumed(epoch) => Some(epoch),
                _ => None,
            });
        let begun: Vec<_> = begun.collect();
        let before = before["epoch"].as_u64().unwrap();
        assert!(
            begun.iter().copied().eq(before + 1..=epochs[name]),
            "{name}: {begun:?}"
        );
        twice += begun.len() - 1;
    }
    let all = lab.statuses.len();
    match point {
        None | Some(Point::Migrating | Point::Migrated) => assert_eq!(twice, 0),
        Some(Point::Resumed) => assert!((1..=all).contains(&twice), "{twice}"),
        Some(Point::Checkpointed) => assert_eq!(twice, 1),
        Some(Point::Recovered) => assert_eq!(twice, all),
    }
    let said = log(data)
        .matches("another version of the model goes on")
        .count();
    assert!(said >= all, "{said}");
}
