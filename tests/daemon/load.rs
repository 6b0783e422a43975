//! Many swarms, many orders, slow clients: nobody holds up anybody.

mod clients;
mod flood;
mod followers;

use std::io::{BufRead, BufReader, Lines};
use std::process::{ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::apart::{Process, busy_time};
use crate::support::{Client, Daemon, NODE, PATIENCE, PREFIX, alone, until};

/// How many are to keep their rate, where the cores can step so many.
const SWARMS: usize = 1000;
/// How many tell what one takes of the cores.
const FIRST: usize = 150;
/// The share of the cores that is asked for.
const ASKED: f64 = 0.8;
const CORES: f64 = 2.0;

#[tokio::test(flavor = "multi_thread")]
async fn a_thousand_swarms_of_twenty_keep_their_rate() {
    let _alone = alone().await;
    let (daemon, endpoint) = Process::serve();
    let client = Client::open(&endpoint).await;
    let host = async |numbers: std::ops::Range<usize>| {
        for i in numbers {
            let name = format!("s{i}");
            client
                .create(&name, json!({"n": 20, "seed": i, "rate": 1}))
                .await;
            // Groups that push are what takes time.
            let request = json!({"timeout_secs": 60, "args": {"steps": 500}});
            client.ok(&name, "step", request).await;
            client.ok(&name, "run", json!({})).await;
        }
    };
    host(0..FIRST).await;
    let (spent, began) = (daemon.cpu_time(), Instant::now());
    tokio::time::sleep(Duration::from_secs(4)).await;
    let spent = (daemon.cpu_time() - spent).as_secs_f64() / began.elapsed().as_secs_f64();
    let each = spent / FIRST as f64;
    let can_step = |&swarms: &usize| swarms as f64 * each <= ASKED * CORES;
    let swarms = (0..=SWARMS).rev().find(can_step).unwrap();
    println!(
        "{:.2} % of a core each: {swarms} swarms of {SWARMS}",
        100.0 * each
    );
    assert!(swarms >= 300, "a swarm of twenty takes {each} of a core");
    host(FIRST..swarms).await;
    let times = async || -> Vec<f64> {
        let swarms = client.node("swarms").await["swarms"].take();
        let times = swarms.as_array().unwrap().iter();
        times.map(|swarm| swarm["time"].as_f64().unwrap()).collect()
    };
    let (before, began) = (times().await, Instant::now());
    let (spent, busy) = (daemon.cpu_time(), busy_time());
    tokio::time::sleep(Duration::from_secs(10)).await;
    let (after, elapsed) = (times().await, began.elapsed().as_secs_f64());
    let spent = (daemon.cpu_time() - spent).as_secs_f64() / elapsed;
    let others = (busy_time() - busy).as_secs_f64() / elapsed - spent;
    let rates = before.iter().zip(&after).map(|(a, b)| (b - a) / elapsed);
    let mut rates: Vec<f64> = rates.collect();
    rates.sort_by(f64::total_cmp);
    let slowest = rates[0];
    println!(
        "slowest of {swarms} swarms: {slowest:.3} time units a second of 1; {:.0} % of {CORES} \
         cores are left",
        100.0 * (1.0 - spent / CORES)
    );
    assert_eq!(after.len(), swarms);
    // Whoever else takes the cores, nobody starves.
    assert!(slowest > 0.1, "{:?}", &rates[..20]);
    // Beside others who take what it needs the rest says nothing.
    if others < 0.2 {
        assert!(slowest > 0.95, "{:?}", &rates[..20]);
    } else {
        println!("not judged: other work took {others:.1} cores meanwhile");
    }

    let began = Instant::now();
    client.get("s50", "status").await;
    assert!(
        began.elapsed() < Duration::from_millis(500),
        "{:?}",
        began.elapsed()
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn twenty_swarms_a_second_are_created_and_deleted() {
    let _alone = alone().await;
    let daemon = Daemon::for_measuring().await;
    let client = &daemon.client;
    let threads = || std::fs::read_dir("/proc/self/task").unwrap().count();
    let began = Instant::now();
    let before = threads();
    for i in 0..60 {
        let name = format!("s{i}");
        client.create(&name, json!({"n": 20, "seed": i})).await;
        client.ok(&name, "step", json!({"steps": 5})).await;
        client.ok(&name, "delete", json!({})).await;
    }
    let rate = 60.0 / began.elapsed().as_secs_f64();
    println!("{rate:.0} swarms a second created, stepped and deleted");
    assert!(rate > 20.0, "{rate}");
    until("the swarms' threads end", async || threads() <= before + 2).await;
    assert_eq!(client.node("status").await["memory_bytes"], 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_name_created_and_deleted_by_many_at_once_is_one_swarm() {
    let daemon = Daemon::start().await;
    let mut tasks = Vec::new();
    for _ in 0..4 {
        let client = daemon.another_client().await;
        tasks.push(tokio::spawn(async move {
            let key = keys::node_cmd(PREFIX, NODE, "create");
            let request = json!({"name": "a", "spec": {"n": 5}}).to_string();
            let mut created = 0;
            for _ in 0..50 {
                match client.one(&key, Some(request.as_bytes())).await {
                    Ok(_) => created += 1,
                    Err(error) => assert_eq!(error.code, ErrorCode::AlreadyExists, "{error:?}"),
                }
                // Either it was there, or another was faster; silence says it is gone too.
                for answer in client.ask("jostle/a/cmd/delete", Some(b"{}")).await {
                    if let Err(error) = answer {
                        assert_eq!(error.code, ErrorCode::NotFound, "{error:?}");
                    }
                }
            }
            created
        }));
    }
    let mut created = 0;
    for task in tasks {
        created += task.await.unwrap();
    }
    assert!(created >= 10, "{created}");
    daemon.client.ask("jostle/a/cmd/delete", Some(b"{}")).await;
    assert_eq!(daemon.client.node("status").await["swarms"], 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_is_answered_and_neither_memory_nor_others_suffer() {
    let _alone = alone().await;
    let daemon = Daemon::for_measuring().await;
    let client = &daemon.client;
    client.create("flooded", json!({"n": 20, "rate": 1})).await;
    client.create("other", json!({"n": 20, "rate": 1})).await;
    for name in ["flooded", "other"] {
        client.ok(name, "run", json!({})).await;
    }
    flood(&daemon.another_client().await, 20_000).await;
    let before = resident_bytes();
    let flooder = daemon.another_client().await;
    let flooding = tokio::spawn(async move { flood(&flooder, 60_000).await });
    let (began, mut slowest) = (Instant::now(), Duration::ZERO);
    let time = async || {
        client.get("other", "status").await["time"]
            .as_f64()
            .unwrap()
    };
    let first = time().await;
    let mut last = first;
    while !flooding.is_finished() {
        let asked = Instant::now();
        last = time().await;
        slowest = slowest.max(asked.elapsed());
    }
    let rate = (last - first) / began.elapsed().as_secs_f64();
    let (answered, busy) = flooding.await.unwrap();
    let grown = resident_bytes().saturating_sub(before) >> 20;
    println!(
        "{answered} answered, {busy} turned away in {:?}; the other swarm ran at {rate:.2}, its \
         slowest answer took {slowest:?}; {grown} MiB more",
        began.elapsed()
    );
    assert_eq!(answered + busy, 60_000);
    assert!(slowest < Duration::from_secs(2), "{slowest:?}");
    assert!(grown < 150, "{grown} MiB");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn too_many_at_once_are_turned_away_at_once_and_the_rest_are_served() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    let mut waiting = Vec::new();
    for sent in 0..1100 {
        if sent % 100 == 0 {
            // What was sent before this has arrived before it: no queue on the way runs over.
            client.get("a", "status").await;
        }
        let selector = "jostle/a/get/wait?phase=running";
        let query = client.session.get(selector).timeout(2 * PATIENCE);
        waiting.push(query.await.unwrap());
    }
    // 1024 of them may wait.
    client.get("a", "status").await;
    client.ok("a", "run", json!({})).await;
    let (mut served, mut busy) = (0, 0);
    for replies in waiting {
        match replies.recv_async().await.unwrap().into_result() {
            Ok(_) => served += 1,
            Err(error) => {
                let error: Value = serde_json::from_slice(&error.payload().to_bytes()).unwrap();
                assert_eq!(error["code"], "busy", "{error}");
                busy += 1;
            }
        }
    }
    assert_eq!((served, busy), (1024, 76));
    daemon.stop().await;
}

/// Runs one of the tests of this folder, which are none by themselves, as a process of its own, until
/// it prints a line with `word`; returns what follows that.
fn helper(nice: &str, test: &str, asked: &str, word: &str) -> (Process, String, Output) {
    let mut command = Command::new("nice");
    command
        .args(["-n", nice])
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", &format!("load::{test}"), "--nocapture"])
        .env("JOSTLE_TEST_HELPER", asked)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped());
    let mut process = Process::of(&mut command);
    let mut output = BufReader::new(process.0.stdout.take().unwrap()).lines();
    let told = find(&mut output, word);
    (process, told, output)
}

type Output = Lines<BufReader<ChildStdout>>;

/// What follows `word` in the next line that has it.
fn find(output: &mut Output, word: &str) -> String {
    let mut found = output.filter_map(|line| line.unwrap().split_once(word).map(|it| it.1.into()));
    found.next().unwrap()
}

/// Sends `count` commands without waiting for answers in between; counts what came back.
async fn flood(client: &Client, count: usize) -> (usize, usize) {
    let (mut answered, mut busy) = (0, 0);
    for _ in 0..count / 1000 {
        let mut pending = Vec::new();
        for _ in 0..1000 {
            let replies = client
                .session
                .get("jostle/flooded/cmd/set")
                .payload("{\"pi3\": 1}")
                .timeout(2 * PATIENCE)
                .await
                .unwrap();
            pending.push(replies);
        }
        for replies in pending {
            match replies.recv_async().await.unwrap().into_result() {
                Ok(_) => answered += 1,
                Err(error) => {
                    let error: Value = serde_json::from_slice(&error.payload().to_bytes()).unwrap();
                    assert_eq!(error["code"], "busy", "{error}");
                    busy += 1;
                }
            }
        }
    }
    (answered, busy)
}

/// Memory of this process, daemon and clients together.
fn resident_bytes() -> u64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap();
    let pages: u64 = statm.split(' ').nth(1).unwrap().parse().unwrap();
    pages * 4096
}
