//! A daemon that executes commands, its backups and their content.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde_json::{Value, json};

use crate::support::daemon_process::{DaemonProcess, daemon};
use crate::support::process::jostled;
use crate::support::{Client, NODE, PREFIX, TIMEOUT};

/// Runs that end within some seconds on an idle machine.
pub(super) const EXPERIMENT: &str = "name = \"order\"\nseed = 3\nreplicates = 3\nduration = 100\n[[grid]]\n\
    pi1 = [1, 4]\nn = [10, 20]\ninformed = [0, 1]\n[measure]\norder_every = 10\n";

/// Swarms that run, each at its own rate, and one that is paused.
pub(super) const RUNNING: [&str; 3] = ["slow", "fast", "fastest"];

pub(super) const STANDING: &str = "standing";

pub(super) fn arguments(verb: &str, folder: &Path, data: &Path) -> Command {
    let mut command = jostled(&[verb, "--json"]);
    command.arg(folder).arg("--data-dir").arg(data);
    command.stderr(Stdio::piped()).stdout(Stdio::piped());
    command
}

pub(super) fn outcome(output: &Output) -> Result<Value, String> {
    let text = String::from_utf8(output.stderr.clone()).unwrap();
    match output.status.code() {
        Some(0) => Ok(serde_json::from_slice(&output.stdout).unwrap()),
        Some(1) => Err(text),
        code => panic!("{code:?}: {text}"),
    }
}

pub(super) fn take(data: &Path, folder: &Path) -> Result<Value, String> {
    outcome(&arguments("backup", folder, data).output().unwrap())
}

pub(super) fn restore(folder: &Path, data: &Path) -> Result<Value, String> {
    outcome(&arguments("restore", folder, data).output().unwrap())
}

/// Starts a backup that sleeps `millis` each time at a failpoint.
pub(super) fn take_pausing(data: &Path, folder: &Path, point: &str, millis: u32) -> Child {
    let mut command = arguments("backup", folder, data);
    command.env("FAILPOINTS", format!("{point}=sleep({millis})"));
    command.spawn().unwrap()
}

pub(super) async fn begin(data: &Path, points: &str) -> (DaemonProcess, Client) {
    let process = DaemonProcess::start(daemon(data).env("FAILPOINTS", points)).unwrap();
    let client = Client::open(&process.endpoint).await;
    (process, client)
}

pub(super) async fn node(client: &Client, verb: &str, request: Value) -> Value {
    let key = keys::node_cmd(PREFIX, NODE, verb);
    let answer = client
        .query(&key, Some(request.to_string().as_bytes()))
        .await;
    answer.unwrap_or_else(|error| panic!("{verb} {request}: {error:?}"))
}

pub(super) async fn create_swarms(client: &Client) {
    for (k, name) in RUNNING.into_iter().enumerate() {
        let rates = [json!(1), json!(5), json!(null)];
        let spec = json!({"n": 12, "seed": k, "rate": rates[k], "publish_every": 1});
        client.create(name, spec).await;
        client.ok(name, "run", json!({})).await;
    }
    client.create(STANDING, json!({"n": 8, "seed": 9})).await;
}

/// Sends commands to all swarms for a while.
pub(super) async fn send_commands_for(client: &Client, time: Duration) {
    let is_ended = AtomicBool::new(false);
    let ending = async {
        tokio::time::sleep(time).await;
        is_ended.store(true, Ordering::Relaxed);
    };
    tokio::join!(ending, send_commands(client, &is_ended));
}

/// Sends commands to all swarms until `is_ended`. Returns how many got a reply, and the longest
/// time until one.
pub(super) async fn send_commands(client: &Client, is_ended: &AtomicBool) -> (u64, Duration) {
    let (mut count, mut longest) = (0, Duration::ZERO);
    while !is_ended.load(Ordering::Relaxed) {
        for swarm in RUNNING.into_iter().chain([STANDING]) {
            let start = Instant::now();
            let pi2 = 0.5 + (count % 7) as f64 / 100.0;
            client.ok(swarm, "set", json!({"args": {"pi2": pi2}})).await;
            longest = longest.max(start.elapsed());
            count += 1;
        }
        client.ok(STANDING, "step", json!({"steps": 3})).await;
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    (count, longest)
}

pub(super) async fn journal(client: &Client, swarm: &str) -> Vec<Value> {
    let mut all: Vec<Value> = Vec::new();
    loop {
        let after = all.last().map_or(json!(0), |entry| entry["seq"].clone());
        let page = client
            .get(swarm, &format!("journal?after={after};limit=500"))
            .await;
        let page = page["result"]["entries"].as_array().unwrap().clone();
        match page.is_empty() {
            true => return all,
            false => all.extend(page),
        }
    }
}

/// The hash of a swarm at a step of its past.
pub(super) async fn hash_at(client: &Client, swarm: &str, step: u64) -> Value {
    let name = format!("{swarm}-at-{step}");
    // The replay to that step takes longer than a reply may on a machine that does other things.
    let request = json!({"timeout_secs": 60, "args": {"name": name, "step": step}});
    client.ok(swarm, "fork", request).await;
    let status = client.get(&name, "status").await;
    client.ok(&name, "delete", json!({})).await;
    assert_eq!(status["step"], step, "{status}");
    status["result"]["state_hash"].clone()
}

pub(super) async fn experiment(client: &Client, phase: &str) -> Value {
    let key = keys::experiment(PREFIX, NODE, "order", "progress");
    let deadline = Instant::now() + 6 * TIMEOUT;
    loop {
        let progress = client.query(&key, None).await.unwrap();
        if progress["phase"] == phase {
            return progress;
        }
        assert!(Instant::now() < deadline, "{progress} is not {phase}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

pub(super) async fn recording(client: &Client) -> Value {
    let mut list = client.node("recordings").await;
    list["recordings"][0].take()
}

/// Every file below a folder with its content.
pub(super) fn content(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(content(&path)),
            false => _ = found.insert(path.clone(), fs::read(path).unwrap()),
        }
    }
    found
}

/// An entry of the journal without the wall-clock time.
pub(super) fn without_time(entry: &Value) -> Value {
    let mut entry = entry.clone();
    entry.as_object_mut().unwrap().remove("unix_secs");
    entry
}
