//! A hundred swarms are recovered, and the order of their commands is kept.

use std::collections::BTreeMap;
use std::time::Duration;

use serde_json::{Value, json};

use crate::crash::life::{self, Life};
use crate::support::{Client, NODE, PREFIX, alone, beside_others, until};

/// How long a hundred swarms run before the kill; with `JOSTLE_LONG=1` the second.
const RUN_SECS: [u64; 2] = [11, 30];

#[tokio::test(flavor = "multi_thread")]
async fn a_hundred_swarms_of_a_hundred_are_back() {
    const SWARMS: u64 = 100;
    let _alone = alone().await;
    let folder = tempfile::tempdir().unwrap();
    let mut empty = Life::begin(&mut life::daemon(folder.path())).unwrap();
    let client = Client::open(&empty.endpoint).await;
    for k in 0..SWARMS {
        let name = format!("s{k}");
        client
            .create(&name, json!({"n": 100, "seed": k, "rate": 1}))
            .await;
        client
            .ok(&name, "step", json!({"steps": 600, "return": "none"}))
            .await;
    }
    for k in 0..SWARMS {
        client.ok(&format!("s{k}"), "run", json!({})).await;
    }
    let run = RUN_SECS[usize::from(std::env::var_os("JOSTLE_LONG").is_some())];
    tokio::time::sleep(Duration::from_secs(run)).await;
    let mut steps = Vec::new();
    for k in 0..SWARMS {
        let inform = json!({"select": {"count": 3}, "direction": 1});
        let reply = client.ok(&format!("s{k}"), "inform", inform).await;
        steps.push(reply["step"].as_u64().unwrap());
    }
    empty.kill();

    let life = Life::begin(&mut life::daemon(folder.path())).unwrap();
    println!("back with {SWARMS} swarms after {run} s in {:?}", life.took);
    let client = Client::open(&life.endpoint).await;
    for (k, step) in steps.iter().enumerate() {
        let status = client.get(&format!("s{k}"), "status").await;
        assert!(status["step"].as_u64().unwrap() >= *step, "{status}");
        assert_eq!(status["phase"], "running");
        assert_eq!(status["result"]["informed"], 3);
    }
}

/// Commands that wait for each other's sync are made safe together; a `step` among them is written
/// down only when it is carried out.
#[tokio::test(flavor = "multi_thread")]
async fn commands_taken_together_with_a_step_come_back_in_their_order() {
    let _machine = beside_others().await;
    let folder = tempfile::tempdir().unwrap();
    // Whoever comes meanwhile is taken together.
    let mut command = life::daemon(folder.path());
    command.env("FAILPOINTS", "swarm-durable=sleep(150)");
    let mut life = Life::begin(&mut command).unwrap();
    let client = Client::open(&life.endpoint).await;
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
    life.kill();
    let life = Life::begin(&mut life::daemon(folder.path())).unwrap();
    let client = Client::open(&life.endpoint).await;
    until("it stands", async || {
        client.get("a", "status").await["phase"] == "paused"
    })
    .await;
    assert_eq!(place(&client).await, before);
}

/// A `step` is taken to its end by the next daemon; whoever asks meanwhile is answered then.
#[tokio::test(flavor = "multi_thread")]
async fn a_step_that_a_crash_cut_short_is_done_once_and_answered_then() {
    const STEPS: u64 = 40_000;
    let _machine = beside_others().await;
    let folder = tempfile::tempdir().unwrap();
    let mut life = Life::begin(&mut life::daemon(folder.path())).unwrap();
    let client = Client::open(&life.endpoint).await;
    client.create("a", json!({"n": 74, "seed": 3})).await;
    let step = json!({
        "client": "me", "request_id": "1", "timeout_secs": 60, "args": {"steps": STEPS},
    });
    let key = jostle_proto::keys::cmd(PREFIX, "a", "step");
    let get = client.session.get(&key).payload(step.to_string());
    let unanswered = get.timeout(Duration::from_secs(20)).await.unwrap();
    // Something safe that comes after it.
    let inform = json!({"select": {"ids": [3]}, "direction": 1});
    until("it moves", async || {
        client.get("a", "status").await["phase"] == "running"
    })
    .await;
    let informed = client.ok("a", "inform", inform).await;
    assert_eq!(informed["phase"], "running");
    life.kill();
    drop(unanswered);

    let life = Life::begin(&mut life::daemon(folder.path())).unwrap();
    let client = Client::open(&life.endpoint).await;
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

/// What was made safe and not answered is answered by the next daemon, and not done again.
#[tokio::test(flavor = "multi_thread")]
async fn creating_forking_and_deleting_are_done_once_across_a_crash() {
    let _machine = beside_others().await;
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
        let mut command = life::daemon(folder.path());
        if !point.is_empty() {
            command.env("FAILPOINTS", point);
        }
        let mut life = Life::begin(&mut command).unwrap();
        let client = Client::open(&life.endpoint).await;
        let answer = client.ask(&key, Some(payload.as_bytes())).await.pop();
        match point {
            // Answered, but perhaps nobody heard it.
            "" => {
                answer.unwrap().unwrap();
                life.kill();
            }
            _ => {
                assert!(answer.is_none(), "{answer:?}");
                assert_eq!(life.end(), None);
            }
        }
        let mut life = Life::begin(&mut life::daemon(folder.path())).unwrap();
        let client = Client::open(&life.endpoint).await;
        let again = client.one(&key, Some(payload.as_bytes())).await.unwrap();
        assert!(again["result"]["created"] != json!(false), "{again}");
        assert_eq!(
            client.one(&key, Some(payload.as_bytes())).await.unwrap(),
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
        life.kill();
    }
}

/// What an answer said stays told, and a number of an event means one thing, however often the
/// daemon is killed before what it had in hand is on the disk.
#[tokio::test(flavor = "multi_thread")]
async fn killed_again_and_again_nothing_is_left_out_and_no_number_is_given_twice() {
    let _machine = beside_others().await;
    let folder = tempfile::tempdir().unwrap();
    let (mut answered, mut told) = (Vec::new(), BTreeMap::new());
    for life in 0..5_u64 {
        let mut daemon = Life::begin(&mut life::daemon(folder.path())).unwrap();
        let client = Client::open(&daemon.endpoint).await;
        if life == 0 {
            client
                .create("a", json!({"n": 20, "seed": 3, "rate": 1}))
                .await;
            client.ok("a", "run", json!({})).await;
            answered.push(1);
        }
        for k in 0..3 {
            let reply = client.ok("a", "set", json!({"pi3": 1 + k + life})).await;
            answered.push(reply["seq"].as_u64().unwrap());
        }
        let journal = client.get("a", "journal").await;
        let events = client.get("a", "events?limit=1000").await;
        daemon.kill();

        let entries = journal["result"]["entries"].as_array().unwrap().iter();
        let entries: Vec<_> = entries.map(|it| it["seq"].as_u64().unwrap()).collect();
        assert_eq!(entries, answered, "life {life}");
        for event in events["result"]["events"].as_array().unwrap() {
            let number = event["number"].as_u64().unwrap();
            let about = json!([event["event"]["kind"], event["event"]["verb"], event["seq"]]);
            let first = told.entry(number).or_insert_with(|| about.clone());
            assert_eq!(*first, about, "event {number} in life {life}");
        }
    }
}
