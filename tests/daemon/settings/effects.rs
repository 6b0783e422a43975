//! Observations of a daemon that show the effect of a setting.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use jostle_proto::{State, keys};
use jostled::auth::folder::Folder;
use jostled::store::{AuditLine, Settings, Store, Write};
use serde_json::{Value, json};

use super::Running;
use crate::support::http;
use crate::support::{Client, NODE, PREFIX, QueryResult, TIMEOUT};

/// How long the absence of an effect is observed.
const MOMENT: Duration = Duration::from_millis(500);

/// Provokes the effect of the setting `name` and describes it, waiting until it is `expected`.
pub async fn observe(name: &str, daemon: &Running, expected: &str) -> String {
    match name {
        "listen" => listen(daemon).await,
        "http" => http(&daemon.open().await).await,
        "node" => {
            let of = |node: &str| format!("jostle/@node/{node}/get/hello");
            which(&daemon.open().await, ["bridge", "test"], of).await
        }
        "prefix" => {
            let of = |prefix: &str| format!("{prefix}/@node/test/get/hello");
            which(&daemon.open().await, ["lab", "jostle"], of).await
        }
        "log" => log(daemon),
        "log_format" => log_format(daemon),
        "max_individuals" => max_individuals(&daemon.open().await).await,
        "max_swarms" => max_swarms(&daemon.open().await).await,
        "max_memory_mb" => max_memory_mb(&daemon.open().await).await,
        "max_clients" => max_clients(daemon).await,
        "max_hz" => max_hz(&daemon.open().await).await,
        "data_dir" => {
            let has = |folder: &&str| daemon.path(folder).join("jostle.sqlite").exists();
            let folders = ["data", "other", "base"].into_iter();
            folders.filter(has).collect::<Vec<_>>().join(", ")
        }
        "auth_dir" => auth_dir(daemon).await,
        "quota_mb" => quota_mb(&daemon.open().await, expected).await,
        "audit_mb" => audit_mb(&daemon.open().await).await,
        "audit_days" => audit_days(&daemon.open().await).await,
        "recordings_quota_mb" => recordings_quota_mb(&daemon.open().await).await,
        "experiments_quota_mb" => experiments_quota_mb(&daemon.open().await).await,
        "experiment_threads" => experiment_threads(&daemon.open().await, expected).await,
        "wasm" => wasm(&daemon.open().await).await,
        _ => format!("no way to observe {name}"),
    }
}

impl Running {
    async fn open(&self) -> Client {
        Client::open(&self.endpoint).await
    }
}

/// `ok`, or the code of the error.
fn code(answer: &QueryResult) -> String {
    match answer {
        Ok(_) => "ok".to_owned(),
        Err(error) => json!(error.code).as_str().unwrap().to_owned(),
    }
}

async fn hello(client: &Client) -> QueryResult {
    client
        .query(&keys::node_get(PREFIX, NODE, "hello"), None)
        .await
}

async fn create(client: &Client, name: &str, n: u64) -> QueryResult {
    let request = json!({"name": name, "spec": {"n": n}}).to_string();
    let key = keys::node_cmd(PREFIX, NODE, "create");
    client.query(&key, Some(request.as_bytes())).await
}

/// The `result` of a command to the daemon.
async fn node_cmd(client: &Client, verb: &str, args: Value) -> Value {
    let key = keys::node_cmd(PREFIX, NODE, verb);
    let answer = client.query(&key, Some(args.to_string().as_bytes())).await;
    answer.unwrap_or_else(|error| panic!("{verb} {args}: {error:?}"))["result"].take()
}

async fn listen(daemon: &Running) -> String {
    let socket = daemon.path("bus");
    let endpoint = format!("unixsock-stream/{}", socket.display());
    match socket.exists() {
        false => "no socket".to_owned(),
        true => match hello(&Client::open(&endpoint).await).await {
            Ok(_) => "a session over the socket".to_owned(),
            Err(error) => format!("{error:?}"),
        },
    }
}

async fn http(client: &Client) -> String {
    let hello = hello(client).await.unwrap();
    let Some(url) = hello["result"]["http"].as_str() else {
        return "no HTTP".to_owned();
    };
    let address = url.strip_prefix("http://").unwrap().to_owned();
    let (host, _) = address.rsplit_once(':').unwrap();
    format!("{host} answers {}", http::get(&address, "/healthz").0)
}

async fn wasm(client: &Client) -> String {
    let hello = hello(client).await.unwrap();
    let url = hello["result"]["http"].as_str().unwrap();
    let address = url.strip_prefix("http://").unwrap();
    let request =
        format!("HEAD /jostle.wasm HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    let (_, head, _) = http::send(address, &request);
    let hash = head
        .lines()
        .find_map(|line| line.strip_prefix("jostle-wasm-sha256: "));
    hash.unwrap_or("no module").to_owned()
}

/// The names for which the key of `key` gets a reply.
async fn which(client: &Client, names: [&str; 2], key: impl Fn(&str) -> String) -> String {
    let mut answering = Vec::new();
    for name in names {
        if client
            .query_all(&key(name), None)
            .await
            .iter()
            .any(Result::is_ok)
        {
            answering.push(name);
        }
    }
    answering.join(", ")
}

/// The kinds of lines among those that a daemon logs until it serves.
fn log(daemon: &Running) -> String {
    let text = fs::read_to_string(daemon.path("log")).unwrap();
    let has = |level: &str, target: &str| {
        let mut lines = text.lines();
        lines.any(|line| line.contains(level) && line.contains(target))
    };
    let kinds = [
        ("INFO", "jostled", "INFO of jostled"),
        ("DEBUG", "zenoh", "DEBUG of zenoh"),
    ];
    let mut logged = Vec::new();
    for (level, target, kind) in kinds {
        if has(level, &format!(" {target}:")) {
            logged.push(kind);
        }
    }
    logged.join(", ")
}

fn log_format(daemon: &Running) -> String {
    let text = fs::read_to_string(daemon.path("log")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines.iter().any(|line| line.contains("serving")), "{text}");
    let is_json = |line: &&&str| serde_json::from_str::<Value>(line).is_ok_and(|it| it.is_object());
    match lines.iter().filter(is_json).count() {
        0 => "text".to_owned(),
        count if count == lines.len() => "json".to_owned(),
        count => format!("{count} of {} lines in json", lines.len()),
    }
}

async fn max_individuals(client: &Client) -> String {
    let [seven, eight] = [
        create(client, "seven", 7).await,
        create(client, "eight", 8).await,
    ];
    format!("7: {}, 8: {}", code(&seven), code(&eight))
}

async fn max_swarms(client: &Client) -> String {
    let mut codes = Vec::new();
    for name in ["a", "b", "c"] {
        codes.push(code(&create(client, name, 2).await));
    }
    codes.join(", ")
}

/// Creates equal swarms until one is rejected, at most eight.
async fn max_memory_mb(client: &Client) -> String {
    for count in 0..8 {
        let answer = create(client, &format!("s{count}"), 2).await;
        if answer.is_ok() {
            continue;
        }
        let taken = client.node("status").await["memory_bytes"]
            .as_u64()
            .unwrap();
        let of_one = taken / u64::max(count, 1);
        let mebibytes = (taken + of_one) >> 20;
        return format!("{} at {mebibytes} MiB", code(&answer));
    }
    "ok".to_owned()
}

async fn max_clients(daemon: &Running) -> String {
    let (mut clients, mut codes) = (Vec::new(), Vec::new());
    for _ in 0..3 {
        let client = daemon.open().await;
        codes.push(code(&hello(&client).await));
        clients.push(client);
    }
    codes.join(", ")
}

/// How many steps a swarm of fifty steps a second takes from one published state to the next. States
/// that are lost on their way do not count: each bears the number under which it was published.
async fn max_hz(client: &Client) -> String {
    client
        .create("a", json!({"n": 2, "rate": 1, "publish_every": 1}))
        .await;
    let key = keys::state(PREFIX, "a");
    let states = client.session.declare_subscriber(key).await.unwrap();
    client.ok("a", "run", json!({})).await;
    let mut seen = Vec::new();
    while seen.len() < 6 {
        let sample = states.recv_async();
        let sample = tokio::time::timeout(TIMEOUT, sample).await;
        let sample = sample.expect("a state").unwrap();
        let state = State::from_cbor(&sample.payload().to_bytes()).unwrap();
        // The first published state may follow soon after that of the paused swarm.
        if state.step > 1 {
            seen.push((state.step, state.frame));
        }
    }
    let (first, last) = (seen[0], seen[5]);
    let steps = (last.0 - first.0) as f64 / (last.1 - first.1) as f64;
    match steps {
        9.0..=12.0 => "every 10th step".to_owned(),
        1.0..2.0 => "every step".to_owned(),
        _ => format!("a state each {steps} steps"),
    }
}

async fn auth_dir(daemon: &Running) -> String {
    let stranger = match Client::try_open(&daemon.endpoint).await {
        Ok(client) => code(&hello(&client).await),
        Err(_) => "no".to_owned(),
    };
    let folder = Folder::new(daemon.path("auth"));
    let mut config =
        zenoh::Config::from_file(folder.person_folder("olga").join("zenoh.json5")).unwrap();
    let endpoints = json!([daemon.endpoint]).to_string();
    config
        .insert_json5("connect/endpoints", &endpoints)
        .unwrap();
    let person = match zenoh::open(config).await {
        Ok(session) => code(&hello(&Client { session }).await),
        Err(_) => "no".to_owned(),
    };
    format!("a stranger: {stranger}, a person: {person}")
}

/// Writes 2 MiB of commands into a swarm's history, with checkpoints between them.
async fn quota_mb(client: &Client, expected: &str) -> String {
    const PART: usize = 4;
    client.create("a", json!({"n": 2, "rate": null})).await;
    let noise = json!({"verb": "set", "args": {"noise": 0.125}});
    let batch = json!({"args": {"commands": vec![noise; 64]}});
    let bytes = batch.to_string().len();
    let mut written = 0;
    for _ in 0..PART {
        let end = written + (2 << 20) / PART;
        while written < end {
            client.ok("a", "batch", batch.clone()).await;
            written += bytes;
        }
        // The daemon keeps a checkpoint at least each 10,000 steps.
        client.ok("a", "step", json!({"steps": 10_000})).await;
    }
    let began = Instant::now();
    let patience = match expected {
        "history from step 0" => MOMENT,
        _ => TIMEOUT,
    };
    while began.elapsed() < patience {
        let status = client.get("a", "status").await["result"].take();
        if status["history_from"]["step"].as_u64() > Some(0) {
            return "history from a later step".to_owned();
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    "history from step 0".to_owned()
}

/// The number of the lines of [`write_audit_lines`].
const AUDIT_LINES: u64 = 4000;

/// Writes lines of the audit log that take more than a MiB: the first ten days old, the last one day.
pub fn write_audit_lines(folder: &Path) {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    let days_ago = |days: u64| (now.as_secs() - days * 24 * 60 * 60) * 1000;
    let store = Store::open(folder, Settings::default(), Box::new(|_| {})).unwrap();
    let lines = (1..=AUDIT_LINES).map(|number| {
        let ms = days_ago(if number < AUDIT_LINES { 10 } else { 1 });
        Write::Audit(AuditLine {
            number,
            verb: "inform".to_owned(),
            name: Some("n".repeat(64)),
            first_ms: ms,
            last_ms: ms,
            body: br#"{"count": 1, "outcomes": {"ok": 1}}"#.to_vec(),
            ..AuditLine::default()
        })
    });
    store.commit(lines.collect()).unwrap();
}

/// The oldest line once a command was sent.
async fn oldest_audit_line(client: &Client) -> Value {
    client.create("a", json!({"n": 2})).await;
    let key = keys::node_get(PREFIX, NODE, "audit");
    let page = client.query(&format!("{key}?limit=1"), None).await.unwrap();
    page["result"]["lines"][0].clone()
}

async fn audit_mb(client: &Client) -> String {
    match oldest_audit_line(client).await["number"].as_u64() {
        Some(1) => "line 1 is there".to_owned(),
        Some(2..AUDIT_LINES) => "the oldest lines are gone".to_owned(),
        other => format!("{other:?}"),
    }
}

async fn audit_days(client: &Client) -> String {
    // Each command deletes a few lines of age.
    for k in 0..300 {
        let discard = json!({"client": format!("{k}"), "args": {"name": "none"}}).to_string();
        let key = keys::node_cmd(PREFIX, NODE, "discard");
        client
            .query(&key, Some(discard.as_bytes()))
            .await
            .unwrap_err();
    }
    let oldest = oldest_audit_line(client).await;
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    let days = (now.as_secs_f64() - oldest["unix_secs"].as_f64().unwrap()) / 86_400.0;
    format!("lines of {} days", days.round())
}

async fn recordings_quota_mb(client: &Client) -> String {
    client.create("a", json!({"n": 100, "rate": null})).await;
    let begin = json!({"begin": {"swarm": "a", "recording": "take", "every": 1}});
    node_cmd(client, "record", begin).await;
    client.ok("a", "run", json!({})).await;
    let began = Instant::now();
    while began.elapsed() < TIMEOUT {
        let take = client.node("recordings").await["recordings"][0].take();
        let bytes = take["bytes"].as_u64().unwrap();
        let is_ended = take["phase"] != "recording";
        if is_ended && bytes > 1 << 19 && bytes <= 1 << 20 {
            return "ended within 1 MiB".to_owned();
        }
        if is_ended {
            return take.to_string();
        }
        if bytes > 3 << 19 {
            return "goes on beyond 1 MiB".to_owned();
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    "neither ends nor goes on".to_owned()
}

/// An experiment that records more than a MiB, unless it stops before.
async fn experiments_quota_mb(client: &Client) -> String {
    let toml = "name = 'films'\nduration = 200\n[measure]\nrecord_every = 1\n[spec]\nn = 100\n[stop]\nwhen \
                = 'order > 2'\n";
    node_cmd(client, "experiment", json!({"submit": {"toml": toml}})).await;
    let key = keys::experiment(PREFIX, NODE, "films", "progress");
    let began = Instant::now();
    while began.elapsed() < TIMEOUT {
        let progress = client.query(&key, None).await.unwrap();
        // Later, so that it counts what was written until the pause.
        let bytes = client.node("metrics").await["experiments_bytes"].as_u64();
        let bytes = bytes.unwrap();
        if progress["phase"] == "paused" && bytes > 1 << 19 && bytes <= 1 << 20 {
            return "paused within 1 MiB".to_owned();
        }
        if bytes > 1 << 20 {
            return "goes on beyond 1 MiB".to_owned();
        }
        if !["queued", "running"].contains(&progress["phase"].as_str().unwrap()) {
            return progress.to_string();
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    "neither stops nor goes on".to_owned()
}

/// The maximum number of concurrent runs, of an experiment with eight runs that do not end.
async fn experiment_threads(client: &Client, expected: &str) -> String {
    let toml = "name = 'long'\nreplicates = 8\nduration = 1e6\n[[grid]]\nn = 20\n";
    node_cmd(client, "experiment", json!({"submit": {"toml": toml}})).await;
    let key = keys::experiment(PREFIX, NODE, "long", "progress");
    let (began, mut most) = (Instant::now(), 0);
    let mut reached = None;
    // All threads start at once: one more than expected would start soon.
    while began.elapsed() < TIMEOUT && reached.is_none_or(|at: Instant| at.elapsed() < MOMENT) {
        let progress = client.query(&key, None).await.unwrap();
        most = usize::max(most, progress["running"].as_array().map_or(0, Vec::len));
        if most.to_string() == expected {
            reached.get_or_insert_with(Instant::now);
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    most.to_string()
}
