//! Controllers that are late or have left.

use std::time::Duration;

use jostle_proto::{ErrorCode, keys};
use serde_json::json;
use tokio::time::sleep;

use super::{join, token, weights};
use crate::support::{Daemon, PREFIX, until};

#[tokio::test(flavor = "multi_thread")]
async fn a_faulted_swarm_stays_faulted_when_controllers_are_late_or_leave() {
    let daemon = Daemon::start().await;
    let (client, other) = (&daemon.client, daemon.another_client().await);
    // Bodies that turn at a touch, in the longest step: two of them cross within a while.
    let spec = json!({"n": 60, "pi4": 1e6, "dt": 0.2, "seed": 2, "rate": null});
    client.create("a", spec).await;
    let late = json!({"mode": "free_running", "deadline_secs": 1.0, "on_timeout": "pause"});
    let _token = token(&other, "ada").await;
    join(&other, "ada", &[0], late).await;
    client.ok("a", "run", json!({})).await;
    let control = json!({"sequence": 1, "set": {"ids": [0], "direction": [1.0], "weight": [0.1]}});
    let key = keys::ctl(PREFIX, "a", "ada");
    let put = client.session.put(&key, control.to_string());
    put.encoding("application/json").await.unwrap();
    until("a fault", async || {
        let phase = client.get("a", "status").await["phase"].clone();
        if phase == "paused" {
            client.ok("a", "run", json!({})).await;
        }
        phase == "faulted"
    })
    .await;
    let (hash, before) = (client.hash("a").await, weights(client).await);
    other.session.close().await.unwrap();
    sleep(Duration::from_millis(1500)).await;
    let status = client.get("a", "status").await;
    assert_eq!(status["phase"], "faulted");
    assert_eq!(client.hash("a").await, hash);
    assert_eq!(weights(client).await, before);
    let error = client.err("a", "leave", json!({"controller": "ada"})).await;
    assert_eq!(error.0, ErrorCode::IncorrectState);
    daemon.stop().await;
}

/// The steps that a controller requested are dropped when it leaves.
#[tokio::test(flavor = "multi_thread")]
async fn steps_that_only_a_controller_that_left_requested_are_not_taken() {
    let daemon = Daemon::start().await;
    let (client, swarm) = (&daemon.client, "left");
    client.create(swarm, json!({"n": 12})).await;
    client.ok(swarm, "join", json!({"controller": "ada"})).await;
    let far = json!({"timeout_secs": 0.1, "args": {"controller": "ada", "steps": 1_000_000_000}});
    let error = client.err(swarm, "advance", far).await;
    assert_eq!(error.0, ErrorCode::DeadlineExceeded);
    assert_eq!(client.get(swarm, "status").await["phase"], "running");
    let left = json!({"controller": "ada"});
    let left = client.ok(swarm, "leave", left).await;
    assert_eq!(left["phase"], "paused");
    let on = client.ok(swarm, "step", json!({"steps": 3})).await;
    assert_eq!(on["step"], left["step"].as_u64().unwrap() + 3);
    let hash = client.hash(swarm).await;
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    assert_eq!(
        client
            .wait_for_step(swarm, on["step"].as_u64().unwrap())
            .await["phase"],
        "paused"
    );
    assert_eq!(client.hash(swarm).await, hash);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn steps_after_a_missed_deadline_become_durable() {
    let daemon = Daemon::start().await;
    let (client, swarm) = (&daemon.client, "late");
    client.create(swarm, json!({"n": 12})).await;
    for controller in ["ada", "bob"] {
        let options = json!({"controller": controller, "deadline_secs": 0.05});
        client.ok(swarm, "join", options).await;
    }
    let mut durable = Vec::new();
    for step in 1..=2_u64 {
        let reply = client
            .ok(swarm, "advance", json!({"controller": "ada"}))
            .await;
        assert_eq!(reply["step"], step);
        durable.push(reply["result"]["durable_step"].as_u64().unwrap());
        sleep(Duration::from_millis(100)).await;
    }
    assert!(durable[1] >= 1, "{durable:?}");
    daemon.stop().await;
}
