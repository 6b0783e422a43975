//! Other specs, a crowd that is kept as a snapshot, histories that are verified, and the errors of
//! requests that cannot be executed.

use std::time::Instant;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{Reply, Snapshot, keys, to_cbor};
use serde_json::{Value, json};

use super::documents::Recorded;
use super::lab::{Lab, args};
use super::story::STANDING;
use crate::crash::life::{self, Life};
use crate::support::{Client, PATIENCE, PREFIX};
use crate::verify::{self, Alteration};

pub async fn play(recorded: &Recorded) {
    let lab = Lab::start(recorded).await;
    for (variant, swarm) in [
        ("metric", "near"),
        ("power", "far"),
        ("topological", "seven"),
        ("voronoi", "tiles"),
    ] {
        let create = args(&format!("create.args.{variant}"));
        lab.node_cmd("", "create", create).await;
        lab.get(&format!("spec.reply.{variant}"), swarm, "spec")
            .await;
    }
    crowd(&lab).await;
    errors(&lab).await;
    verifying(&lab).await;
    lab.stop().await;
    altered(recorded).await;
}

/// A crowd at step 30 with a command that waits for step 100.
pub async fn create_crowd(lab: &Lab<'_>, steps: u64) {
    let spec = json!({"n": 6, "seed": 1, "start": {"kind": "disc", "radius": 2.0}});
    lab.create("crowd", spec).await;
    lab.cmd("", "crowd", "step", json!({"steps": steps})).await;
    let inform = json!({"select": {"ids": [3]}, "direction": 0.5, "weight": 1.5, "for_time": 10.0});
    lab.cmd("", "crowd", "inform", inform).await;
    let later = json!({"request_id": "7c20", "client": "ada@lab", "at_step": 100,
        "args": {"pi3": 1.2}});
    lab.cmd("", "crowd", "set", later).await;
}

async fn crowd(lab: &Lab<'_>) {
    create_crowd(lab, 30).await;
    lab.get("snapshot.reply", "crowd", "snapshot").await;
    let key = keys::get(PREFIX, "crowd", "snapshot");
    let document = lab.receive("", &lab.send(&key, None).await).await;
    let reply: Reply<Snapshot> = ciborium::from_reader(&*document.bytes).unwrap();
    let snapshot = STANDARD.encode(to_cbor(&reply.result));
    let restore = json!({"name": "shoal", "snapshot": snapshot});
    lab.node_cmd("restore.reply", "restore", restore).await;
    let run = json!({"until_step": 90, "rate": STANDING});
    lab.cmd("", "crowd", "run", run).await;
    lab.get("", "crowd", "wait?step=31").await;
    let note = args("annotate.args");
    lab.cmd("annotate.reply", "crowd", "annotate", note).await;
    lab.get("snapshot.reply.running", "crowd", "snapshot").await;
    let step = json!({});
    lab.cmd("error.incorrect_state", "crowd", "step", step)
        .await;
}

async fn errors(lab: &Lab<'_>) {
    let spec = json!({"n": 4, "seed": 1, "start": {"kind": "disc", "radius": 4.0}});
    lab.create("school", spec).await;
    let another = json!({"name": "school", "spec": {"n": 5}});
    lab.node_cmd("error.already_exists", "create", another)
        .await;
    let wrong = json!({"pi1": 33});
    lab.cmd("error.invalid_argument", "school", "set", wrong)
        .await;
    lab.cmd("error.not_found", "school", "jump", json!({}))
        .await;
    lab.cmd("", "school", "step", json!({})).await;
    let elsewhere = json!({"expect_step": 10_000, "args": {}});
    lab.cmd("error.conflict", "school", "pause", elsewhere)
        .await;
    let narrow = json!({"n": 2000, "start": {"kind": "disc", "radius": 10.0}});
    let narrow = json!({"name": "narrow", "spec": narrow});
    lab.node_cmd("error.resource_exhausted", "create", narrow)
        .await;
}

/// A history that leads to what there is, and the status of a swarm whose history is verified.
async fn verifying(lab: &Lab<'_>) {
    lab.cmd("", "school", "step", json!({"steps": 1000})).await;
    lab.get("verify.reply", "school", "verify").await;
    lab.create("long", json!({"n": 20, "seed": 1})).await;
    lab.cmd("", "long", "step", json!({"steps": 5000})).await;
    let status = keys::get(PREFIX, "long", "status");
    let deadline = Instant::now() + PATIENCE;
    loop {
        assert!(Instant::now() < deadline, "no status says it");
        let verify = lab.send(&keys::get(PREFIX, "long", "verify"), None).await;
        let mut is_seen = false;
        while !is_seen && verify.is_empty() {
            let seen = lab.receive("", &lab.send(&status, None).await).await;
            let value: Value = serde_json::from_slice(&seen.bytes).unwrap();
            is_seen = value["result"]["verifying"].is_number();
            if is_seen {
                lab.keep("status.reply.verifying", &seen);
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
    let life = Life::begin(&mut life::daemon(altered.path())).unwrap();
    let client = Client::open(&life.endpoint).await;
    let lab = Lab::of(recorded, life, client, altered);
    lab.get("verify.reply.differs", "a", "verify").await;
    lab.stop().await;
}
