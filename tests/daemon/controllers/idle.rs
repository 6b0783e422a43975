//! Controllers that hold a swarm and send nothing.

use std::time::Duration;

use jostle_proto::ErrorCode;
use serde_json::{Value, json};
use tokio::time::sleep;

use super::{advance, join, steps_on, token, weights};
use crate::support::{Daemon, until};

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_controller_is_removed_after_max_idle_secs() {
    let daemon = Daemon::start().await;
    let (client, other) = (&daemon.client, &daemon.another_client().await);
    client.create("a", json!({"n": 6})).await;
    join(client, "ada", &[0], json!({"on_timeout": "free"})).await;
    let set = json!({"set": {"ids": [0], "direction": [1.0], "weight": [2.0]}});
    advance(client, "ada", 0, set).await.unwrap();
    // Who holds the swarm, and the remedies.
    for verb in ["run", "step"] {
        let (code, message) = other.err("a", verb, json!({})).await;
        assert_eq!(code, ErrorCode::IncorrectState);
        for part in ["waits for ada", "`jostle leave a ada`", "max_idle_secs"] {
            assert!(message.contains(part), "{message}");
        }
    }
    // By default it may be silent without a limit.
    sleep(Duration::from_millis(1500)).await;
    assert_eq!(client.get("a", "status").await["result"]["controllers"], 1);

    let set = other.ok("a", "set", json!({"max_idle_secs": 1})).await;
    let (before, now) = (&set["result"]["before"], &set["result"]["now"]);
    assert_eq!(before.get("max_idle_secs"), None);
    assert_eq!(now["max_idle_secs"], 1.0);
    until("ada is removed", async || {
        client.get("a", "status").await["result"]["controllers"] == 0
    })
    .await;
    assert_eq!(weights(client).await[0], 0.0);
    let error = advance(client, "ada", 1, json!({})).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::NotFound);
    assert!(error.message.contains("max_idle_secs"), "{}", error.message);
    let journal = client.get("a", "journal").await;
    let entries = journal["result"]["entries"].as_array().unwrap();
    let idle: Vec<_> = entries.iter().filter(|it| it["verb"] == "idle").collect();
    assert_eq!(idle.len(), 1, "{entries:?}");
    assert_eq!(idle[0]["args"], json!({"controller": "ada"}));
    other.ok("a", "step", json!({"steps": 20})).await;

    // A replay needs no clock.
    let hash = client.hash("a").await;
    let verified = client.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null);
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    assert_eq!(client.hash("a").await, hash);
    let status = client.get("a", "status").await;
    assert_eq!(status["result"]["parameters"]["max_idle_secs"], 1.0);
    // Also from its start.
    client
        .ok("a", "fork", json!({"name": "b", "step": 21}))
        .await;
    assert_eq!(client.hash("b").await, hash);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_that_is_silent_after_a_restart_is_removed_too() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 6})).await;
    client.ok("a", "set", json!({"max_idle_secs": 5})).await;
    join(client, "ada", &[0], json!({})).await;
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    let _token = token(client, "ada").await;
    let count = async || client.get("a", "status").await["result"]["controllers"].take();
    assert_eq!(count().await, 1);
    until("ada is removed", async || count().await == 0).await;
    let error = advance(client, "ada", 0, json!({})).await.unwrap_err();
    assert!(error.message.contains("max_idle_secs"), "{}", error.message);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_that_sends_something_in_time_stays() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 6})).await;
    client.ok("a", "set", json!({"max_idle_secs": 2})).await;
    join(client, "ada", &[0], json!({})).await;
    for step in 0..4 {
        sleep(Duration::from_millis(700)).await;
        steps_on(client, "ada", step).await;
    }
    // What is rejected was sent all the same.
    for _ in 0..4 {
        sleep(Duration::from_millis(700)).await;
        let error = advance(client, "ada", 9, json!({})).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::Conflict);
    }
    // Once it waits for others, they hold the swarm.
    join(client, "bob", &[1], json!({"deadline_secs": 60})).await;
    let (reply, ()) = tokio::join!(advance(client, "ada", 4, json!({})), async {
        until("bob is removed", async || {
            let journal = client.get("a", "journal").await;
            let entries = journal["result"]["entries"].as_array().unwrap().clone();
            entries.iter().any(|it| it["verb"] == "idle")
        })
        .await;
    });
    let reply = reply.unwrap();
    assert_eq!(reply["step"], 5);
    let left = json!([{"controller": "bob", "why": "late"}]);
    assert_eq!(reply["result"]["news"]["left"], left);
    // Without a limit again.
    client.ok("a", "set", json!({"max_idle_secs": 0})).await;
    sleep(Duration::from_millis(2500)).await;
    assert_eq!(client.get("a", "status").await["result"]["controllers"], 1);
    for invalid in [-1.0, 1.1e6, 1e-300, 0.099] {
        let set = json!({"verb": "set", "args": {"max_idle_secs": invalid}});
        let when = json!({"condition": "order > 0.5", "commands": [set.clone()]});
        for (verb, args) in [
            ("set", set["args"].clone()),
            ("batch", json!({"commands": [set]})),
            ("when", when),
        ] {
            let error = client.cmd("a", verb, args).await.unwrap_err();
            assert_eq!(error.code, ErrorCode::InvalidArgument, "{verb}: {error:?}");
            assert!(error.message.contains("max_idle_secs"), "{verb}: {error:?}");
            let range = "0 for no limit, or a number from 0.1 to 1e6";
            assert_eq!(error.details["range"], range, "{verb}: {error:?}");
        }
    }
    for accepted in [0.1, 0.0] {
        let set = json!({"max_idle_secs": accepted});
        client.ok("a", "set", set).await;
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reset_and_a_fork_keep_max_idle_secs() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 4})).await;
    client
        .ok("a", "set", json!({"max_idle_secs": 5, "pi3": 2}))
        .await;
    client.ok("a", "step", json!({"steps": 3})).await;
    client.ok("a", "reset", json!({})).await;
    client.ok("a", "fork", json!({"name": "b"})).await;
    for swarm in ["a", "b"] {
        let status = client.get(swarm, "status").await;
        let parameters = &status["result"]["parameters"];
        assert_eq!(parameters["max_idle_secs"], 5.0, "{swarm}: {parameters}");
        // What the model has is as at the start.
        assert_eq!(parameters["pi3"], 1.0, "{swarm}: {parameters}");
    }
    daemon.stop().await;
}
