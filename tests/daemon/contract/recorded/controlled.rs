//! Controllers: those that a swarm waits for, those that leave or are late, and what they steer.

use jostle_proto::keys;
use serde_json::{Value, json};

use super::documents::Recorded;
use super::lab::{Lab, args};
use crate::support::{Client, PREFIX, until};

/// A deadline that does not pass.
const DEADLINE_SECS: f64 = 60.0;

pub async fn play(recorded: &Recorded) {
    let lab = Lab::start(recorded).await;
    waited_for(&lab).await;
    late(&lab).await;
    steered(&lab).await;
    lab.stop().await;
}

/// Arguments of a fixture, with another deadline.
fn options(fixture: &str, deadline_secs: f64) -> Value {
    let mut options = args(fixture);
    options["deadline_secs"] = json!(deadline_secs);
    options
}

async fn join(lab: &Lab<'_>, reply: &str, swarm: &str, options: Value) {
    lab.cmd(reply, swarm, "join", options).await;
}

/// Waits until a swarm waits for a controller.
async fn awaits(lab: &Lab<'_>, swarm: &str, controller: &str) {
    until("the controller is awaited", async || {
        let status = lab.get("", swarm, "status").await;
        status["result"]["waiting_for"][0]["controller"] == controller
    })
    .await;
}

fn advance(controller: &str, more: Value) -> Value {
    let mut args = more;
    args["controller"] = json!(controller);
    json!({"timeout_secs": DEADLINE_SECS, "args": args})
}

async fn waited_for(lab: &Lab<'_>) {
    let spec = json!({"n": 4, "seed": 1, "start": {"kind": "disc", "radius": 4.0}});
    lab.create("school", spec).await;
    let ada = options("join.args", DEADLINE_SECS);
    join(lab, "join.reply", "school", ada).await;
    let mut bob = options("join.args.free_running", DEADLINE_SECS);
    bob["select"] = json!({"count": 1});
    bob["again"] = json!(false);
    join(lab, "", "school", bob).await;
    let eve = options("join.args.pause", DEADLINE_SECS);
    join(lab, "", "school", eve).await;
    // It is of no epoch that there is.
    let stale = json!({"sequence": 1, "epoch": 7, "set": {"ids": [0], "direction": [1.0],
        "weight": [1.0]}});
    let put = lab
        .client
        .session
        .put(keys::ctl(PREFIX, "school", "bob"), stale.to_string());
    put.encoding("application/json").await.unwrap();
    let key = keys::cmd(PREFIX, "school", "advance");
    let first = advance("ada", json!({}));
    let pending = lab.send(&key, Some(&first)).await;
    awaits(lab, "school", "eve").await;
    until("the put has come", async || {
        let controllers = lab.get("", "school", "controllers").await;
        controllers["result"]["controllers"][1]["puts"]["stale"] == 1
    })
    .await;
    lab.get("status.reply", "school", "status").await;
    lab.get("controllers.reply", "school", "controllers").await;
    let eve = advance("eve", json!({"return": "state"}));
    lab.cmd("advance.reply.state", "school", "advance", eve)
        .await;
    lab.take("", &pending).await;
}

async fn late(lab: &Lab<'_>) {
    let cyd = json!({"controller": "cyd", "deadline_secs": 0.1, "on_timeout": "hold"});
    join(lab, "", "school", cyd).await;
    let other = Client::open(&lab.endpoint).await;
    let token = keys::ctl_alive(PREFIX, "school", "dan");
    let token = other.session.liveliness().declare_token(token).await;
    let dan = json!({"controller": "dan", "deadline_secs": DEADLINE_SECS}).to_string();
    let key = keys::cmd(PREFIX, "school", "join");
    other.one(&key, Some(dan.as_bytes())).await.unwrap();
    let remove = json!({"select": {"ids": [2]}});
    lab.cmd("", "school", "remove", remove).await;
    let eve = json!({"controller": "eve"});
    lab.cmd("", "school", "leave", eve).await;
    drop(token);
    other.session.close().await.unwrap();
    until("dan has left", async || {
        let status = lab.get("", "school", "status").await;
        status["result"]["controllers"] == 3
    })
    .await;
    let again = json!({"controller": "ada", "deadline_secs": DEADLINE_SECS, "again": true});
    join(lab, "join.reply.again", "school", again).await;
    // After three missed deadlines cyd has left.
    for (reply, steps) in [("", 1), ("", 1), ("advance.reply", 10)] {
        let advance = advance("ada", json!({"steps": steps}));
        lab.cmd(reply, "school", "advance", advance).await;
    }
    lab.cmd("leave.reply", "school", "leave", args("leave.args"))
        .await;
}

/// A snapshot with controllers, of which one drives.
async fn steered(lab: &Lab<'_>) {
    let spec = json!({"n": 6, "seed": 1, "start": {"kind": "disc", "radius": 2.0}});
    lab.create("crowd", spec).await;
    let mut ada = options("join.args", DEADLINE_SECS);
    ada["driving"] = json!(true);
    join(lab, "", "crowd", ada).await;
    let eve = options("join.args.pause", DEADLINE_SECS);
    join(lab, "", "crowd", eve).await;
    let set = json!({"ids": [1, 2], "direction": [0.5, -1.0], "weight": [0.75, 0.0],
        "turn": [0.5, null], "speed": [null, 0.25]});
    let mut request = advance("ada", json!({"set": set}));
    request["client"] = json!("ada@lab");
    request["request_id"] = json!("7c22");
    let key = keys::cmd(PREFIX, "crowd", "advance");
    let pending = lab.send(&key, Some(&request)).await;
    awaits(lab, "crowd", "eve").await;
    lab.get("snapshot.reply.controllers", "crowd", "snapshot")
        .await;
    let eve = advance("eve", json!({}));
    lab.cmd("", "crowd", "advance", eve).await;
    lab.take("", &pending).await;
}
