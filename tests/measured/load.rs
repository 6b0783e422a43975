//! Many swarms, many commands, slow clients: none delays another or uses its memory.

mod clients;
mod flood;
mod followers;

use std::io::{BufRead, BufReader, Lines};
use std::process::{ChildStdout, Command, Stdio};
use std::time::Duration;

use jostle_proto::keys;
use serde_json::{Value, json};

use crate::support::process::Process;
use crate::support::{Client, Daemon, NODE, PREFIX, TIMEOUT, until};

#[tokio::test(flavor = "multi_thread")]
async fn of_three_hundred_swarms_none_starves() {
    const SWARMS: usize = 300;
    let (_daemon, endpoint) = Process::serve();
    let client = Client::open(&endpoint).await;
    for i in 0..SWARMS {
        let name = format!("s{i}");
        // Other processes of the machine may use the cores for long.
        let spec = json!({"n": 20, "seed": i, "rate": 1});
        let request = json!({"timeout_secs": 60, "args": {"name": name, "spec": spec}});
        let key = keys::node_cmd(PREFIX, NODE, "create");
        let request = request.to_string();
        client.query(&key, Some(request.as_bytes())).await.unwrap();
        // A group in contact takes more time a step.
        let request = json!({"timeout_secs": 60, "args": {"steps": 500}});
        client.ok(&name, "step", request).await;
        client.ok(&name, "run", json!({})).await;
    }
    let steps = async || -> Vec<u64> {
        let swarms = client.node("swarms").await["swarms"].take();
        let steps = swarms.as_array().unwrap().iter();
        steps.map(|it| it["step"].as_u64().unwrap()).collect()
    };
    let before = steps().await;
    tokio::time::sleep(Duration::from_secs(5)).await;
    let after = steps().await;
    assert_eq!((before.len(), after.len()), (SWARMS, SWARMS));
    let mut taken: Vec<u64> = before.iter().zip(&after).map(|(a, b)| b - a).collect();
    taken.sort_unstable();
    let mean = taken.iter().sum::<u64>() as f64 / SWARMS as f64;
    println!(
        "{} to {} steps, {mean:.1} in the mean",
        taken[0],
        taken[SWARMS - 1]
    );
    assert!(taken[0] > 0 && taken[0] as f64 > 0.5 * mean, "{taken:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn swarms_that_are_created_and_deleted_leave_no_thread_and_no_memory() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let threads = || std::fs::read_dir("/proc/self/task").unwrap().count();
    let before = threads();
    for i in 0..60 {
        let name = format!("s{i}");
        client.create(&name, json!({"n": 20, "seed": i})).await;
        client.ok(&name, "step", json!({"steps": 5})).await;
        client.ok(&name, "delete", json!({})).await;
    }
    until("the swarms' threads end", async || threads() <= before + 2).await;
    assert_eq!(client.node("status").await["memory_bytes"], 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_gets_replies_and_affects_neither_memory_nor_other_swarms() {
    let daemon = Daemon::start().await;
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
    let step = async || {
        client.get("other", "status").await["step"]
            .as_u64()
            .unwrap()
    };
    let first = step().await;
    let mut last = first;
    while !flooding.is_finished() {
        last = step().await;
    }
    let (answered, busy) = flooding.await.unwrap();
    let grown = resident_bytes().saturating_sub(before) >> 20;
    println!(
        "{answered} answered, {busy} rejected; the other swarm took {} steps; {grown} MiB more",
        last - first
    );
    assert_eq!(answered + busy, 60_000);
    assert!(last > first, "the other swarm stood still");
    assert!(grown < 150, "{grown} MiB");
    daemon.stop().await;
}

/// Starts one of the helper tests of this folder as a process of its own, and waits until
/// it prints a line with `word`. Returns the rest of that line.
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
    let rest = find(&mut output, word);
    (process, rest, output)
}

type Output = Lines<BufReader<ChildStdout>>;

/// The text after `word` in the next line that contains it.
fn find(output: &mut Output, word: &str) -> String {
    let mut found = output.filter_map(|line| line.unwrap().split_once(word).map(|it| it.1.into()));
    found.next().unwrap()
}

/// Sends `count` commands, a thousand at a time. Returns how many were executed and rejected.
async fn flood(client: &Client, count: usize) -> (usize, usize) {
    let (mut answered, mut busy) = (0, 0);
    for _ in 0..count / 1000 {
        let mut pending = Vec::new();
        for _ in 0..1000 {
            let replies = client
                .session
                .get("jostle/flooded/cmd/set")
                .payload("{\"pi3\": 1}")
                .timeout(2 * TIMEOUT)
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
