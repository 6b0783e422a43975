//! Experiments on a daemon: they outlive their clients, and the daemon itself.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::apart::{Process, jostled};
use crate::crash::life::{Life, daemon};
use crate::support::{Answer, Client, Daemon, NODE, PATIENCE, PREFIX, alone, beside_others, until};

/// A handful of runs that take a second or two together.
fn small(name: &str) -> String {
    format!(
        "name = \"{name}\"\nseed = 3\nreplicates = 2\nduration = 20\n[[grid]]\npi1 = [1, 4]\nn = \
         [3, 8]\ninformed = [0, 1]\n[measure]\norder_every = 10\n"
    )
}

/// Runs that go on for longer than any test.
fn endless(name: &str) -> String {
    format!("name = \"{name}\"\nreplicates = 4\nduration = 1e6\n[[grid]]\nn = [20, 30]\n")
}

async fn send(client: &Client, args: &Value) -> Answer {
    let key = keys::node_cmd(PREFIX, NODE, "experiment");
    client.one(&key, Some(args.to_string().as_bytes())).await
}

pub async fn ok(client: &Client, args: Value) -> Value {
    let answer = send(client, &args).await;
    answer.unwrap_or_else(|error| panic!("{args}: {error:?}"))["result"].take()
}

pub async fn submit(client: &Client, toml: &str) -> Value {
    ok(client, json!({"submit": {"toml": toml}})).await
}

async fn refused(client: &Client, args: Value) -> (ErrorCode, String) {
    let error = send(client, &args).await.unwrap_err();
    (error.code, error.message)
}

async fn get(client: &Client, name: &str, noun: &str) -> Answer {
    client
        .one(&keys::experiment(PREFIX, NODE, name, noun), None)
        .await
}

pub async fn progress(client: &Client, name: &str) -> Value {
    get(client, name, "progress").await.unwrap()
}

/// Waits until an experiment is in a phase.
pub async fn reach(client: &Client, name: &str, phase: &str) -> Value {
    let deadline = Instant::now() + 6 * PATIENCE;
    loop {
        let progress = progress(client, name).await;
        if progress["phase"] == phase {
            return progress;
        }
        assert!(Instant::now() < deadline, "{progress} is not {phase}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Every row, asked for so many at a time.
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
async fn an_experiment_is_carried_out_told_of_and_its_results_come_in_pages() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let key = keys::experiment(PREFIX, NODE, "small", "progress");
    let samples = client.session.declare_subscriber(&key).await.unwrap();
    let submitted = submit(client, &small("small")).await;
    assert_eq!(submitted["created"], true);
    assert_eq!(submitted["progress"]["runs"], 16);
    let finished = reach(client, "small", "finished").await;
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
        .ask("jostle/@node/*/experiment/*/progress", None)
        .await;
    assert_eq!(wild, [Ok(finished)]);

    let mut told = Vec::new();
    until("the end is told", async || {
        while let Ok(Some(sample)) = samples.try_recv() {
            let told_: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
            told.push(told_);
        }
        told.last().is_some_and(|last| last["phase"] == "finished")
    })
    .await;
    let shares: Vec<f64> = told
        .iter()
        .map(|it| it["share"].as_f64().unwrap())
        .collect();
    assert!(shares.is_sorted(), "{shares:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_file_again_is_the_same_experiment_and_another_is_refused() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    submit(client, &small("small")).await;
    let again = submit(client, &small("small")).await;
    assert_eq!(again["created"], false);
    let other = json!({"submit": {"toml": small("other"), "name": "small"}});
    let (code, message) = refused(client, other.clone()).await;
    assert_eq!(code, ErrorCode::AlreadyExists);
    assert!(
        message.contains("another name") && message.contains("delete"),
        "{message}"
    );
    reach(client, "small", "finished").await;
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
async fn what_is_no_experiment_is_refused_by_its_line() {
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
        let (code, message) = refused(client, args.clone()).await;
        assert_eq!(code, ErrorCode::InvalidArgument, "{args}: {message}");
    }
    for what in ["pause", "resume", "cancel", "delete"] {
        let (code, _) = refused(client, json!({what: {"name": "nobody"}})).await;
        assert_eq!(code, ErrorCode::NotFound, "{what}");
    }
    assert_eq!(client.node("experiments").await["experiments"], json!([]));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_a_paused_experiment_the_runs_stand_still_and_the_next_begins() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    submit(client, &endless("first")).await;
    reach(client, "first", "running").await;
    submit(client, &small("second")).await;
    assert_eq!(progress(client, "second").await["phase"], "queued");
    let paused = ok(client, json!({"pause": {"name": "first"}})).await["progress"].take();
    assert_eq!(paused["phase"], "paused");
    // The step that a run was at is finished by the time that another experiment is.
    reach(client, "second", "finished").await;
    let before = reach(client, "first", "paused").await;
    submit(client, &small("third")).await;
    reach(client, "third", "finished").await;
    assert_eq!(progress(client, "first").await, before, "it stands still");
    let (code, message) = refused(client, json!({"delete": {"name": "first"}})).await;
    assert_eq!(code, ErrorCode::IncorrectState);
    assert!(message.contains("cancel it first"), "{message}");
    ok(client, json!({"resume": {"name": "first"}})).await;
    reach(client, "first", "running").await;
    let cancelled = ok(client, json!({"cancel": {"name": "first"}})).await;
    assert_eq!(cancelled["progress"]["phase"], "cancelled");
    ok(client, json!({"delete": {"name": "first"}})).await;
    let (code, _) = refused(client, json!({"cancel": {"name": "second"}})).await;
    assert_eq!(code, ErrorCode::IncorrectState);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_named_request_is_carried_out_once() {
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
async fn nobody_else_publishes_how_far_an_experiment_is() {
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
async fn what_is_unfinished_goes_on_in_another_daemon_and_what_is_paused_does_not() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    submit(client, &endless("still")).await;
    ok(client, json!({"pause": {"name": "still"}})).await;
    submit(client, &endless("going")).await;
    reach(client, "going", "running").await;
    submit(client, &small("next")).await;
    let began = Instant::now();
    let daemon = daemon.restart().await;
    assert!(began.elapsed() < PATIENCE);
    let client = &daemon.client;
    reach(client, "going", "running").await;
    assert_eq!(progress(client, "still").await["phase"], "paused");
    assert_eq!(progress(client, "next").await["phase"], "queued");
    let list = client.node("experiments").await;
    let names: Vec<&str> = list["experiments"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| it["name"].as_str().unwrap())
        .collect();
    assert_eq!(
        names,
        ["still", "going", "next"],
        "in the order of submission"
    );
    ok(client, json!({"cancel": {"name": "going"}})).await;
    reach(client, "next", "finished").await;
    daemon.stop().await;
}

/// A daemon in its own process, and a client of it.
async fn life(folder: &Path) -> (Life, Client) {
    let life = Life::begin(&mut daemon(folder)).unwrap();
    let client = Client::open(&life.endpoint).await;
    (life, client)
}

#[tokio::test(flavor = "multi_thread")]
async fn killed_again_and_again_it_comes_to_the_same_tables() {
    let _beside = beside_others().await;
    // Some seconds of one core: long enough to be killed in the midst of it.
    let toml = "name = \"small\"\nseed = 3\nreplicates = 4\nduration = 300\n[[grid]]\npi1 = [1, 4]\n\
                n = [20, 30]\ninformed = 3\n[measure]\norder_every = 100\n";
    let whole = tempfile::tempdir().unwrap();
    let (_life, client) = life(whole.path()).await;
    submit(&client, toml).await;
    reach(&client, "small", "finished").await;
    let table =
        |folder: &Path, name: &str| fs::read(folder.join("experiments/small").join(name)).unwrap();

    let folder = tempfile::tempdir().unwrap();
    let (mut alive, client) = life(folder.path()).await;
    submit(&client, toml).await;
    // The client goes away, and then the daemon.
    client.session.close().await.unwrap();
    let (mut kills, mut lines) = (0, String::new());
    loop {
        let list = folder.path().join("experiments/small/runs.jsonl");
        let known = fs::read_to_string(&list).unwrap_or_default();
        assert!(
            known.starts_with(&lines),
            "a finished run is never done again"
        );
        let whole_lines = known.rfind('\n').map_or(0, |end| end + 1);
        known[..whole_lines].clone_into(&mut lines);
        let client = Client::open(&alive.endpoint).await;
        let progress = progress(&client, "small").await;
        if progress["phase"] == "finished" {
            break;
        }
        let before = progress["finished"].as_u64().unwrap();
        let deadline = Instant::now() + 6 * PATIENCE;
        while crate::experiments::progress(&client, "small").await["finished"]
            .as_u64()
            .unwrap()
            < (before + 3).min(16)
        {
            assert!(Instant::now() < deadline);
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        alive.kill();
        kills += 1;
        alive = Life::begin(&mut daemon(folder.path())).unwrap();
    }
    assert!(kills >= 3, "{kills}");
    for name in ["results.csv", "results.parquet", "order.parquet"] {
        assert!(
            table(folder.path(), name) == table(whole.path(), name),
            "{name}"
        );
    }
    // Now that it is finished another start does nothing.
    alive.kill();
    let (_alive, client) = life(folder.path()).await;
    let progress = progress(&client, "small").await;
    assert_eq!(
        (&progress["phase"], &progress["finished"]),
        (&json!("finished"), &json!(16))
    );
    assert_eq!(rows(&client, "small", 100).await.len(), 16);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_executes_a_long_run_ends() {
    let _alone = alone().await;
    let serve = ["serve", "--listen", "tcp/127.0.0.1:0", "--node", NODE];
    let (mut process, endpoint) =
        Process::start(&mut jostled(&serve), tempfile::tempdir().unwrap());
    let client = Client::open(&endpoint).await;
    submit(&client, &endless("long")).await;
    reach(&client, "long", "running").await;
    process.signal("-TERM");
    assert_eq!(process.end().0, Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn runs_give_way_to_live_swarms() {
    let _alone = alone().await;
    let daemon = Daemon::for_measuring().await;
    let client = &daemon.client;
    submit(client, &endless("long")).await;
    reach(client, "long", "running").await;
    client.create("live", json!({"n": 50, "rate": 1})).await;
    client.ok("live", "run", json!({"until_time": 4.0})).await;
    client.reach("live", 200).await;
    // Run threads have a higher niceness than swarm threads, so the scheduler prefers swarms.
    let tasks = fs::read_dir("/proc/self/task").unwrap();
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
    assert!(!runs.is_empty() && live.len() == 1, "{runs:?} {live:?}");
    assert!(runs.iter().all(|&nice| nice > live[0]), "{runs:?} {live:?}");
    daemon.stop().await;
}
