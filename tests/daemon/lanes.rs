//! Work that takes long delays no work of another kind, and ends with its clients.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};
use zenoh::bytes::Encoding;

use crate::experiments::{ok, submit};
use crate::support::daemon_process::DaemonProcess;
use crate::support::http::{get, of_daemon};
use crate::support::limited_daemon::LimitedDaemon;
use crate::support::recording::start_daemon;
use crate::support::{Client, Daemon, NODE, PREFIX, result_of, until, until_within};

/// The bound for what is never to wait behind long work.
const PROMPT: Duration = Duration::from_secs(2);

async fn start(points: &str) -> (DaemonProcess, Client, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let (process, client) = start_daemon(folder.path(), points).await;
    (process, client, folder)
}

/// The names of the swarms.
async fn swarms(client: &Client) -> Vec<String> {
    let swarms = client.node("swarms").await["swarms"].clone();
    let swarms: Vec<Value> = serde_json::from_value(swarms).unwrap();
    let names = swarms.iter().map(|it| it["swarm"].as_str().unwrap());
    names.map(str::to_owned).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancel_does_not_wait_behind_128_abandoned_pages() {
    let (mut process, viewer, _data) = start("lane-files=sleep(5000)").await;
    let operator = Client::open(&process.endpoint).await;
    operator.create("a", json!({"n": 5})).await;
    let endless = "name = 'endless'\nduration = 1e6\n[[grid]]\nn = [20, 30]\n";
    submit(&operator, endless).await;
    let page = keys::experiment(PREFIX, NODE, "endless", "results");
    let mut abandoned = Vec::new();
    for _ in 0..128 {
        let query = viewer.session.get(&page).timeout(Duration::from_secs(100));
        abandoned.push(query.await.unwrap());
    }
    // A query sent after the pages arrives after them.
    viewer.get("a", "status").await;
    let begun = Instant::now();
    let status = operator.get("a", "status").await;
    assert_eq!(status["result"]["n"], 5);
    let took = begun.elapsed();
    assert!(took < PROMPT / 2, "status took {took:?}");
    ok(&operator, json!({"cancel": {"name": "endless"}})).await;
    let took = begun.elapsed();
    assert!(took < PROMPT, "cancel took {took:?}");
    let waiting = abandoned.iter().filter(|it| it.is_empty()).count();
    assert!(waiting > 100, "nothing was measured: {waiting} wait");
    process.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn forks_at_once_are_bounded_and_create_nothing_without_their_clients() {
    const FORKS: usize = 64;
    let (mut process, client, _data) = start("lane-replays=sleep(200)").await;
    client.create("a", json!({"n": 5})).await;
    client.ok("a", "step", json!({"steps": 100})).await;
    let threads = process.threads();
    let mut sent = Vec::new();
    for number in 0..FORKS {
        let args = json!({"name": format!("fork-{number}"), "step": 50});
        let request = json!({"timeout_secs": 1, "args": args}).to_string();
        let query = client.session.get(keys::cmd(PREFIX, "a", "fork"));
        let query = query.payload(request).encoding(Encoding::APPLICATION_JSON);
        sent.push(query.await.unwrap());
    }
    tokio::time::sleep(Duration::from_millis(500)).await;
    let more = process.threads() - threads;
    assert!(more < 8, "{more} threads more");
    let mut forks = Vec::new();
    for fork in sent {
        forks.push(result_of(fork.recv_async().await.unwrap()));
    }
    let mut expected = vec!["a".to_owned()];
    let (mut late, mut busy) = (0, 0);
    for (number, fork) in forks.iter().enumerate() {
        match fork {
            Ok(_) => expected.push(format!("fork-{number}")),
            Err(error) if error.code == ErrorCode::DeadlineExceeded => late += 1,
            Err(error) => {
                assert_eq!(error.code, ErrorCode::Busy, "{error:?}");
                busy += 1;
            }
        }
    }
    assert!(busy >= 20 && late >= 20, "{busy} busy, {late} late");
    assert!(expected.len() > 1, "none was created");
    expected.sort();

    // With a `request_id` the client learns by sending it again that it was created after the deadline.
    let args = json!({"name": "kept", "step": 50});
    let named = |secs: f64| {
        let request = json!({"request_id": "1", "timeout_secs": secs, "args": args});
        client.cmd("a", "fork", request)
    };
    let error = named(0.1).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::DeadlineExceeded, "{error:?}");
    named(20.0).await.unwrap();
    expected.push("kept".to_owned());
    let mut there = swarms(&client).await;
    there.sort();
    assert_eq!(there, expected);
    process.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_verify_ends_when_its_http_connection_does() {
    let daemon = Daemon::start().await;
    let (client, address) = (&daemon.client, of_daemon(&daemon));
    client.create("a", json!({"n": 50, "rate": null})).await;
    let long = json!({"timeout_secs": 60, "args": {"steps": 40_000}});
    client.ok("a", "step", long).await;
    let mut streams = Vec::new();
    for _ in 0..8 {
        let mut stream = TcpStream::connect(&address).unwrap();
        let request = format!("GET /api/get/a/get/verify HTTP/1.1\r\nHost: {address}\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        streams.push(stream);
    }
    let lane = |what: &str| {
        let (_, _, text) = get(&address, "/metrics");
        let name = format!("jostle_lane_{what}{{lane=\"replays\"}} ");
        let line = text.lines().find_map(|line| line.strip_prefix(&name));
        line.unwrap().parse::<f64>().unwrap()
    };
    until("they are under way", async || {
        lane("running") + lane("queued") >= 8.0
    })
    .await;
    drop(streams);
    until_within(PROMPT, "the replays end", async || {
        lane("running") + lane("queued") == 0.0
    })
    .await;
    let ended = lane("dropped_total") + lane("executed_total");
    assert!(
        ended >= 8.0 && lane("dropped_total") >= 6.0,
        "{ended} ended"
    );
    let status = client.get("a", "status").await;
    assert_eq!(status["result"]["verifying"], Value::Null);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_http_request_waits_for_its_own_deadline() {
    const SECS: u64 = 100;
    let daemon = LimitedDaemon::serve("http", "command=sleep(120000)");
    let (address, token) = (daemon.address, daemon.token.clone());
    let body = json!({"timeout_secs": SECS, "args": {"pi3": 2}}).to_string();
    let request = format!(
        "POST /api/cmd/a/set HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nAuthorization: \
         Bearer {token}\r\nContent-Length: {}\r\n\r\n{body}",
        body.len()
    );
    let waiting = tokio::task::spawn_blocking(move || {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let (begun, mut reply) = (Instant::now(), String::new());
        stream.read_to_string(&mut reply).unwrap();
        (begun.elapsed(), reply)
    });
    let (took, reply) = waiting.await.unwrap();
    assert!(took >= Duration::from_secs(SECS), "{took:?}: {reply}");
    let (head, body) = reply.split_once("\r\n\r\n").unwrap();
    assert!(head.starts_with("HTTP/1.1 504 "), "{head}");
    let error: Value = serde_json::from_str(body).unwrap();
    assert_eq!(error["code"], "deadline_exceeded", "{error}");
    assert_eq!(error["details"]["after_secs"], 100.0, "{error}");
}
