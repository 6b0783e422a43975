//! Daemons that fail at failpoints: faults, panics, too many queries, a full disk, slow steps.

use std::fs;
use std::time::Instant;

use jostle_proto::{ErrorCode, Reply, Snapshot, keys};
use serde_json::json;

use super::documents::{Document, Recorded};
use super::recording_client::{FIXTURE_NODE, RecordingClient};
use super::swarms::create_crowd;
use crate::commands::{fault_soon, faulting_spec};
use crate::support::{PREFIX, TIMEOUT, until};

pub async fn record_fixtures(recorded: &Recorded) {
    tokio::join!(
        faulted(recorded),
        crossed(recorded),
        defective(recorded),
        busy(recorded),
        full(recorded),
        stuck(recorded),
        slow(recorded),
    );
}

async fn create_school(recorder: &RecordingClient<'_>) {
    let spec = json!({"n": 4, "seed": 1, "start": {"kind": "disc", "radius": 4.0}});
    recorder.create("school", spec).await;
}

async fn faulted(recorded: &Recorded) {
    let recorder = RecordingClient::failing(recorded, "step=33*off->panic").await;
    create_crowd(&recorder, 30).await;
    let events = recorder.subscribe(keys::event(PREFIX, "school")).await;
    create_school(&recorder).await;
    let step = json!({"steps": 10});
    recorder
        .cmd("error.faulted", "school", "step", step.clone())
        .await;
    recorder.event("event.fault", &events, "fault").await;
    recorder
        .get("status.reply.faulted", "school", "status")
        .await;
    recorder.client.err("crowd", "step", step).await;
    recorder
        .get("snapshot.reply.faulted", "crowd", "snapshot")
        .await;
    recorder.stop().await;
}

/// A fault of the model: the bodies of two individuals cross.
async fn crossed(recorded: &Recorded) {
    let recorder = RecordingClient::start_with(recorded, "", &[]).await;
    recorder.create("school", faulting_spec()).await;
    fault_soon(&recorder.client, "school").await;
    recorder
        .get("status.reply.crossed", "school", "status")
        .await;
    recorder.stop().await;
}

async fn defective(recorded: &Recorded) {
    let recorder = RecordingClient::failing(recorded, "command=panic").await;
    create_school(&recorder).await;
    let set = json!({"pi3": 2.0});
    recorder.cmd("error.internal", "school", "set", set).await;
    recorder.stop().await;
}

/// Sends more queries at once than are accepted, to a daemon that is slow to read them.
async fn busy(recorded: &Recorded) {
    let recorder = RecordingClient::failing(recorded, "query=sleep(5)").await;
    let key = keys::node_get(PREFIX, FIXTURE_NODE, "hello");
    let mut sent = Vec::new();
    for _ in 0..300 {
        sent.push(recorder.send(&key, None).await);
    }
    let mut rejected = None;
    for replies in sent {
        let reply = replies.recv_async().await.unwrap();
        if let Err(error) = reply.result() {
            rejected = Some(Document {
                encoding: error.encoding().clone(),
                bytes: error.payload().to_bytes().into_owned(),
            });
        }
    }
    recorder.record_document("error.busy", &rejected.expect("a query is rejected"));
    recorder.stop().await;
}

/// A daemon whose store finds the disk full after a while, with a recording that has failed.
async fn full(recorded: &Recorded) {
    let quota = ["--experiments-quota-mb", "102400"];
    let full = "store-full=40*off->return";
    let recorder = RecordingClient::start_with(recorded, full, &quota).await;
    let spec = json!({"n": 50, "seed": 1});
    recorder.create("school", spec).await;
    recorder
        .create("shoal", json!({"n": 20, "rate": null}))
        .await;
    recorder
        .cmd("", "school", "step", json!({"steps": 100}))
        .await;
    let begin = json!({"begin": {"swarm": "school"}});
    recorder.node_cmd("", "record", begin.clone()).await;
    fs::remove_dir_all(recorder.data.join("recordings/school-1")).unwrap();
    let stop = json!({"stop": {"recording": "school-1"}});
    recorder.node_cmd("", "record", stop).await;
    recorder.node_cmd("", "record", begin).await;
    let run = json!({"until_step": 110, "rate": 2.0});
    recorder.cmd("", "school", "run", run).await;
    recorder.get("", "school", "wait?phase=paused").await;
    let key = keys::cmd(PREFIX, "shoal", "set");
    let set = json!({"noise": 0.0}).to_string();
    until("the disk is full", async || {
        let answer = recorder.client.query(&key, Some(set.as_bytes())).await;
        answer.is_err_and(|error| error.code == ErrorCode::StorageFull)
    })
    .await;
    recorder
        .cmd("error.storage_full", "shoal", "set", json!({"noise": 0.0}))
        .await;
    until("the metrics have it", async || {
        let metrics = recorder.node_get("", "metrics").await;
        let metrics = &metrics["result"];
        metrics["store"]["full"] == true && metrics["swarms"][0]["step"] == 110
    })
    .await;
    recorder.node_get("node.metrics.reply", "metrics").await;
    recorder.stop().await;
}

/// A daemon whose first step does not end.
async fn stuck(recorded: &Recorded) {
    let recorder = RecordingClient::failing(recorded, "step=pause").await;
    create_school(&recorder).await;
    let step = json!({"timeout_secs": 0.1, "args": {"steps": 2}});
    recorder
        .cmd("error.deadline_exceeded", "school", "step", step)
        .await;
    recorder.stop().await;
}

/// A daemon whose every step takes so long that a query comes in between.
async fn slow(recorded: &Recorded) {
    let recorder = RecordingClient::failing(recorded, "step=sleep(700)").await;
    let deadline = Instant::now() + TIMEOUT;
    loop {
        let spec = json!({"n": 6, "seed": 1, "start": {"kind": "disc", "radius": 2.0}});
        recorder.create("crowd", spec).await;
        let step = json!({"client": "ada@lab", "timeout_secs": 60,
            "args": {"steps": 1_000_000_000}});
        let key = keys::cmd(PREFIX, "crowd", "step");
        let _pending = recorder.send(&key, Some(&step)).await;
        recorder.get("", "crowd", "wait?step=1").await;
        let key = keys::get(PREFIX, "crowd", "snapshot");
        let document = recorder.receive("", &recorder.send(&key, None).await).await;
        let reply: Reply<Snapshot> = ciborium::from_reader(&*document.bytes).unwrap();
        if reply.step == 2 {
            recorder.record_document("snapshot.reply.stepping", &document);
            break;
        }
        assert!(Instant::now() < deadline, "each query came too late");
        recorder.cmd("", "crowd", "delete", json!({})).await;
    }
    recorder.stop().await;
}
