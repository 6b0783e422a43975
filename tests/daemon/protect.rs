//! A protected swarm rejects `delete` and `reset`, and nothing else.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{ErrorCode, EventKind, Reply, Snapshot, keys};
use serde_json::{Value, json};

use crate::commands::create_in_every_phase;
use crate::support::daemon_process::{self, DaemonProcess, daemon, killed};
use crate::support::process::jostled;
use crate::support::streams::{next_event, subscribe};
use crate::support::{Client, Daemon, NODE, PREFIX};

fn on() -> Value {
    json!({"on": true})
}

fn off() -> Value {
    json!({"on": false})
}

/// Whether the status says it; the list of the daemon must say the same.
async fn is_protected(client: &Client, swarm: &str) -> bool {
    let status = client.get(swarm, "status").await;
    let listed = client.node("swarms").await["swarms"].take();
    let rows = listed.as_array().unwrap();
    let row = rows.iter().find(|row| row["swarm"] == swarm).unwrap();
    assert_eq!(row["protected"], status["result"]["protected"], "{swarm}");
    match &status["result"]["protected"] {
        Value::Bool(true) => true,
        // It is left out.
        Value::Null => false,
        other => panic!("{swarm}: {other}"),
    }
}

#[track_caller]
fn assert_says_how(swarm: &str, (code, message): &(ErrorCode, String)) {
    assert_eq!(*code, ErrorCode::IncorrectState, "{message}");
    let remedy = format!("`jostle protect --off {swarm}`");
    assert!(message.contains(&remedy), "{message}");
}

/// Sends everything that would delete or reset a swarm.
async fn assert_is_kept(client: &Client, swarm: &str) {
    let step = client.get(swarm, "status").await["step"].as_u64().unwrap();
    let epoch = client.get(swarm, "status").await["epoch"].clone();
    for (verb, request) in [
        ("delete", json!({})),
        ("reset", json!({})),
        ("reset", json!({"seed": 7})),
        (
            "delete",
            json!({"at_step": step + 1_000_000_000, "args": {}}),
        ),
        (
            "reset",
            json!({"at_step": step + 1_000_000_000, "args": {}}),
        ),
    ] {
        assert_says_how(swarm, &client.err(swarm, verb, request).await);
    }
    let discard = json!({"name": swarm}).to_string();
    let key = keys::node_cmd(PREFIX, NODE, "discard");
    let error = client.query(&key, Some(discard.as_bytes())).await;
    let error = error.unwrap_err();
    assert_says_how(swarm, &(error.code, error.message));
    let status = client.get(swarm, "status").await;
    assert_eq!(status["epoch"], epoch, "{swarm}");
    assert_eq!(status["result"]["scheduled"], 0, "{swarm}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_protected_swarm_is_neither_deleted_nor_reset_in_any_phase() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create_in_every_phase(client).await;
    for name in ["paused", "running", "faulted"] {
        assert!(!is_protected(client, name).await, "{name}");
        let before = client.get(name, "status").await;
        let events = subscribe(client, keys::event(PREFIX, name)).await;
        let reply = client.ok(name, "protect", on()).await;
        assert_eq!(reply["result"], json!({}), "{name}");
        let seq = before["seq"].as_u64().unwrap() + 1;
        assert_eq!(reply["seq"], seq, "{name}");
        assert_eq!(reply["phase"], before["phase"], "{name}");
        let event = next_event(&events).await;
        let EventKind::Command { verb, args, .. } = &event.event else {
            panic!("{name}: {event:?}");
        };
        assert_eq!((verb.as_str(), args), ("protect", &on()), "{name}");
        assert!(is_protected(client, name).await, "{name}");
        assert_is_kept(client, name).await;
        // It is idempotent, and a command each time.
        client.ok(name, "protect", on()).await;
        if name != "running" {
            assert_eq!(
                client.hash(name).await,
                before["result"]["state_hash"].as_str().unwrap()
            );
        }
        if name != "faulted" {
            for (verb, args) in [
                ("set", json!({"pi3": 1.1})),
                ("remove", json!({"select": {"count": 1}})),
                ("pause", json!({})),
                ("step", json!({"steps": 3})),
            ] {
                client.ok(name, verb, args).await;
            }
        }
        assert_is_kept(client, name).await;

        client.ok(name, "protect", off()).await;
        assert!(!is_protected(client, name).await, "{name}");
        let reset = client.ok(name, "reset", json!({})).await;
        assert_eq!(reset["step"], 0, "{name}");
        client.ok(name, "delete", json!({})).await;
    }
    assert_eq!(client.node("swarms").await["swarms"], json!([]));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn at_its_step_a_scheduled_command_meets_the_protection_of_then() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 10, "seed": 3})).await;
    let at = |step: u64, args: Value| json!({"at_step": step, "args": args});
    for (verb, step, args) in [
        ("protect", 5, on()),
        ("reset", 10, json!({})),
        ("delete", 12, json!({})),
        ("protect", 15, off()),
        ("delete", 20, json!({})),
    ] {
        client.ok("a", verb, at(step, args)).await;
    }
    let events = subscribe(client, keys::event(PREFIX, "a")).await;
    client.ok("a", "step", json!({"steps": 16})).await;
    let mut rejected = Vec::new();
    while rejected.len() < 2 {
        if let EventKind::Refused { verb, error, .. } = next_event(&events).await.event {
            assert_says_how("a", &(error.code, error.message));
            rejected.push((verb, error.step));
        }
    }
    let expected = [("reset", 10), ("delete", 12)];
    let expected = expected.map(|(verb, step)| (verb.to_owned(), Some(step)));
    assert_eq!(rejected, expected);
    assert_eq!(client.get("a", "status").await["step"], 16);
    assert!(!is_protected(client, "a").await);
    let verified = client.get("a", "verify").await["result"].take();
    assert_eq!(verified["differs_at"], Value::Null, "{verified}");

    let _ = client.cmd("a", "step", json!({"steps": 10})).await;
    crate::support::until("it is deleted", async || {
        client.node("swarms").await["swarms"] == json!([])
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_that_was_protected_has_the_hashes_and_the_draws_of_one_that_was_not() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for name in ["plain", "kept"] {
        client.create(name, json!({"n": 30, "seed": 3})).await;
    }
    for (verb, args) in [
        ("inform", json!({"select": {"count": 3}, "direction": 1.0})),
        ("inject", json!({"count": 2})),
        ("remove", json!({"select": {"count": 2}})),
    ] {
        client.ok("kept", "protect", on()).await;
        let plain = client.ok("plain", verb, args.clone()).await;
        let kept = client.ok("kept", verb, args).await;
        assert_eq!(plain["result"], kept["result"], "{verb}");
        for name in ["plain", "kept"] {
            client.ok(name, "step", json!({"steps": 50})).await;
        }
        assert_eq!(client.hash("plain").await, client.hash("kept").await);
    }
    let exported = client.get("kept", "experiment").await["result"].take();
    assert_eq!(exported["state_hash"], client.hash("kept").await);
    let file = |exported: &Value| exported["file"].as_str().unwrap().contains("protect");
    assert!(!file(&exported), "{exported}");
    daemon.stop().await;
}

async fn snapshot(client: &Client, swarm: &str) -> Snapshot {
    let replies = client.session.get(keys::get(PREFIX, swarm, "snapshot"));
    let sample = replies.await.unwrap().recv_async().await.unwrap();
    let sample = sample.into_result().unwrap();
    let reply: Reply<Snapshot> = ciborium::from_reader(&*sample.payload().to_bytes()).unwrap();
    reply.result
}

async fn restore(client: &Client, snapshot: &Snapshot, name: &str) {
    let snapshot = STANDARD.encode(jostle_proto::to_cbor(snapshot));
    let args = json!({"name": name, "snapshot": snapshot}).to_string();
    let key = keys::node_cmd(PREFIX, NODE, "restore");
    client.query(&key, Some(args.as_bytes())).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fork_and_a_restored_swarm_begin_unprotected() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 10, "seed": 3})).await;
    client.ok("a", "step", json!({"steps": 5})).await;
    client.ok("a", "protect", on()).await;
    client.ok("a", "step", json!({"steps": 5})).await;
    client.ok("a", "fork", json!({"name": "now"})).await;
    client
        .ok("a", "fork", json!({"name": "before", "step": 8}))
        .await;
    let snapshot = snapshot(client, "a").await;
    assert!(snapshot.protected);
    restore(client, &snapshot, "restored").await;
    let copies = ["now", "before", "restored"];
    for name in copies {
        assert!(!is_protected(client, name).await, "{name}");
    }
    assert!(is_protected(client, "a").await);

    let daemon = daemon.restart().await;
    let client = &daemon.client;
    assert!(is_protected(client, "a").await);
    assert_is_kept(client, "a").await;
    for name in copies {
        assert!(!is_protected(client, name).await, "{name}");
        client.ok(name, "reset", json!({})).await;
        client.ok(name, "delete", json!({})).await;
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_has_the_scheduled_protections_of_its_original() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 10, "seed": 3})).await;
    client.ok("a", "step", json!({"steps": 5})).await;
    let at = |step: u64, args: Value| json!({"at_step": step, "args": args});
    client.ok("a", "protect", at(8, on())).await;
    client.ok("a", "delete", at(10, json!({}))).await;
    client.ok("a", "fork", json!({"name": "now"})).await;
    let snapshot = snapshot(client, "a").await;
    restore(client, &snapshot, "restored").await;
    client.ok("a", "step", json!({"steps": 7})).await;
    client
        .ok("a", "fork", json!({"name": "before", "step": 7}))
        .await;
    client.ok("a", "protect", off()).await;
    for (name, step) in [("now", 5), ("restored", 5), ("before", 7)] {
        let status = client.get(name, "status").await;
        assert_eq!(status["step"], step, "{name}");
        assert_eq!(status["result"]["scheduled"], 2, "{name}");
        assert!(!is_protected(client, name).await, "{name}");
        // Its `delete` at step 10 is rejected, too.
        client.ok(name, "step", json!({"steps": 12 - step})).await;
        assert!(is_protected(client, name).await, "{name}");
        assert_is_kept(client, name).await;
    }
    assert!(!is_protected(client, "a").await);
    daemon.stop().await;
}

/// The fields of a stored state, in the order in which they are stored.
async fn stored_fields(client: &Client, swarm: &str) -> Vec<String> {
    let snapshot = jostle_proto::to_cbor(&snapshot(client, swarm).await);
    let value: ciborium::Value = ciborium::from_reader(&*snapshot).unwrap();
    let fields = value.into_map().unwrap().into_iter();
    fields.map(|(name, _)| name.into_text().unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_stored_of_a_swarm_that_is_not_protected_has_no_field_more() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for name in ["never", "ended"] {
        client.create(name, json!({"n": 3})).await;
        client.ok(name, "annotate", json!({"text": "here"})).await;
    }
    client.ok("ended", "protect", on()).await;
    let is_it = |field: &String| field == "protected";
    assert!(stored_fields(client, "ended").await.iter().any(is_it));
    client.ok("ended", "protect", off()).await;
    let never = stored_fields(client, "never").await;
    assert!(!never.iter().any(is_it));
    assert_eq!(stored_fields(client, "ended").await, never);
    daemon.stop().await;
}

/// The commands `protect` in the journal of a swarm.
async fn journaled(client: &Client, swarm: &str) -> Vec<Value> {
    let journal = client.get(swarm, "journal?limit=1000").await;
    let entries = journal["result"]["entries"].as_array().unwrap().iter();
    let entries = entries.filter(|entry| entry["verb"] == "protect");
    entries.map(|entry| entry["args"].clone()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_protection_survives_kills_and_is_executed_once() {
    let folder = tempfile::tempdir().unwrap();
    let mut running = daemon_process::start(folder.path()).await;
    let client = &running.1;
    client.create("a", json!({"n": 10, "seed": 3})).await;
    crate::commands::fault(client, "b").await;
    let named = |id: &str, args: Value| json!({"client": "me", "request_id": id, "args": args});
    let first = client.ok("a", "protect", named("1", on())).await;
    client.ok("b", "protect", on()).await;
    // Rejected commands are in the journal, too.
    for name in ["a", "b"] {
        for verb in ["reset", "delete"] {
            assert_says_how(name, &client.err(name, verb, json!({})).await);
        }
    }
    client.ok("a", "step", json!({"steps": 20})).await;
    // Its reply is sent when all before it is durable, also the steps.
    client.ok("a", "annotate", json!({"text": "here"})).await;
    let hash = client.hash("a").await;

    running = killed(folder.path(), running).await;
    let client = &running.1;
    for name in ["a", "b"] {
        assert!(is_protected(client, name).await, "{name}");
        assert_is_kept(client, name).await;
    }
    assert_eq!(client.get("b", "status").await["phase"], "faulted");
    assert_eq!(client.hash("a").await, hash);
    let again = client.ok("a", "protect", named("1", on())).await;
    assert_eq!(again, first);
    assert_eq!(journaled(client, "a").await, [on()]);

    // The retry of an earlier `on` does not protect it again.
    client.ok("a", "protect", named("2", off())).await;
    client.ok("a", "protect", named("1", on())).await;
    assert!(!is_protected(client, "a").await);
    running = killed(folder.path(), running).await;
    let client = &running.1;
    assert!(!is_protected(client, "a").await);
    client.ok("a", "protect", named("1", on())).await;
    assert!(!is_protected(client, "a").await);
    assert_eq!(journaled(client, "a").await, [on(), off()]);
    let verified = client.get("a", "verify").await["result"].take();
    assert_eq!(verified["differs_at"], Value::Null, "{verified}");
    client.ok("a", "reset", json!({})).await;
    client.ok("a", "delete", json!({})).await;
    client.ok("b", "protect", off()).await;
    client.ok("b", "reset", json!({})).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_protected_swarm_is_protected_in_a_backup() {
    let base = tempfile::tempdir().unwrap();
    let [data, backup, elsewhere] = ["data", "backup", "other"].map(|it| base.path().join(it));
    std::fs::create_dir(&data).unwrap();
    let running = daemon_process::start(&data).await;
    running.1.create("a", json!({"n": 10, "seed": 3})).await;
    running.1.ok("a", "protect", on()).await;
    let path = |path: &std::path::Path| path.to_str().unwrap().to_owned();
    let (from, to, restored) = (path(&data), path(&backup), path(&elsewhere));
    for arguments in [
        ["backup", &to, "--data-dir", &from],
        ["restore", &to, "--data-dir", &restored],
    ] {
        let ended = jostled(&arguments).output().unwrap();
        assert!(ended.status.success(), "{arguments:?}: {ended:?}");
    }
    drop(running);
    let process = DaemonProcess::start(&mut daemon(&elsewhere)).unwrap();
    let client = Client::open(&process.endpoint).await;
    assert!(is_protected(&client, "a").await);
    assert_is_kept(&client, "a").await;
}
