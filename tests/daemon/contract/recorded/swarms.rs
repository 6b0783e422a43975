//! Other specs, a snapshot of a crowd, histories that are verified, and the errors of
//! requests that cannot be executed.

use std::time::Instant;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{Reply, Snapshot, keys, to_cbor};
use serde_json::{Value, json};

use super::documents::Recorded;
use super::lifecycle::STANDING;
use super::recording_client::{RecordingClient, args};
use crate::support::daemon_process::{self, DaemonProcess};
use crate::support::{Client, PREFIX, TIMEOUT, until};
use crate::verify::{self, Alteration};

pub async fn record_fixtures(recorded: &Recorded) {
    let recorder = RecordingClient::start(recorded).await;
    for (variant, swarm) in [
        ("metric", "near"),
        ("power", "far"),
        ("topological", "seven"),
        ("voronoi", "tiles"),
    ] {
        let create = args(&format!("create.args.{variant}"));
        recorder.node_cmd("", "create", create).await;
        recorder
            .get(&format!("spec.reply.{variant}"), swarm, "spec")
            .await;
    }
    crowd(&recorder).await;
    costly(&recorder).await;
    errors(&recorder).await;
    verifying(&recorder).await;
    recorder.stop().await;
    altered(recorded).await;
}

/// A crowd at step 30 with a command that waits for step 100.
pub async fn create_crowd(recorder: &RecordingClient<'_>, steps: u64) {
    let spec = json!({"n": 6, "seed": 1, "start": {"kind": "disc", "radius": 2.0},
        "measures": ["drift", "clusters.largest"]});
    recorder.create("crowd", spec).await;
    recorder
        .cmd("", "crowd", "step", json!({"steps": steps}))
        .await;
    let inform = json!({"select": {"ids": [3]}, "direction": 0.5, "weight": 1.5, "for_time": 10.0});
    recorder.cmd("", "crowd", "inform", inform).await;
    let later = json!({"request_id": "7c20", "client": "ada@lab", "at_step": 100,
        "args": {"pi3": 1.2}});
    recorder.cmd("", "crowd", "set", later).await;
}

async fn crowd(recorder: &RecordingClient<'_>) {
    create_crowd(recorder, 30).await;
    let protocol = args("batch.args.protocol");
    recorder.cmd("", "crowd", "batch", protocol).await;
    // A condition that needs the states of earlier steps.
    let moved = json!({"condition": "msd(0.1) > 1e6", "event": "moved"});
    recorder.cmd("", "crowd", "when", moved).await;
    recorder.cmd("", "crowd", "step", json!({"steps": 2})).await;
    let holds = json!({"condition": "order > 0", "event": "ordered", "from_step": 0});
    recorder
        .cmd("when.reply.holds", "crowd", "when", holds)
        .await;
    recorder.get("snapshot.reply", "crowd", "snapshot").await;
    protected(recorder).await;
    let snapshot = snapshot_of(recorder, "crowd").await;
    let snapshot = STANDARD.encode(to_cbor(&snapshot));
    let restore = json!({"name": "shoal", "snapshot": snapshot});
    recorder.node_cmd("restore.reply", "restore", restore).await;
    let run = json!({"until_step": 90, "rate": STANDING});
    recorder.cmd("", "crowd", "run", run).await;
    recorder.get("", "crowd", "wait?step=33").await;
    let note = args("annotate.args");
    recorder
        .cmd("annotate.reply", "crowd", "annotate", note)
        .await;
    recorder
        .cmd("when.reply", "crowd", "when", args("when.args"))
        .await;
    let token = keys::wait_alive(PREFIX, "crowd", "w1");
    let liveliness = recorder.client.session.liveliness();
    let token = liveliness.declare_token(token).await.unwrap();
    let selector = keys::get(PREFIX, "crowd", "wait?condition=order > 1;id=w1");
    let _pending = recorder.send(&selector, None).await;
    until("a client waits", async || {
        let status = recorder.get("", "crowd", "status").await;
        !status["result"]["waits"].is_null()
    })
    .await;
    let commands = json!([{"verb": "set", "args": {"pi3": 1.1}}]);
    let changes = json!({"condition": "order > 0.999", "commands": commands});
    recorder.cmd("", "crowd", "when", changes).await;
    recorder.get("status.reply.when", "crowd", "status").await;
    token.undeclare().await.unwrap();
    recorder
        .get("snapshot.reply.running", "crowd", "snapshot")
        .await;
    let step = json!({});
    recorder
        .cmd("error.incorrect_state", "crowd", "step", step)
        .await;
}

/// A fork of the crowd that is protected, while it is.
async fn protected(recorder: &RecordingClient<'_>) {
    recorder
        .cmd("", "crowd", "fork", json!({"name": "kept"}))
        .await;
    let protect = args("protect.args");
    recorder
        .cmd("protect.reply", "kept", "protect", protect)
        .await;
    recorder
        .get("status.reply.protected", "kept", "status")
        .await;
    recorder
        .get("snapshot.reply.protected", "kept", "snapshot")
        .await;
    recorder
        .node_get("node.swarms.reply.protected", "swarms")
        .await;
    let off = json!({"on": false});
    recorder.cmd("", "kept", "protect", off).await;
    recorder.cmd("", "kept", "delete", json!({})).await;
}

async fn snapshot_of(recorder: &RecordingClient<'_>, swarm: &str) -> Snapshot {
    let key = keys::get(PREFIX, swarm, "snapshot");
    let document = recorder.receive("", &recorder.send(&key, None).await).await;
    let reply: Reply<Snapshot> = ciborium::from_reader(&*document.bytes).unwrap();
    reply.result
}

/// More conditions than are evaluated, as an earlier version stored them.
async fn costly(recorder: &RecordingClient<'_>) {
    let spec = json!({"n": 20, "seed": 1, "start": {"kind": "disc", "radius": 5.0}});
    recorder.create("dense", spec).await;
    let condition = json!({"condition": "clusters.count(0.01) > 99", "pause": true});
    recorder.cmd("", "dense", "when", condition).await;
    let mut snapshot = snapshot_of(recorder, "dense").await;
    let mut another = snapshot.when[0].clone();
    another.sent.args = another.sent.args.replace("0.01", "0.02");
    snapshot.when.push(another);
    let snapshot = STANDARD.encode(to_cbor(&snapshot.sealed()));
    let restore = json!({"name": "costly", "snapshot": snapshot});
    recorder.node_cmd("", "restore", restore).await;
    recorder
        .get("status.reply.costly", "costly", "status")
        .await;
}

async fn errors(recorder: &RecordingClient<'_>) {
    let spec = json!({"n": 4, "seed": 1, "start": {"kind": "disc", "radius": 4.0}});
    recorder.create("school", spec).await;
    let another = json!({"name": "school", "spec": {"n": 5}});
    recorder
        .node_cmd("error.already_exists", "create", another)
        .await;
    let wrong = json!({"pi1": 33});
    recorder
        .cmd("error.invalid_argument", "school", "set", wrong)
        .await;
    recorder
        .cmd("error.not_found", "school", "jump", json!({}))
        .await;
    recorder.cmd("", "school", "step", json!({})).await;
    let elsewhere = json!({"expect_step": 10_000, "args": {}});
    recorder
        .cmd("error.conflict", "school", "pause", elsewhere)
        .await;
    let narrow = json!({"n": 2000, "start": {"kind": "disc", "radius": 10.0}});
    let narrow = json!({"name": "narrow", "spec": narrow});
    recorder
        .node_cmd("error.resource_exhausted", "create", narrow)
        .await;
}

/// A history that `verify` confirms, and the status of a swarm while its history is verified.
async fn verifying(recorder: &RecordingClient<'_>) {
    recorder
        .cmd("", "school", "step", json!({"steps": 1000}))
        .await;
    recorder.get("verify.reply", "school", "verify").await;
    recorder
        .get("experiment.file.reply", "school", "experiment")
        .await;
    recorder.create("long", json!({"n": 20, "seed": 1})).await;
    recorder
        .cmd("", "long", "step", json!({"steps": 5000}))
        .await;
    let status = keys::get(PREFIX, "long", "status");
    let deadline = Instant::now() + TIMEOUT;
    loop {
        assert!(Instant::now() < deadline, "no status says it");
        let verify = recorder
            .send(&keys::get(PREFIX, "long", "verify"), None)
            .await;
        let mut is_seen = false;
        while !is_seen && verify.is_empty() {
            let seen = recorder
                .receive("", &recorder.send(&status, None).await)
                .await;
            let value: Value = serde_json::from_slice(&seen.bytes).unwrap();
            is_seen = value["result"]["verifying"].is_number();
            if is_seen {
                recorder.record_document("status.reply.verifying", &seen);
            }
        }
        verify.recv_async().await.unwrap();
        if is_seen {
            return;
        }
    }
}

/// A history of which a hash was altered on the disk.
async fn altered(recorded: &Recorded) {
    let folder = tempfile::tempdir().unwrap();
    verify::fill(folder.path()).await;
    let altered = verify::altered(folder.path(), Alteration::Hash(1, 1000), true);
    let process = DaemonProcess::start(&mut daemon_process::daemon(altered.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    let recorder = RecordingClient::with_daemon(recorded, process, client, altered);
    recorder.get("verify.reply.differs", "a", "verify").await;
    recorder.stop().await;
}
