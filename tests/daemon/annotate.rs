//! Notes are in the journal and the events of a swarm, and change nothing else.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{ErrorCode, EventKind, Reply, Snapshot, keys};
use serde_json::{Value, json};

use crate::commands::{create_in_every_phase, fault};
use crate::support::daemon_process::{self, DaemonProcess};
use crate::support::streams::{next_event, subscribe};
use crate::support::{Client, Daemon, NODE, PREFIX, until};

fn annotate_request(text: &str) -> Value {
    json!({"text": text})
}

/// The notes in the journal of a swarm, each with its step.
async fn notes(client: &Client, swarm: &str) -> Vec<(u64, String)> {
    let journal = client.get(swarm, "journal?limit=1000").await;
    let entries = journal["result"]["entries"].as_array().unwrap().iter();
    let notes = entries.filter(|entry| entry["verb"] == "annotate");
    notes
        .map(|entry| {
            let text = entry["args"]["text"].as_str().unwrap();
            (entry["step"].as_u64().unwrap(), text.to_owned())
        })
        .collect()
}

/// The parts of a status that a note must not change.
async fn status_without_note(client: &Client, swarm: &str) -> Value {
    let status = client.get(swarm, "status").await;
    let result = &status["result"];
    let fields = ["state_hash", "reason", "parameters", "informed", "rate"];
    let fields = fields.map(|field| result[field].clone());
    json!([status["epoch"], status["step"], status["phase"], fields])
}

#[tokio::test(flavor = "multi_thread")]
async fn a_note_is_in_the_journal_and_the_events_in_every_phase() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create_in_every_phase(client).await;
    for name in ["paused", "running", "faulted"] {
        let before = status_without_note(client, name).await;
        let seq = client.get(name, "status").await["seq"].as_u64().unwrap();
        let events = subscribe(client, keys::event(PREFIX, name)).await;
        let reply = client
            .ok(name, "annotate", annotate_request("camera 2: ü"))
            .await;
        assert_eq!(reply["result"], json!({}), "{name}");
        assert_eq!(reply["seq"], seq + 1, "{name}");
        assert_eq!(reply["phase"], before[2], "{name}");
        if name != "running" {
            assert_eq!(status_without_note(client, name).await, before, "{name}");
        }
        let event = next_event(&events).await;
        let EventKind::Command {
            seq: number,
            verb,
            args,
            ..
        } = &event.event
        else {
            panic!("{name}: {event:?}");
        };
        assert_eq!((*number, verb.as_str()), (seq + 1, "annotate"), "{name}");
        assert_eq!(*args, annotate_request("camera 2: ü"), "{name}");
        let kept = client.get(name, "events?limit=1000").await;
        let kept = kept["result"]["events"].as_array().unwrap().clone();
        let is_it = |it: &&Value| it["number"] == event.number;
        let kept = kept.iter().find(is_it).unwrap();
        assert_eq!(
            kept["event"]["args"],
            annotate_request("camera 2: ü"),
            "{name}"
        );
        let step = reply["step"].as_u64().unwrap();
        let expected = [(step, "camera 2: ü".to_owned())];
        assert_eq!(notes(client, name).await, expected, "{name}");
    }
    // A faulted swarm reaches no later step.
    let later = json!({"at_step": 1_000_000, "args": annotate_request("later")});
    let (code, _) = client.err("faulted", "annotate", later).await;
    assert_eq!(code, ErrorCode::IncorrectState);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_note_does_not_cut_a_step_short() {
    const STEPS: u64 = 40_000;
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 74, "seed": 3})).await;
    let other = daemon.another_client().await;
    let step = json!({"timeout_secs": 60, "args": {"steps": STEPS}});
    let stepping = tokio::spawn(async move { other.ok("a", "step", step).await });
    until("it moves", async || {
        client.get("a", "status").await["phase"] == "running"
    })
    .await;
    let reply = client
        .ok("a", "annotate", annotate_request("on the way"))
        .await;
    assert!(reply["step"].as_u64().unwrap() <= STEPS, "{reply}");
    let stepped = stepping.await.unwrap();
    assert_eq!(stepped["result"]["steps"], STEPS, "{stepped}");
    daemon.stop().await;
}

async fn restore(client: &Client, swarm: &str, name: &str) {
    let replies = client.session.get(keys::get(PREFIX, swarm, "snapshot"));
    let sample = replies.await.unwrap().recv_async().await.unwrap();
    let sample = sample.into_result().unwrap();
    let reply: Reply<Snapshot> = ciborium::from_reader(&*sample.payload().to_bytes()).unwrap();
    let snapshot = STANDARD.encode(jostle_proto::to_cbor(&reply.result));
    let args = json!({"name": name, "snapshot": snapshot}).to_string();
    let key = keys::node_cmd(PREFIX, NODE, "restore");
    client.query(&key, Some(args.as_bytes())).await.unwrap();
}

/// Sends a command that draws to every swarm, and checks that all draws are the same.
async fn draw(client: &Client, swarms: &[&str], verb: &str, args: &Value) {
    let mut results = Vec::new();
    for swarm in swarms {
        let reply = client.ok(swarm, verb, args.clone()).await;
        results.push(reply["result"].clone());
    }
    for (swarm, result) in swarms.iter().zip(&results) {
        assert_eq!(*result, results[0], "{swarm}: {verb} {args}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_with_notes_has_the_hashes_and_the_draws_of_one_without() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for name in ["plain", "noted"] {
        client.create(name, json!({"n": 30, "seed": 3})).await;
    }
    let inform = json!({"select": {"count": 3}, "direction": 1.0});
    let several = json!({"commands": [
        {"verb": "inject", "args": {"count": 2}},
        {"verb": "inform", "args": inform},
        {"verb": "remove", "args": {"select": {"count": 1}}},
    ]});
    let (mut count, mut step) = (0, 0);
    for (verb, args) in [
        ("inform", inform.clone()),
        ("inject", json!({"count": 2})),
        ("batch", several),
        ("uninform", json!({"select": {"fraction": 0.5}})),
        ("remove", json!({"select": {"count": 2}})),
    ] {
        for text in ["one", "two"] {
            client.ok("noted", "annotate", annotate_request(text)).await;
        }
        let later = json!({"at_step": step + 20, "args": annotate_request("later")});
        client.ok("noted", "annotate", later).await;
        count += 3;
        draw(client, &["plain", "noted"], verb, &args).await;
        step += 50;
        let mut hashes = Vec::new();
        for name in ["plain", "noted"] {
            let reply = client.ok(name, "step", json!({"steps": 50})).await;
            hashes.push(reply["result"]["state_hash"].clone());
        }
        assert_eq!(hashes[0], hashes[1], "after {verb}");
    }
    assert_eq!(notes(client, "noted").await.len(), count);
    let seq = async |name: &str| client.get(name, "status").await["seq"].as_u64().unwrap();
    let notes = u64::try_from(count).unwrap();
    assert_eq!(seq("noted").await, seq("plain").await + notes);
    let verified = client.get("noted", "verify").await["result"].take();
    assert_eq!(verified["differs_at"], Value::Null, "{verified}");
    assert_eq!(verified["to_step"], step, "{verified}");

    // Copies and a later run of the daemon count the notes, too.
    client.ok("noted", "fork", json!({"name": "forked"})).await;
    restore(client, "noted", "restored").await;
    for name in ["forked", "restored"] {
        assert_eq!(seq(name).await, seq("noted").await, "{name}");
    }
    let all = ["plain", "noted", "forked", "restored"];
    draw(client, &all, "inform", &inform).await;
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    draw(client, &all, "inform", &inform).await;
    let seq = async |name: &str| client.get(name, "status").await["seq"].as_u64().unwrap();
    assert_eq!(seq("noted").await, seq("plain").await + notes);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_note_survives_a_kill_and_is_written_once() {
    let folder = tempfile::tempdir().unwrap();
    let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    client.create("a", json!({"n": 10, "seed": 3})).await;
    let named = json!({"client": "me", "request_id": "1", "args": annotate_request("lights off")});
    let first = client.ok("a", "annotate", named.clone()).await;
    let later = json!({
        "client": "me", "request_id": "2", "at_step": 30, "args": annotate_request("at 30"),
    });
    client.ok("a", "annotate", later.clone()).await;
    fault(&client, "b").await;
    client.ok("b", "annotate", annotate_request("why")).await;
    let mut before = Vec::new();
    for name in ["a", "b"] {
        let status = client.get(name, "status").await;
        before.push((client.hash(name).await, status["seq"].clone()));
    }
    let of_b = notes(&client, "b").await;
    process.kill();

    let process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    for (name, before) in ["a", "b"].into_iter().zip(before) {
        let status = client.get(name, "status").await;
        let now = (client.hash(name).await, status["seq"].clone());
        assert_eq!(now, before, "{name}");
    }
    assert_eq!(client.get("b", "status").await["phase"], "faulted");
    assert_eq!(notes(&client, "b").await, of_b);
    assert_eq!(of_b.len(), 1);
    assert_eq!(client.ok("a", "annotate", named).await, first);
    client.ok("a", "annotate", later).await;
    client.ok("a", "step", json!({"steps": 40})).await;
    let expected = [(0, "lights off".to_owned()), (30, "at 30".to_owned())];
    assert_eq!(notes(&client, "a").await, expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_note_has_1_to_1000_characters_in_one_line() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    for text in ["x".to_owned(), "ü".repeat(1000), "🐟".repeat(1000)] {
        client.ok("a", "annotate", annotate_request(&text)).await;
    }
    // Other invalid notes are in `abuse/to_a_swarm.txt`.
    for text in [String::new(), "ü".repeat(1001), "two\nlines".to_owned()] {
        let error = client
            .cmd("a", "annotate", annotate_request(&text))
            .await
            .unwrap_err();
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{text:?}");
        assert_eq!(error.details["field"], "text", "{text:?}");
    }
    assert_eq!(notes(client, "a").await.len(), 3);
    daemon.stop().await;
}
