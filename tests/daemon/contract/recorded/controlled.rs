//! Controllers in lock-step, that leave or are late, and the individuals that they steer.

use jostle_proto::{Attachment, keys};
use serde_json::{Value, json};
use zenoh::bytes::Encoding;

use super::documents::{Document, Recorded};
use super::recording_client::{RecordingClient, args};
use crate::support::{Client, PREFIX, TIMEOUT, until};

/// A deadline that does not pass.
const DEADLINE_SECS: f64 = 60.0;

pub async fn record_fixtures(recorded: &Recorded) {
    let recorder = RecordingClient::start(recorded).await;
    waited_for(&recorder).await;
    late(&recorder).await;
    steered(&recorder).await;
    steered_freely(&recorder).await;
    recorder.stop().await;
}

/// Arguments of a fixture, with another deadline.
fn options(fixture: &str, deadline_secs: f64) -> Value {
    let mut options = args(fixture);
    options["deadline_secs"] = json!(deadline_secs);
    options
}

async fn join(recorder: &RecordingClient<'_>, reply: &str, swarm: &str, options: Value) {
    recorder.cmd(reply, swarm, "join", options).await;
}

/// Waits until a swarm waits for a controller.
async fn wait_for_controller(recorder: &RecordingClient<'_>, swarm: &str, controller: &str) {
    until("the controller is awaited", async || {
        let status = recorder.get("", swarm, "status").await;
        status["result"]["waiting_for"][0]["controller"] == controller
    })
    .await;
}

fn advance(controller: &str, more: Value) -> Value {
    let mut args = more;
    args["controller"] = json!(controller);
    json!({"timeout_secs": DEADLINE_SECS, "args": args})
}

async fn waited_for(recorder: &RecordingClient<'_>) {
    let spec = json!({"n": 4, "seed": 1, "start": {"kind": "disc", "radius": 4.0}});
    recorder.create("school", spec).await;
    let ada = options("join.args", DEADLINE_SECS);
    join(recorder, "join.reply", "school", ada).await;
    let mut bob = options("join.args.free_running", DEADLINE_SECS);
    bob["select"] = json!({"count": 1});
    bob["again"] = json!(false);
    join(recorder, "", "school", bob).await;
    let eve = options("join.args.pause", DEADLINE_SECS);
    join(recorder, "", "school", eve).await;
    // Its epoch does not exist.
    let stale = json!({"sequence": 1, "epoch": 7, "set": {"ids": [0], "direction": [1.0],
        "weight": [1.0]}});
    let put = recorder
        .client
        .session
        .put(keys::ctl(PREFIX, "school", "bob"), stale.to_string());
    put.encoding("application/json").await.unwrap();
    let key = keys::cmd(PREFIX, "school", "advance");
    let first = advance("ada", json!({}));
    let pending = recorder.send(&key, Some(&first)).await;
    wait_for_controller(recorder, "school", "eve").await;
    until("the put has come", async || {
        let controllers = recorder.get("", "school", "controllers").await;
        controllers["result"]["controllers"][1]["puts"]["stale"] == 1
    })
    .await;
    recorder.get("status.reply", "school", "status").await;
    recorder
        .get("controllers.reply", "school", "controllers")
        .await;
    let eve = advance("eve", json!({"return": "state"}));
    recorder
        .cmd("advance.reply.state", "school", "advance", eve)
        .await;
    recorder.record_reply("", &pending).await;
}

async fn late(recorder: &RecordingClient<'_>) {
    let cyd = json!({"controller": "cyd", "deadline_secs": 0.1, "on_timeout": "hold"});
    join(recorder, "", "school", cyd).await;
    let other = Client::open(&recorder.endpoint).await;
    let token = keys::ctl_alive(PREFIX, "school", "dan");
    let token = other.session.liveliness().declare_token(token).await;
    let dan = json!({"controller": "dan", "deadline_secs": DEADLINE_SECS}).to_string();
    let key = keys::cmd(PREFIX, "school", "join");
    other.query(&key, Some(dan.as_bytes())).await.unwrap();
    let remove = json!({"select": {"ids": [2]}});
    recorder.cmd("", "school", "remove", remove).await;
    let eve = json!({"controller": "eve"});
    recorder.cmd("", "school", "leave", eve).await;
    drop(token);
    other.session.close().await.unwrap();
    until("dan has left", async || {
        let status = recorder.get("", "school", "status").await;
        status["result"]["controllers"] == 3
    })
    .await;
    let again = json!({"controller": "ada", "deadline_secs": DEADLINE_SECS, "again": true});
    join(recorder, "join.reply.again", "school", again).await;
    // After three missed deadlines cyd has left.
    for (reply, steps) in [("", 1), ("", 1), ("advance.reply", 10)] {
        let advance = advance("ada", json!({"steps": steps}));
        recorder.cmd(reply, "school", "advance", advance).await;
    }
    recorder
        .cmd("leave.reply", "school", "leave", args("leave.args"))
        .await;
}

/// A snapshot with controllers, one of which joined with `driving`.
async fn steered(recorder: &RecordingClient<'_>) {
    let spec = json!({"n": 6, "seed": 1, "start": {"kind": "disc", "radius": 2.0}});
    recorder.create("crowd", spec).await;
    let mut ada = options("join.args", DEADLINE_SECS);
    ada["driving"] = json!(true);
    join(recorder, "", "crowd", ada).await;
    let eve = options("join.args.pause", DEADLINE_SECS);
    join(recorder, "", "crowd", eve).await;
    let idle = args("set.args.max_idle");
    recorder
        .cmd("set.reply.max_idle", "crowd", "set", idle)
        .await;
    let set = json!({"ids": [1, 2], "direction": [0.5, -1.0], "weight": [0.75, 0.0],
        "turn": [0.5, null], "speed": [null, 0.25]});
    let mut request = advance("ada", json!({"set": set}));
    request["client"] = json!("ada@lab");
    request["request_id"] = json!("7c22");
    let key = keys::cmd(PREFIX, "crowd", "advance");
    let pending = recorder.send(&key, Some(&request)).await;
    wait_for_controller(recorder, "crowd", "eve").await;
    recorder
        .get("snapshot.reply.controllers", "crowd", "snapshot")
        .await;
    let eve = advance("eve", json!({}));
    recorder.cmd("", "crowd", "advance", eve).await;
    recorder.record_reply("", &pending).await;
    let noun = "experiment?setpoints=crowd.csv";
    recorder
        .get("experiment.file.reply.setpoints", "crowd", noun)
        .await;
}

/// What is attached to a state with the set-points of a controller.
async fn steered_freely(recorder: &RecordingClient<'_>) {
    let spec = json!({"n": 4, "seed": 1, "rate": 1, "publish_every": 1});
    recorder.create("herd", spec).await;
    let states = recorder.subscribe(keys::state(PREFIX, "herd")).await;
    let mut bob = options("join.args.free_running", DEADLINE_SECS);
    bob["select"] = json!({"ids": [0]});
    bob["again"] = json!(false);
    join(recorder, "", "herd", bob).await;
    recorder.cmd("", "herd", "run", json!({})).await;
    let set = json!({"sequence": 41, "set": {"ids": [0], "direction": [1.0], "weight": [1.0]}});
    let key = keys::ctl(PREFIX, "herd", "bob");
    let put = recorder.client.session.put(key, set.to_string());
    put.encoding("application/json").await.unwrap();
    loop {
        let sample = tokio::time::timeout(TIMEOUT, states.recv_async()).await;
        let sample = sample.expect("a state is published").unwrap();
        let bytes = sample.attachment().unwrap().to_bytes().into_owned();
        let attachment = Attachment::from_cbor(&bytes).unwrap();
        if !attachment.sequences.is_empty() {
            let encoding = Encoding::APPLICATION_CBOR;
            recorder.record_document("attachment", &Document { encoding, bytes });
            break;
        }
    }
    recorder.cmd("", "herd", "delete", json!({})).await;
}
