//! Experiments on a daemon: they continue without their clients, and after a restart.

mod restarts;

use std::fs;
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::support::process::Process;
use crate::support::{Client, Daemon, NODE, PREFIX, QueryResult, TIMEOUT, until};

/// Some runs that take a second or two together.
fn small(name: &str) -> String {
    format!(
        "name = \"{name}\"\nseed = 3\nreplicates = 2\nduration = 20\n[[grid]]\npi1 = [1, 4]\nn = \
         [3, 8]\ninformed = [0, 1]\n[measure]\norder_every = 10\n"
    )
}

/// Runs that take longer than any test.
fn endless(name: &str) -> String {
    format!("name = \"{name}\"\nreplicates = 4\nduration = 1e6\n[[grid]]\nn = [20, 30]\n")
}

pub async fn send(client: &Client, args: &Value) -> QueryResult {
    let key = keys::node_cmd(PREFIX, NODE, "experiment");
    client.query(&key, Some(args.to_string().as_bytes())).await
}

pub async fn ok(client: &Client, args: Value) -> Value {
    let answer = send(client, &args).await;
    answer.unwrap_or_else(|error| panic!("{args}: {error:?}"))["result"].take()
}

pub async fn submit(client: &Client, toml: &str) -> Value {
    ok(client, json!({"submit": {"toml": toml}})).await
}

pub async fn error_of(client: &Client, args: Value) -> (ErrorCode, String) {
    let error = send(client, &args).await.unwrap_err();
    (error.code, error.message)
}

async fn get(client: &Client, name: &str, noun: &str) -> QueryResult {
    client
        .query(&keys::experiment(PREFIX, NODE, name, noun), None)
        .await
}

pub async fn progress(client: &Client, name: &str) -> Value {
    get(client, name, "progress").await.unwrap()
}

/// Waits until an experiment is in a phase.
pub async fn wait_for_phase(client: &Client, name: &str, phase: &str) -> Value {
    let deadline = Instant::now() + 6 * TIMEOUT;
    loop {
        let progress = progress(client, name).await;
        if progress["phase"] == phase {
            return progress;
        }
        assert!(Instant::now() < deadline, "{progress} is not {phase}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Every row, in pages of so many.
pub async fn rows(client: &Client, name: &str, limit: usize) -> Vec<Value> {
    let (mut rows, mut after) = (Vec::new(), json!(0));
    while !after.is_null() {
        let page = get(
            client,
            name,
            &format!("results?after={after};limit={limit}"),
        )
        .await;
        let page = page.unwrap();
        let some = page["rows"].as_array().unwrap();
        assert!(some.len() <= limit);
        rows.extend(some.iter().cloned());
        after = page["next"].clone();
    }
    rows
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_is_executed_its_progress_published_and_its_results_paged() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let key = keys::experiment(PREFIX, NODE, "small", "progress");
    let samples = client.session.declare_subscriber(&key).await.unwrap();
    let submitted = submit(client, &small("small")).await;
    assert_eq!(submitted["created"], true);
    assert_eq!(submitted["progress"]["runs"], 16);
    let finished = wait_for_phase(client, "small", "finished").await;
    assert_eq!(
        (&finished["finished"], &finished["share"]),
        (&json!(16), &json!(1.0))
    );
    assert_eq!(finished["faulted"], 0);

    let rows_ = rows(client, "small", 1000).await;
    let names: Vec<&str> = rows_
        .iter()
        .map(|row| row["run"].as_str().unwrap())
        .collect();
    assert_eq!(names.len(), 16);
    assert_eq!(
        names[..2],
        ["pi1=1 n=3 informed=0 #0", "pi1=1 n=3 informed=0 #1"]
    );
    assert_eq!(
        rows(client, "small", 5).await,
        rows_,
        "in pages they are the same"
    );
    assert!(
        rows_[0]["v_pd"].is_null() && rows_[2]["v_pd"].is_f64(),
        "{rows_:?}"
    );

    let order = get(client, "small", &format!("order?run={}", names[2]))
        .await
        .unwrap();
    assert_eq!(order["order"].as_array().unwrap().len(), 101);
    assert_eq!(order["time"][100], 20.0);
    assert_eq!(order["drift"].as_array().unwrap().len(), 101);
    let some = get(
        client,
        "small",
        &format!("order?run={};after=100", names[2]),
    )
    .await;
    assert_eq!(some.unwrap()["order"][0], order["order"][100]);
    let unknown = get(client, "small", "order?run=nobody").await.unwrap_err();
    assert_eq!(unknown.code, ErrorCode::NotFound);

    let list = client.node("experiments").await;
    assert_eq!(list["experiments"], json!([finished]));
    let wild = client
        .query_all("jostle/@node/*/experiment/*/progress", None)
        .await;
    assert_eq!(wild, [Ok(finished)]);

    let mut published = Vec::new();
    until("the end is published", async || {
        while let Ok(Some(sample)) = samples.try_recv() {
            let progress: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
            published.push(progress);
        }
        published
            .last()
            .is_some_and(|last| last["phase"] == "finished")
    })
    .await;
    let shares: Vec<f64> = published
        .iter()
        .map(|it| it["share"].as_f64().unwrap())
        .collect();
    assert!(shares.is_sorted(), "{shares:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_beyond_its_limit_is_rejected_with_the_limit_of_its_noun() {
    let daemon = Daemon::start().await;
    for (noun, most) in [
        ("order?run=a #0;limit=40001", 40_000),
        ("series?run=a #0;limit=0", 40_000),
        ("results?limit=1001", 1000),
    ] {
        let error = get(&daemon.client, "small", noun).await.unwrap_err();
        let range = format!("a whole number from 1 to {most}");
        assert_eq!(error.details["range"], range, "{noun}: {error:?}");
        assert!(error.message.contains(&range), "{error:?}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_file_again_is_the_same_experiment_and_another_is_rejected() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    submit(client, &small("small")).await;
    let again = submit(client, &small("small")).await;
    assert_eq!(again["created"], false);
    let other = json!({"submit": {"toml": small("other"), "name": "small"}});
    let (code, message) = error_of(client, other.clone()).await;
    assert_eq!(code, ErrorCode::AlreadyExists);
    assert!(
        message.contains("another name") && message.contains("delete"),
        "{message}"
    );
    wait_for_phase(client, "small", "finished").await;
    assert_eq!(submit(client, &small("small")).await["created"], false);
    ok(client, json!({"delete": {"name": "small"}})).await;
    let gone = get(client, "small", "progress").await.unwrap_err();
    assert_eq!(gone.code, ErrorCode::NotFound);
    assert_eq!(
        ok(client, other).await["created"],
        true,
        "the name is free again"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_experiment_is_rejected_with_its_line() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for (toml, named) in [
        (
            "name = \"a\"\nduration = 1\n[spec]\nn = 5\npi9 = 3\n",
            "line 5",
        ),
        ("name = \"a\"\nduration = \n", "line 2"),
        ("name = \"a\"\nduration = -1\nspec = { n = 5 }\n", "line 2"),
        ("name = \"A\"\nduration = 1\nspec = { n = 5 }\n", "line 1"),
        ("", "name"),
    ] {
        let args = json!({"submit": {"toml": toml}});
        let error = send(client, &args).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{toml}");
        assert!(error.message.contains(named), "{toml}: {}", error.message);
        assert_eq!(error.details["field"], "submit.toml", "{toml}");
    }
    for args in [
        json!({}),
        json!({"begin": {}}),
        json!({"submit": {"toml": 5}}),
    ] {
        let (code, message) = error_of(client, args.clone()).await;
        assert_eq!(code, ErrorCode::InvalidArgument, "{args}: {message}");
    }
    for what in ["pause", "resume", "cancel", "delete"] {
        let (code, _) = error_of(client, json!({what: {"name": "nobody"}})).await;
        assert_eq!(code, ErrorCode::NotFound, "{what}");
    }
    assert_eq!(client.node("experiments").await["experiments"], json!([]));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_runs_of_a_paused_experiment_stop_and_the_next_begins() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    submit(client, &endless("first")).await;
    wait_for_phase(client, "first", "running").await;
    submit(client, &small("second")).await;
    assert_eq!(progress(client, "second").await["phase"], "queued");
    let paused = ok(client, json!({"pause": {"name": "first"}})).await["progress"].take();
    assert_eq!(paused["phase"], "paused");
    // A paused run has finished its step by the time that another experiment is finished.
    wait_for_phase(client, "second", "finished").await;
    let before = wait_for_phase(client, "first", "paused").await;
    submit(client, &small("third")).await;
    wait_for_phase(client, "third", "finished").await;
    assert_eq!(progress(client, "first").await, before, "it stands still");
    let (code, message) = error_of(client, json!({"delete": {"name": "first"}})).await;
    assert_eq!(code, ErrorCode::IncorrectState);
    assert!(message.contains("cancel it first"), "{message}");
    ok(client, json!({"resume": {"name": "first"}})).await;
    wait_for_phase(client, "first", "running").await;
    let cancelled = ok(client, json!({"cancel": {"name": "first"}})).await;
    assert_eq!(cancelled["progress"]["phase"], "cancelled");
    ok(client, json!({"delete": {"name": "first"}})).await;
    let (code, _) = error_of(client, json!({"cancel": {"name": "second"}})).await;
    assert_eq!(code, ErrorCode::IncorrectState);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_with_an_id_is_executed_once() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let args = json!({"submit": {"toml": small("once")}});
    let request = json!({"request_id": "7", "client": "ada", "args": args});
    let first = send(client, &request).await.unwrap();
    let again = send(client, &request).await.unwrap();
    assert_eq!(first, again, "to the byte, `created` included");
    let other = json!({"request_id": "7", "client": "ada", "args": {"pause": {"name": "once"}}});
    let error = send(client, &other).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::Conflict);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_daemon_publishes_the_progress_of_an_experiment() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let other = daemon.another_client().await;
    let key = keys::experiment(PREFIX, NODE, "forged", "progress");
    let samples = client.session.declare_subscriber(&key).await.unwrap();
    for _ in 0..20 {
        other.session.put(&key, "forged").await.unwrap();
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert!(samples.try_recv().unwrap().is_none());
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn runs_yield_to_live_swarms() {
    let (daemon, endpoint) = Process::serve();
    let client = &Client::open(&endpoint).await;
    submit(client, &endless("long")).await;
    wait_for_phase(client, "long", "running").await;
    client.create("live", json!({"n": 50, "rate": 1})).await;
    client.ok("live", "run", json!({"until_time": 4.0})).await;
    client.wait_for_step("live", 200).await;
    // Run threads have a higher niceness than swarm threads, so the scheduler prefers swarms.
    let tasks = fs::read_dir(format!("/proc/{}/task", daemon.0.id())).unwrap();
    let (mut runs, mut live) = (Vec::new(), Vec::new());
    for task in tasks.map(|task| task.unwrap().path()) {
        let Ok(stat) = fs::read_to_string(task.join("stat")) else {
            continue; // It has ended.
        };
        let (name, rest) = stat.rsplit_once(')').unwrap();
        let nice: i32 = rest.split_whitespace().nth(16).unwrap().parse().unwrap();
        if name.contains("(run-") {
            runs.push(nice);
        } else if name.ends_with("(swarm-live") {
            live.push(nice);
        }
    }
    // A thread that the swarm's thread starts has its name and niceness until it sets its own.
    let (lowest, highest) = (runs.iter().min(), live.iter().max());
    assert!(highest.is_some() && lowest > highest, "{runs:?} {live:?}");
}
