//! Swarms over a limit that was lowered since they were created.

use std::path::Path;

use jostle_proto::ErrorCode;
use serde_json::{Value, json};

use crate::support::Client;
use crate::support::daemon_process::{DaemonProcess, daemon};

/// A daemon on `folder` with this many individuals for each swarm.
async fn start(folder: &Path, limit: usize) -> (DaemonProcess, Client) {
    let mut command = daemon(folder);
    command.arg("--max-individuals").arg(limit.to_string());
    let process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    (process, client)
}

async fn stop(mut process: DaemonProcess, client: Client) {
    client.session.close().await.unwrap();
    process.stop();
    assert_eq!(process.end(), Some(0));
}

async fn n(client: &Client) -> u64 {
    let status = client.get("a", "status").await;
    status["result"]["n"].as_u64().unwrap()
}

async fn memory(client: &Client) -> u64 {
    client.node("status").await["memory_bytes"]
        .as_u64()
        .unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_over_a_lowered_limit_can_be_shrunk_and_reset_and_not_grow() {
    let folder = tempfile::tempdir().unwrap();
    let (process, client) = start(folder.path(), 100).await;
    client.create("a", json!({"n": 60, "seed": 3})).await;
    let begun = client.hash("a").await;
    client.ok("a", "step", json!({"steps": 20})).await;
    stop(process, client).await;

    let (process, client) = start(folder.path(), 20).await;
    assert_eq!(n(&client).await, 60);
    let whole = memory(&client).await;
    let too_many = |(code, message): (ErrorCode, String), n: u64| {
        assert_eq!(code, ErrorCode::ResourceExhausted, "{message}");
        let says = format!("{n} individuals are more than one swarm may have, 20:");
        assert!(message.contains(&says), "{message}");
        assert!(message.contains("max_individuals"), "{message}");
    };
    too_many(client.err("a", "inject", json!({"count": 1})).await, 61);
    // A batch that removes and then fails changes nothing, nor the memory that is reserved.
    let batch = json!({"args": {"commands": [
        {"verb": "remove", "args": {"select": {"count": 10}}},
        {"verb": "inject", "args": {"count": 1}},
    ]}});
    too_many(client.err("a", "batch", batch).await, 51);
    assert_eq!((n(&client).await, memory(&client).await), (60, whole));

    let removed = client
        .ok("a", "remove", json!({"select": {"count": 10}}))
        .await;
    assert_eq!(removed["result"]["n"], 50);
    assert!(memory(&client).await < whole);
    too_many(client.err("a", "inject", json!({"count": 1})).await, 51);
    client.ok("a", "step", json!({"steps": 20})).await;
    client.ok("a", "reset", json!({})).await;
    assert_eq!(
        (n(&client).await, client.hash("a").await),
        (60, begun.clone())
    );
    assert_eq!(memory(&client).await, whole);
    // Below the limit it may grow up to it, and be reset to its start.
    client
        .ok("a", "remove", json!({"select": {"count": 45}}))
        .await;
    client.ok("a", "inject", json!({"count": 5})).await;
    too_many(client.err("a", "inject", json!({"count": 1})).await, 21);
    client.ok("a", "reset", json!({})).await;
    assert_eq!(client.hash("a").await, begun);
    let other = client.ok("a", "reset", json!({"seed": 4})).await;
    assert_ne!(other["result"]["state_hash"], Value::from(begun));
    let verified = client.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null);
    let hash = client.hash("a").await;
    stop(process, client).await;

    // Commands from before are replayed although they exceed the lower limit.
    let (process, client) = start(folder.path(), 1).await;
    assert_eq!((n(&client).await, client.hash("a").await), (60, hash));
    client
        .ok("a", "remove", json!({"select": {"count": 59}}))
        .await;
    assert_eq!(n(&client).await, 1);
    stop(process, client).await;
}
