//! Clients that stop reading, and a slow disk.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde_json::{Value, json};
use zenoh::Wait;

use crate::support::process::Process;
use crate::support::{Client, PREFIX, TIMEOUT, read, until};

/// Not a test by itself: the client that [`frozen_clients_delay_neither_steps_nor_answers_nor_the_end`]
/// starts as a process of its own.
#[tokio::test(flavor = "multi_thread")]
async fn a_subscribing_process() {
    let Ok(endpoint) = std::env::var("JOSTLE_TEST_SUBSCRIBE_TO") else {
        return;
    };
    let client = Client::open(&endpoint).await;
    let states = client
        .session
        .declare_subscriber(keys::state(PREFIX, "*"))
        .await
        .unwrap();
    while states.recv_async().await.is_ok() {}
}

#[tokio::test(flavor = "multi_thread")]
async fn frozen_clients_delay_neither_steps_nor_answers_nor_the_end() {
    const STEPS_PER_SECOND: u64 = 50;
    let (mut daemon, endpoint) = Process::serve();
    let client = Client::open(&endpoint).await;
    let (_other, other) = Process::serve();
    let free = Client::open(&other).await;
    let disc = json!({"kind": "disc", "radius": 200});
    for client in [&client, &free] {
        let spec = json!({"n": 500, "rate": 1, "dt": 0.02, "publish_every": 1, "start": disc});
        client.create("a", spec).await;
        client.ok("a", "run", json!({})).await;
    }
    let subscriber = || {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command
            .args(["--exact", "process::a_subscribing_process"])
            .env("JOSTLE_TEST_SUBSCRIBE_TO", &endpoint)
            .stdout(Stdio::null());
        Process::of(&mut command)
    };
    let subscribers = [subscriber(), subscriber(), subscriber()];
    let clients = async || {
        client
            .query("jostle/@node/test/get/status", None)
            .await
            .unwrap()["result"]["clients"]
            .clone()
    };
    until("the subscriber", async || clients().await == 4).await;
    for subscriber in &subscribers {
        subscriber.signal("-STOP");
    }

    // A daemon without subscribers shows how fast the swarm can step on this machine.
    let step = async |client: &Client| client.get("a", "status").await["step"].as_u64().unwrap();
    let first = [step(&client).await, step(&free).await];
    let (mut last, mut longest) = (first[0], 0);
    while step(&free).await < first[1] + 12 * STEPS_PER_SECOND {
        let now = step(&client).await;
        longest = longest.max(now - last);
        last = now;
    }
    let (taken, meant) = (last - first[0], step(&free).await - first[1]);
    println!(
        "with three frozen subscribers: {taken} steps, {meant} without them; \
         at most {longest} between two replies"
    );
    assert!(taken * 20 > meant * 19, "{taken} of {meant}");
    assert!(
        longest < STEPS_PER_SECOND,
        "{longest} steps without a reply"
    );

    daemon.signal("-TERM");
    let (code, took) = daemon.end();
    assert_eq!(code, Some(0));
    // zenoh waits 10 s for a session that does not read, unless the daemon exits without closing it.
    assert!(took < Duration::from_secs(8), "{took:?}");
}

/// A change is applied when it is durable. Only its sender and the senders of later commands to the
/// same swarm wait for it.
#[tokio::test(flavor = "multi_thread")]
async fn a_slow_disk_delays_only_the_swarms_that_wait_for_it() {
    const COMMIT: Duration = Duration::from_secs(1);
    let (_daemon, endpoint) = Process::serve_failing("store-begin=sleep(1000)");
    let client = Client::open(&endpoint).await;
    for swarm in ["a", "b", "c", "free"] {
        client.create(swarm, json!({"n": 5})).await;
    }
    let send = |swarm: &str, verb: &str, request: Value| {
        let key = keys::cmd(PREFIX, swarm, verb);
        let get = client.session.get(key).payload(request.to_string());
        get.timeout(TIMEOUT).wait().unwrap()
    };
    let began = Instant::now();
    let changes = ["a", "b", "c"].map(|swarm| send(swarm, "set", json!({"pi2": 0.7})));
    let step = send("a", "step", json!({"steps": 1}));
    for _ in 0..10 {
        client.ok("free", "step", json!({"steps": 1})).await;
    }
    let free = began.elapsed();
    assert!(free < COMMIT / 2, "{free:?}");
    for reply in changes {
        let reply = reply.recv_async().await.unwrap().into_result().unwrap();
        let reply = read(reply.encoding(), &reply.payload().to_bytes());
        assert_eq!(reply["result"]["now"]["pi2"], 0.7);
    }
    let stepped = step.recv_async().await.unwrap().into_result().unwrap();
    let stepped = read(stepped.encoding(), &stepped.payload().to_bytes());
    assert_eq!((&stepped["step"], &stepped["seq"]), (&json!(1), &json!(2)));
    assert!(began.elapsed() > COMMIT / 2, "{:?}", began.elapsed());
}
