//! The daemon as a process: its demo, its end, and a client that stops taking what it is sent.

use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};
use zenoh::Wait;

use crate::apart::{Process, jostled};
use crate::support::{Client, PATIENCE, PREFIX, alone, beside_others, read, until};

#[tokio::test(flavor = "multi_thread")]
async fn sigterm_and_ctrl_c_end_it() {
    let _alone = alone().await;
    for signal in ["-TERM", "-INT"] {
        let (mut daemon, endpoint) = Process::serve();
        let client = Client::open(&endpoint).await;
        for i in 0..20 {
            let name = format!("s{i}");
            client.create(&name, json!({"n": 20, "rate": null})).await;
            client.ok(&name, "run", json!({})).await;
        }
        daemon.signal(signal);
        assert_eq!(daemon.end().0, Some(0), "{signal}");
    }
}

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
    let _alone = alone().await;
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
            .one("jostle/@node/test/get/status", None)
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
    // zenoh waits 10 s for a session that takes nothing, unless the daemon ends without it.
    assert!(took < Duration::from_secs(8), "{took:?}");
}

fn output(arguments: &[&str]) -> Output {
    let mut command = jostled(arguments);
    command.stderr(Stdio::piped()).output().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_demo_ends_by_itself_and_says_what_came_of_it() {
    let _machine = beside_others().await;
    let demo = output(&["demo", "--for", "4s", "--listen", "tcp/127.0.0.1:0"]);
    let text = String::from_utf8(demo.stdout).unwrap();
    assert_eq!(demo.status.code(), Some(0), "{text}");
    let lines: Vec<&str> = text.lines().collect();
    assert!(
        lines.iter().any(|line| line.contains("real-time factor")),
        "{text}"
    );
    let last = lines.last().unwrap();
    assert!(last.starts_with("mean drift towards +x: "), "{last}");
    assert!(
        last.contains("(t = 0 to 50)") && last.contains("(t = 50 to 80)"),
        "{last}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_served_is_said_with_its_remedy() {
    let _machine = beside_others().await;
    let (_daemon, endpoint) = Process::serve();
    let taken = output(&["--listen", &endpoint]);
    let text = String::from_utf8(taken.stderr).unwrap();
    assert_eq!(taken.status.code(), Some(1));
    assert!(text.contains("--listen tcp/127.0.0.1:0"), "{text}");

    for (arguments, named) in [
        (vec!["--listen", "tcp/0.0.0.0:7447"], "other machines"),
        (vec!["--node", "no/name"], "node"),
        (vec!["--max-hz", "often"], "--max-hz"),
        (vec!["--config", "/nowhere.toml"], "/nowhere.toml"),
        (vec!["--log", "=,="], "log"),
        (vec!["--wings"], "--wings"),
        (vec!["config", "explain", "--max-hz", "often"], "--max-hz"),
        (
            vec!["config", "explain", "--listen", "tcp/0.0.0.0:7447"],
            "other machines",
        ),
        (
            vec!["config", "explain", "--config", "/nowhere.toml"],
            "/nowhere.toml",
        ),
        (vec!["demo", "--for", "soon"], "soon"),
    ] {
        let refused = output(&arguments);
        let text = String::from_utf8(refused.stderr).unwrap();
        assert_eq!(refused.status.code(), Some(2), "{arguments:?}: {text}");
        assert!(text.contains(named), "{arguments:?}: {text}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_defect_in_a_command_is_told_changes_nothing_and_hurts_nobody_else() {
    let _beside_others = beside_others().await;
    // The second and third change panic.
    let (_daemon, endpoint) = Process::serve_failing("command=1*off->2*panic->off");
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 5, "seed": 1})).await;
    client.ok("a", "inject", json!({"count": 1})).await;
    let before = client.get("a", "status").await;
    let inform = json!({"select": {"count": 2}, "direction": 1});
    let request = json!({"client": "me", "request_id": "1", "args": inform});
    for verb in ["inform", "batch"] {
        let request = match verb {
            "batch" => json!({"commands": [{"verb": "inform", "args": inform}]}),
            _ => request.clone(),
        };
        let error = client.cmd("a", verb, request).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::Internal, "{error:?}");
        assert_eq!(error.step, Some(0));
        assert_eq!(client.get("a", "status").await, before);
    }
    // It goes on, under the same name too, as if they had never been sent.
    client.ok("a", "inform", request).await;
    client.create("b", json!({"n": 5, "seed": 1})).await;
    client.ok("b", "inject", json!({"count": 1})).await;
    client.ok("b", "inform", inform).await;
    assert_eq!(client.hash("a").await, client.hash("b").await);
}

/// A change is made when it is safe, and nobody waits for it but whoever sent it and whoever sends
/// the same swarm another.
#[tokio::test(flavor = "multi_thread")]
async fn whoever_waits_for_a_slow_disk_holds_up_nobody_else() {
    const COMMIT: Duration = Duration::from_secs(1);
    let _machine = alone().await;
    let (_daemon, endpoint) = Process::serve_failing("store-begin=sleep(1000)");
    let client = Client::open(&endpoint).await;
    for swarm in ["a", "b", "c", "free"] {
        client.create(swarm, json!({"n": 5})).await;
    }
    let send = |swarm: &str, verb: &str, request: Value| {
        let key = keys::cmd(PREFIX, swarm, verb);
        let get = client.session.get(key).payload(request.to_string());
        get.timeout(PATIENCE).wait().unwrap()
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

#[tokio::test(flavor = "multi_thread")]
async fn a_defect_in_a_step_faults_its_swarm_and_no_other() {
    let _beside_others = beside_others().await;
    let (_daemon, endpoint) = Process::serve_failing("step=3*off->1*panic->off");
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 5})).await;
    client.create("b", json!({"n": 5})).await;
    let error = client.cmd("a", "step", json!({"steps": 9})).await;
    let error = error.unwrap_err();
    assert_eq!((error.code, error.step), (ErrorCode::Faulted, Some(3)));
    assert_eq!(client.get("a", "status").await["phase"], "faulted");
    let nine = client.ok("b", "step", json!({"steps": 9})).await;
    client.ok("a", "reset", json!({})).await;
    let again = client.ok("a", "step", json!({"steps": 9})).await;
    assert_eq!(again["result"]["state_hash"], nine["result"]["state_hash"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_defect_in_reading_a_query_is_told_and_the_daemon_goes_on() {
    let _beside_others = beside_others().await;
    let (_daemon, endpoint) = Process::serve_failing("query=1*panic->off");
    let client = Client::open(&endpoint).await;
    let key = keys::node_get(PREFIX, "test", "hello");
    let error = client.one(&key, None).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::Internal);
    assert!(client.one(&key, None).await.is_ok());
}

#[test]
fn the_manual_is_written_and_a_setting_without_effect_is_refused() {
    let run = |line: &str| {
        let words: Vec<&str> = line.split(' ').collect();
        jostled(&words).stderr(Stdio::piped()).output().unwrap()
    };
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("pages");
    let written = run(&format!("man -o {}", pages.display()));
    assert!(written.status.success(), "{written:?}");
    let page = |name: &str| std::fs::read_to_string(pages.join(name)).unwrap();
    assert!(page("jostled.1").contains(r"\-\-listen"));
    assert!(page("jostled-demo.1").contains(r"\-\-listen"));
    let run_page = page("jostled-run.1");
    assert!(!run_page.contains(r"\-\-listen") && run_page.contains(r"\-\-threads"));
    for line in ["--listen tcp/127.0.0.1:0 man", "run a.toml -o b --log info"] {
        let refused = run(line);
        assert_eq!(refused.status.code(), Some(2), "{refused:?}");
        let said = String::from_utf8(refused.stderr).unwrap();
        assert!(said.contains("has no effect on `jostled "), "{said}");
    }
}
