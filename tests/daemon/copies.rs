//! Forks, snapshots and replays of a history.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{ErrorCode, Reply, Snapshot, keys};
use serde_json::{Value, json};

use crate::support::daemon_process;
use crate::support::{Client, Daemon, NODE, PREFIX, QueryResult};

/// A group of the paper's size, in contact.
async fn create_in_contact(client: &Client, name: &str, n: u64) {
    client
        .create(name, json!({"n": n, "seed": 5, "pi1": 4, "rate": null}))
        .await;
    client.ok(name, "step", json!({"steps": 1500})).await;
}

async fn snapshot(client: &Client, swarm: &str) -> Vec<u8> {
    let key = keys::get(PREFIX, swarm, "snapshot");
    let replies = client.session.get(key).await.unwrap();
    let sample = replies.recv_async().await.unwrap().into_result().unwrap();
    let reply: Reply<Snapshot> = ciborium::from_reader(&*sample.payload().to_bytes()).unwrap();
    jostle_proto::to_cbor(&reply.result)
}

async fn restore(client: &Client, name: &str, snapshot: &[u8]) -> QueryResult {
    let request = json!({"name": name, "snapshot": STANDARD.encode(snapshot)});
    let key = keys::node_cmd(PREFIX, NODE, "restore");
    client
        .query(&key, Some(request.to_string().as_bytes()))
        .await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fork_has_the_same_future_until_it_gets_other_commands() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create_in_contact(client, "a", 74).await;
    // The present state of a running swarm, too.
    client.ok("a", "run", json!({"rate": null})).await;
    let forked = client.ok("a", "fork", json!({"name": "b"})).await;
    let step = forked["step"].as_u64().unwrap();
    assert!(step >= 1500);
    assert_eq!(forked["phase"], "paused");
    assert_eq!(
        client.get("b", "status").await["result"]["reason"],
        "forked"
    );
    let informed = json!({"select": {"ids": [3, 30, 50]}, "direction": 1.0});
    let later = step + 20_000;
    let scheduled = json!({"at_step": later, "args": informed});
    client.ok("a", "inform", scheduled).await;
    let a = client.hash_at("a", later + 200).await;
    // The same command at the same step.
    let b = client.hash_at("b", later).await;
    client.ok("b", "inform", informed).await;
    assert_eq!(client.hash_at("b", later + 200).await, a);

    // As it was at an earlier step, with its scheduled commands.
    for (name, at) in [("c", later), ("d", later - 100), ("e", later + 100)] {
        let fork = json!({"timeout_secs": 60, "args": {"name": name, "step": at}});
        let forked = client.ok("a", "fork", fork).await;
        assert_eq!(forked["step"], at);
        assert_eq!(client.hash_at(name, later + 200).await, a, "{name}");
        if name == "c" {
            assert_ne!(forked["result"]["state_hash"], b.as_str());
        }
    }
    client
        .ok("c", "uninform", json!({"select": {"ids": [3]}}))
        .await;
    assert_ne!(
        client.hash_at("c", later + 400).await,
        client.hash_at("a", later + 400).await
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_if_they_had_not_been_informed() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create_in_contact(client, "a", 30).await;
    let arrived = client.hash("a").await;
    let informed = json!({"select": {"count": 3}, "direction": 0.5});
    let ids = client.ok("a", "inform", informed.clone()).await;
    // This start stores a checkpoint of step 1500 that contains the command.
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    client.ok("a", "step", json!({"steps": 700})).await;

    // As it reached the step, before the `inform`; also after a restart of the daemon.
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    for name in ["b", "c"] {
        let forked = client
            .ok("a", "fork", json!({"name": name, "step": 1500}))
            .await;
        assert_eq!(forked["result"]["state_hash"], arrived.as_str());
        assert_eq!(forked["step"], 1500);
    }
    // At a step within one `step` command, too.
    let midway = json!({"name": "midway", "step": 700});
    assert_eq!(client.ok("a", "fork", midway).await["step"], 700);
    // The same command has the same effect, the draw included; without it the states differ.
    let again = client.ok("b", "inform", informed).await;
    assert_eq!(again["result"]["ids"], ids["result"]["ids"]);
    let there = client.hash("a").await;
    assert_eq!(client.hash_at("b", 2200).await, there);
    assert_ne!(client.hash_at("c", 2200).await, there);

    let (code, message) = client
        .err("a", "fork", json!({"name": "d", "step": 2201}))
        .await;
    assert_eq!(code, ErrorCode::Conflict, "{message}");
    let (code, _) = client.err("a", "fork", json!({"name": "b"})).await;
    assert_eq!(code, ErrorCode::AlreadyExists);
    let (code, _) = client.err("a", "fork", json!({"name": "*"})).await;
    assert_eq!(code, ErrorCode::InvalidArgument);
    daemon.stop().await;
}

/// `origin` and `swarm_id` of a swarm, of its status and of the list of swarms.
async fn record_of(client: &Client, name: &str) -> (Value, u64) {
    let status = client.get(name, "status").await["result"].clone();
    let swarms = client.node("swarms").await["swarms"].clone();
    let mut rows = swarms.as_array().unwrap().iter();
    let row = rows.find(|it| it["swarm"] == name).unwrap();
    for field in ["origin", "swarm_id"] {
        assert_eq!(row.get(field), status.get(field), "{name}: {field}");
    }
    (
        status["origin"].clone(),
        status["swarm_id"].as_u64().unwrap(),
    )
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_has_its_number_in_the_store_and_what_it_was_made_from() {
    let folder = tempfile::tempdir().unwrap();
    let (daemon, other) = (
        daemon_process::start(folder.path()).await,
        Daemon::start().await,
    );
    let client = &daemon.1;
    for name in ["a", "b"] {
        client.create(name, json!({"n": 5, "seed": 3})).await;
    }
    client.ok("b", "annotate", json!({"text": "counts"})).await;
    client
        .ok(
            "b",
            "inform",
            json!({"select": {"ids": [1]}, "direction": 0.5}),
        )
        .await;
    client.ok("b", "step", json!({"steps": 7})).await;
    client.ok("b", "fork", json!({"name": "now"})).await;
    client
        .ok("b", "fork", json!({"name": "before", "step": 3}))
        .await;
    let saved = snapshot(client, "b").await;
    let at_7 = client.hash("b").await;
    let at_3 = client.hash("before").await;
    for at in [client, &other.client] {
        restore(at, "restored", &saved).await.unwrap();
    }
    let ids = [record_of(client, "a").await, record_of(client, "b").await];
    let [(none, first), (_, second)] = &ids;
    assert_eq!((none, first < second), (&Value::Null, true));
    let fork = json!({
        "kind": "fork", "swarm": "b", "swarm_id": second, "step": 7, "seq": 3, "state_hash": at_7,
    });
    let before = json!({
        "kind": "fork", "swarm": "b", "swarm_id": second, "step": 3, "seq": 3, "state_hash": at_3,
    });
    let restored = json!({
        "kind": "restore", "swarm": "b", "swarm_id": null, "step": 7, "seq": 3, "state_hash": at_7,
    });
    assert_eq!(record_of(client, "now").await.0, fork);
    assert_eq!(record_of(client, "before").await.0, before);
    assert_eq!(record_of(client, "restored").await.0, restored);
    assert_eq!(record_of(&other.client, "restored").await.0, restored);

    // After a kill as before it; a later swarm of the same name is another one.
    let kept = record_of(client, "now").await;
    client.ok("b", "delete", json!({})).await;
    let daemon = daemon_process::killed(folder.path(), daemon).await;
    let client = &daemon.1;
    assert_eq!(record_of(client, "now").await, kept);
    assert_eq!(record_of(client, "a").await, ids[0]);
    client.create("b", json!({"n": 5, "seed": 3})).await;
    let (origin, again) = record_of(client, "b").await;
    assert!(origin.is_null() && again > kept.1, "{again} {kept:?}");
    // A reset keeps both.
    client.ok("now", "reset", json!({})).await;
    assert_eq!(record_of(client, "now").await, kept);
    other.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_snapshot_goes_on_in_any_daemon() {
    let (here, there) = (Daemon::start().await, Daemon::start().await);
    create_in_contact(&here.client, "a", 74).await;
    let informed = json!({"select": {"count": 4}, "direction": 2.0, "for_time": 5.0});
    here.client.ok("a", "inform", informed).await;
    let rules = json!({"attraction": {"kind": "topological", "neighbours": 7}, "noise": 0.05,
        "relinearise": 1});
    here.client.ok("a", "set", rules).await;
    let at_step = json!({"at_step": 1600, "args": {"pi3": 1.5}});
    here.client.ok("a", "set", at_step).await;
    let bytes = snapshot(&here.client, "a").await;
    let restored = restore(&there.client, "b", &bytes).await.unwrap();
    assert_eq!(restored["step"], 1500);
    assert_eq!(restored["phase"], "paused");
    assert_eq!(
        here.client.hash_at("a", 2000).await,
        there.client.hash_at("b", 2000).await
    );
    let status = there.client.get("b", "status").await;
    let parameters = &status["result"]["parameters"];
    assert_eq!(
        (&parameters["pi3"], &parameters["noise"]),
        (&json!(1.5), &json!(0.05))
    );
    assert_eq!(parameters["attraction"]["neighbours"], 7);

    let error = restore(&there.client, "b", &bytes).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::AlreadyExists);
    // A bit of a position: the hash covers every part that later states depend on.
    let mut read = Snapshot::from_cbor(&bytes).unwrap();
    read.x[10] = f64::from_bits(read.x[10].to_bits() ^ 1);
    for bad in [
        jostle_proto::to_cbor(&read),
        bytes[..bytes.len() - 1].to_vec(),
        Vec::new(),
        b"snapshot".to_vec(),
    ] {
        let error = restore(&there.client, "c", &bad).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{error:?}");
    }
    here.stop().await;
    there.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn verify_replays_a_history_to_the_same_hashes() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create_in_contact(client, "a", 40).await;
    client
        .ok(
            "a",
            "inform",
            json!({"select": {"count": 4}, "direction": 0}),
        )
        .await;
    client.ok("a", "step", json!({"steps": 1000})).await;
    client.ok("a", "reset", json!({"seed": 9})).await;
    client.ok("a", "inject", json!({"count": 3})).await;
    client.ok("a", "step", json!({"steps": 2000})).await;
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    client.ok("a", "step", json!({"steps": 600})).await;
    let verified = client.get("a", "verify").await["result"].take();
    assert_eq!(verified["differs_at"], Value::Null, "{verified}");
    assert_eq!(verified["from_step"], 0);
    assert_eq!(verified["to_step"], 2600);
    // Every 500 steps: five before the reset, four and one after it; and the present one.
    assert_eq!(verified["hashes"], 11);
    // A history too short for a journaled hash has only the present one.
    client.create("short", json!({"n": 10})).await;
    client.ok("short", "step", json!({"steps": 7})).await;
    let informed = json!({"select": {"count": 2}, "direction": 1});
    client.ok("short", "inform", informed).await;
    let verified = client.get("short", "verify").await["result"].take();
    assert_eq!(
        (
            &verified["hashes"],
            &verified["to_step"],
            &verified["differs_at"]
        ),
        (&json!(1), &json!(7), &Value::Null)
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restarted_daemon_recovers_its_swarms() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create_in_contact(client, "paused", 20).await;
    client.create("running", json!({"n": 20, "rate": 2})).await;
    client
        .ok("running", "run", json!({"until_step": 1_000_000}))
        .await;
    client.create("gone", json!({"n": 3})).await;
    client.ok("gone", "delete", json!({})).await;
    let named = json!({"client": "me", "request_id": "once", "args": {"count": 2}});
    let first = client.ok("paused", "inject", named.clone()).await;
    let (hash, before) = (
        client.hash("paused").await,
        client.get("paused", "status").await,
    );
    let journal = client.get("paused", "journal").await["result"]["entries"].take();

    let daemon = daemon.restart().await;
    let client = &daemon.client;
    assert_eq!(client.hash("paused").await, hash);
    let after = client.get("paused", "status").await;
    for field in ["step", "seq", "phase"] {
        assert_eq!(before[field], after[field]);
    }
    assert_eq!(
        after["epoch"].as_u64(),
        before["epoch"].as_u64().map(|it| it + 1)
    );
    assert_eq!(
        client.get("paused", "journal").await["result"]["entries"],
        journal
    );
    // The reply that it had, and no second execution.
    assert_eq!(client.ok("paused", "inject", named).await, first);
    assert_eq!(client.hash("paused").await, hash);
    let running = client.get("running", "status").await;
    assert_eq!(running["phase"], "running");
    assert_eq!(running["result"]["until_step"], 1_000_000);
    let swarms = client.node("swarms").await;
    assert_eq!(swarms["swarms"].as_array().unwrap().len(), 2);
    daemon.stop().await;
}
