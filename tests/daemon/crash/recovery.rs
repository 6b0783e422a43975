//! Recovery after a kill: the order of commands, interrupted steps, creation and deletion.

use std::collections::BTreeMap;
use std::time::Duration;

use serde_json::{Value, json};

use crate::support::daemon_process::{self, DaemonProcess};
use crate::support::{Client, NODE, PREFIX, until};

/// Commands that wait for the same sync are committed together; a `step` among them is journaled
/// when it is executed.
#[tokio::test(flavor = "multi_thread")]
async fn commands_committed_together_with_a_step_are_recovered_in_order() {
    let folder = tempfile::tempdir().unwrap();
    // Commands that arrive meanwhile are committed together.
    let mut command = daemon_process::daemon(folder.path());
    command.env("FAILPOINTS", "swarm-durable=sleep(150)");
    let mut process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    client.create("a", json!({"n": 20, "seed": 3})).await;
    let inform = json!({"select": {"count": 4}, "direction": 1});
    let mut replies = Vec::new();
    for (verb, request) in [
        ("set", json!({"pi3": 1.1})),
        ("step", json!({"steps": 400})),
        ("inform", inform.clone()),
        ("inject", json!({"count": 2})),
        ("pause", json!({})),
        ("step", json!({"steps": 7})),
        ("remove", json!({"select": {"count": 3}})),
        ("inform", inform),
    ] {
        let key = jostle_proto::keys::cmd(PREFIX, "a", verb);
        let get = client.session.get(key).payload(request.to_string());
        replies.push(get.timeout(Duration::from_secs(20)).await.unwrap());
    }
    let mut steps = Vec::new();
    for reply in replies {
        let reply = reply.recv_async().await.unwrap().into_result().unwrap();
        let reply: Value = serde_json::from_slice(&reply.payload().to_bytes()).unwrap();
        steps.push(reply["step"].as_u64().unwrap());
    }
    println!("carried out at steps {steps:?}");
    let place = async |client: &Client| {
        let status = client.get("a", "status").await;
        let hash = status["result"]["state_hash"].clone();
        let [step, seq] = ["step", "seq"].map(|field| status[field].clone());
        json!([step, seq, hash, status["phase"]])
    };
    until("it stands", async || {
        client.get("a", "status").await["phase"] == "paused"
    })
    .await;
    let before = place(&client).await;
    process.kill();
    let process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    until("it stands", async || {
        client.get("a", "status").await["phase"] == "paused"
    })
    .await;
    assert_eq!(place(&client).await, before);
}

/// The next daemon finishes a `step`; a retry meanwhile gets the reply then.
#[tokio::test(flavor = "multi_thread")]
async fn a_step_that_a_crash_interrupts_is_finished_once_after_recovery() {
    const STEPS: u64 = 40_000;
    let folder = tempfile::tempdir().unwrap();
    let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    client.create("a", json!({"n": 74, "seed": 3})).await;
    let step = json!({
        "client": "me", "request_id": "1", "timeout_secs": 60, "args": {"steps": STEPS},
    });
    let key = jostle_proto::keys::cmd(PREFIX, "a", "step");
    let get = client.session.get(&key).payload(step.to_string());
    let unanswered = get.timeout(Duration::from_secs(20)).await.unwrap();
    // A durable command after it.
    let inform = json!({"select": {"ids": [3]}, "direction": 1});
    until("it moves", async || {
        client.get("a", "status").await["phase"] == "running"
    })
    .await;
    let informed = client.ok("a", "inform", inform).await;
    assert_eq!(informed["phase"], "running");
    process.kill();
    drop(unanswered);

    let process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    let status = client.get("a", "status").await;
    assert_eq!(status["phase"], "running");
    assert!(status["step"].as_u64() >= informed["step"].as_u64());
    let both = tokio::join!(
        client.cmd("a", "step", step.clone()),
        client.cmd("a", "step", step.clone())
    );
    let (one, other) = (both.0.unwrap(), both.1.unwrap());
    assert_eq!(one, other);
    assert_eq!(
        (&one["step"], &one["result"]["steps"]),
        (&json!(STEPS), &json!(STEPS))
    );
    assert_eq!(client.ok("a", "step", step).await, one);
    assert_eq!(client.get("a", "status").await["seq"], 2);
}

/// The next daemon replies to a durable command that got no reply, and does not execute it again.
#[tokio::test(flavor = "multi_thread")]
async fn creating_forking_and_deleting_are_done_once_across_a_crash() {
    let folder = tempfile::tempdir().unwrap();
    let create = jostle_proto::keys::node_cmd(PREFIX, NODE, "create");
    let cmd = |verb| jostle_proto::keys::cmd(PREFIX, "a", verb);
    let requests = [
        (
            create,
            "store-synced=return",
            json!({"name": "a", "spec": {"n": 5}}),
        ),
        (cmd("fork"), "", json!({"name": "b"})),
        (cmd("delete"), "swarm-ended=return", json!({})),
    ];
    for (k, (key, point, args)) in requests.into_iter().enumerate() {
        let request = json!({"client": "me", "request_id": k.to_string(), "args": args});
        let payload = request.to_string();
        let mut command = daemon_process::daemon(folder.path());
        if !point.is_empty() {
            command.env("FAILPOINTS", point);
        }
        let mut process = DaemonProcess::start(&mut command).unwrap();
        let client = Client::open(&process.endpoint).await;
        let answer = client.query_all(&key, Some(payload.as_bytes())).await.pop();
        match point {
            // It got a reply, which the client may not have received.
            "" => {
                answer.unwrap().unwrap();
                process.kill();
            }
            _ => {
                assert!(answer.is_none(), "{answer:?}");
                assert_eq!(process.end(), None);
            }
        }
        let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
        let client = Client::open(&process.endpoint).await;
        let again = client.query(&key, Some(payload.as_bytes())).await.unwrap();
        assert!(again["result"]["created"] != json!(false), "{again}");
        assert_eq!(
            client.query(&key, Some(payload.as_bytes())).await.unwrap(),
            again
        );
        let swarms = client.node("swarms").await["swarms"].take();
        let names: Vec<&Value> = swarms
            .as_array()
            .unwrap()
            .iter()
            .map(|it| &it["swarm"])
            .collect();
        assert_eq!(
            json!(names),
            [json!(["a"]), json!(["a", "b"]), json!(["b"])][k]
        );
        process.kill();
    }
}

/// No acknowledged command is lost and no event number is used twice, however often the daemon
/// is killed before its queue is on the disk.
#[tokio::test(flavor = "multi_thread")]
async fn repeated_kills_lose_no_command_and_reuse_no_event_number() {
    let folder = tempfile::tempdir().unwrap();
    let (mut answered, mut known) = (Vec::new(), BTreeMap::new());
    for round in 0..5_u64 {
        let mut daemon = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
        let client = Client::open(&daemon.endpoint).await;
        if round == 0 {
            client
                .create("a", json!({"n": 20, "seed": 3, "rate": 1}))
                .await;
            client.ok("a", "run", json!({})).await;
            answered.push(1);
        }
        for k in 0..3 {
            let reply = client.ok("a", "set", json!({"pi3": 1 + k + round})).await;
            answered.push(reply["seq"].as_u64().unwrap());
        }
        let journal = client.get("a", "journal").await;
        let events = client.get("a", "events?limit=1000").await;
        daemon.kill();

        let entries = journal["result"]["entries"].as_array().unwrap().iter();
        let entries: Vec<_> = entries.map(|it| it["seq"].as_u64().unwrap()).collect();
        assert_eq!(entries, answered, "round {round}");
        for event in events["result"]["events"].as_array().unwrap() {
            let number = event["number"].as_u64().unwrap();
            let about = json!([event["event"]["kind"], event["event"]["verb"], event["seq"]]);
            let first = known.entry(number).or_insert_with(|| about.clone());
            assert_eq!(*first, about, "event {number} in round {round}");
        }
    }
}
