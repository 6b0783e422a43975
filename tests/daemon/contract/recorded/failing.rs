//! Daemons that fail at named points: faults, defects, too many queries, a full disk, slow steps.

use std::fs;
use std::time::Instant;

use jostle_proto::{ErrorCode, Reply, Snapshot, keys};
use serde_json::json;

use super::documents::{Document, Recorded};
use super::lab::{LAB, Lab};
use super::swarms::create_crowd;
use crate::support::{PATIENCE, PREFIX, until};

pub async fn play(recorded: &Recorded) {
    tokio::join!(
        faulted(recorded),
        defective(recorded),
        busy(recorded),
        full(recorded),
        stuck(recorded),
        slow(recorded),
    );
}

async fn create_school(lab: &Lab<'_>) {
    let spec = json!({"n": 4, "seed": 1, "start": {"kind": "disc", "radius": 4.0}});
    lab.create("school", spec).await;
}

async fn faulted(recorded: &Recorded) {
    let lab = Lab::failing(recorded, "step=33*off->panic").await;
    create_crowd(&lab, 30).await;
    let events = lab.subscribe(keys::event(PREFIX, "school")).await;
    create_school(&lab).await;
    let step = json!({"steps": 10});
    lab.cmd("error.faulted", "school", "step", step.clone())
        .await;
    lab.event("event.fault", &events, "fault").await;
    lab.get("status.reply.faulted", "school", "status").await;
    lab.client.err("crowd", "step", step).await;
    lab.get("snapshot.reply.faulted", "crowd", "snapshot").await;
    lab.stop().await;
}

async fn defective(recorded: &Recorded) {
    let lab = Lab::failing(recorded, "command=panic").await;
    create_school(&lab).await;
    let set = json!({"pi3": 2.0});
    lab.cmd("error.internal", "school", "set", set).await;
    lab.stop().await;
}

/// More queries at once than are taken, from a daemon that is slow to read them.
async fn busy(recorded: &Recorded) {
    let lab = Lab::failing(recorded, "query=sleep(5)").await;
    let key = keys::node_get(PREFIX, LAB, "hello");
    let mut sent = Vec::new();
    for _ in 0..300 {
        sent.push(lab.send(&key, None).await);
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
    lab.keep("error.busy", &rejected.expect("a query is rejected"));
    lab.stop().await;
}

/// A daemon whose store finds the disk full after a while, with a recording that has failed.
async fn full(recorded: &Recorded) {
    let lab = Lab::failing(recorded, "store-full=40*off->return").await;
    let spec = json!({"n": 50, "seed": 1});
    lab.create("school", spec).await;
    lab.create("shoal", json!({"n": 20, "rate": null})).await;
    lab.cmd("", "school", "step", json!({"steps": 100})).await;
    let begin = json!({"begin": {"swarm": "school"}});
    lab.node_cmd("", "record", begin.clone()).await;
    fs::remove_dir_all(lab.data.join("recordings/school-1")).unwrap();
    let stop = json!({"stop": {"recording": "school-1"}});
    lab.node_cmd("", "record", stop).await;
    lab.node_cmd("", "record", begin).await;
    let run = json!({"until_step": 110, "rate": 2.0});
    lab.cmd("", "school", "run", run).await;
    lab.get("", "school", "wait?phase=paused").await;
    let key = keys::cmd(PREFIX, "shoal", "set");
    let set = json!({"noise": 0.0}).to_string();
    until("the disk is full", async || {
        let answer = lab.client.one(&key, Some(set.as_bytes())).await;
        answer.is_err_and(|error| error.code == ErrorCode::StorageFull)
    })
    .await;
    lab.cmd("error.storage_full", "shoal", "set", json!({"noise": 0.0}))
        .await;
    until("the metrics have it", async || {
        let metrics = lab.node_get("", "metrics").await;
        let metrics = &metrics["result"];
        // Sessions are counted once a second.
        let is_counted = metrics["sessions"] == 1;
        metrics["store"]["full"] == true && metrics["swarms"][0]["step"] == 110 && is_counted
    })
    .await;
    lab.node_get("node.metrics.reply", "metrics").await;
    lab.stop().await;
}

/// A daemon whose first step does not end.
async fn stuck(recorded: &Recorded) {
    let lab = Lab::failing(recorded, "step=pause").await;
    create_school(&lab).await;
    let step = json!({"timeout_secs": 0.1, "args": {"steps": 2}});
    lab.cmd("error.deadline_exceeded", "school", "step", step)
        .await;
    lab.stop().await;
}

/// A daemon whose every step takes so long that a query comes in between.
async fn slow(recorded: &Recorded) {
    let lab = Lab::failing(recorded, "step=sleep(700)").await;
    let deadline = Instant::now() + PATIENCE;
    loop {
        let spec = json!({"n": 6, "seed": 1, "start": {"kind": "disc", "radius": 2.0}});
        lab.create("crowd", spec).await;
        let step = json!({"client": "ada@lab", "timeout_secs": 60,
            "args": {"steps": 1_000_000_000}});
        let key = keys::cmd(PREFIX, "crowd", "step");
        let _pending = lab.send(&key, Some(&step)).await;
        lab.get("", "crowd", "wait?step=1").await;
        let key = keys::get(PREFIX, "crowd", "snapshot");
        let document = lab.receive("", &lab.send(&key, None).await).await;
        let reply: Reply<Snapshot> = ciborium::from_reader(&*document.bytes).unwrap();
        if reply.step == 2 {
            lab.keep("snapshot.reply.stepping", &document);
            break;
        }
        assert!(Instant::now() < deadline, "each query came too late");
        lab.cmd("", "crowd", "delete", json!({})).await;
    }
    lab.stop().await;
}
