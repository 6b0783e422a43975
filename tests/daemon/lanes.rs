//! Work that takes long delays no work of another kind, and ends with its clients.

use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};
use zenoh::bytes::Encoding;

use crate::experiments::{ok, submit};
use crate::support::daemon_process::{self, DaemonProcess};
use crate::support::http::{get, of_daemon};
use crate::support::limited_daemon::LimitedDaemon;
use crate::support::recording::{self, start_daemon};
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

/// Creates the swarm `a`, whose replay takes seconds on each machine.
async fn create_with_long_history(client: &Client) {
    client.create("a", json!({"n": 50, "rate": null})).await;
    // In parts: on a busy machine, all of it takes longer than a request may.
    for _ in 0..20 {
        let part = json!({"timeout_secs": 60, "args": {"steps": 10_000}});
        client.ok("a", "step", part).await;
    }
}

/// A metric of the lane of replays.
fn lane(address: &str, what: &str) -> f64 {
    let (_, _, text) = get(address, "/metrics");
    let name = format!("jostle_lane_{what}{{lane=\"replays\"}} ");
    let line = text.lines().find_map(|line| line.strip_prefix(&name));
    line.unwrap().parse().unwrap()
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

    // The audit log has the outcome that the client got, also of the fork that was under way.
    let codes = [
        ("ok", expected.len() - 1),
        ("deadline_exceeded", late),
        ("busy", busy),
    ];
    let codes = codes.map(|(code, count)| (code.to_owned(), count as u64));
    until("the audit log has the outcomes", async || {
        let audit = client.node("audit").await["lines"].take();
        let forks = audit.as_array().unwrap().iter();
        let forks = forks.filter(|line| line["verb"] == "fork");
        let mut outcomes = BTreeMap::new();
        for outcome in forks.flat_map(|line| line["outcomes"].as_array().unwrap()) {
            let code = outcome["outcome"].as_str().unwrap().to_owned();
            *outcomes.entry(code).or_default() += outcome["count"].as_u64().unwrap();
        }
        outcomes == BTreeMap::from(codes.clone())
    })
    .await;
    process.kill();
}

/// How a client closes its connection before it has a reply.
#[derive(Clone, Copy, Debug)]
enum End {
    Close,
    /// The client has asked for the connection to be closed after the reply.
    CloseWithoutKeepAlive,
    HalfClose,
}

/// Sends a command over HTTP, and closes the connection before the reply.
fn post_and_close(daemon: &LimitedDaemon, path: &str, request: &Value, end: End) {
    let (address, token, body) = (daemon.address, &daemon.token, request.to_string());
    let connection = match end {
        End::CloseWithoutKeepAlive => "Connection: close\r\n",
        _ => "",
    };
    let request = format!(
        "POST /api/{path} HTTP/1.1\r\nHost: {address}\r\n{connection}Authorization: Bearer {token}\r\n\
         Content-Length: {}\r\n\r\n{body}",
        body.len()
    );
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    stream.set_nonblocking(true).unwrap();
    std::thread::sleep(Duration::from_millis(100));
    let early = stream.read(&mut [0; 64]);
    assert!(early.is_err(), "the reply came first: {early:?}");
    if matches!(end, End::HalfClose) {
        stream.shutdown(Shutdown::Write).unwrap();
        stream.set_nonblocking(false).unwrap();
        let mut reply = String::new();
        // Closed without a reply.
        let _ = stream.read_to_string(&mut reply);
        assert_eq!(reply, "");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fork_and_a_replay_end_when_their_http_connection_does() {
    let points = "lane-replays=sleep(1000);lane-files=sleep(1000)";
    let daemon = LimitedDaemon::serve("http", points);
    let client = Client::open(&daemon.endpoint).await;
    recording::begin(&client, "a", "tape").await;
    client.ok("a", "step", json!({"steps": 100})).await;
    recording::stop(&client, "tape").await;
    let ends = [End::Close, End::CloseWithoutKeepAlive, End::HalfClose];
    let mut number = 0;
    for end in ends {
        let fork = json!({"name": format!("fork-{end:?}").to_lowercase(), "step": 50});
        let open = json!({"name": format!("open-{end:?}").to_lowercase(), "recording": "tape"});
        for (path, args) in [("cmd/a/fork", fork), ("node/replay", json!({"open": open}))] {
            let request = json!({"timeout_secs": 60, "args": args});
            post_and_close(&daemon, path, &request, end);
            number += 1;
        }
    }
    // What does not wait for its client is executed all the same.
    let kept = json!({"name": "kept", "step": 50});
    let kept = json!({"request_id": "1", "timeout_secs": 60, "args": kept});
    post_and_close(&daemon, "cmd/a/fork", &kept, End::Close);
    until("the fork with an id is created", async || {
        swarms(&client).await.contains(&"kept".to_owned())
    })
    .await;
    until("the others have ended", async || {
        let mut ended = 0.0;
        for lane in ["replays", "files"] {
            for what in ["executed", "dropped"] {
                let name = format!("jostle_lane_{what}_total{{lane=\"{lane}\"}}");
                ended += daemon.metric(&name).await;
            }
        }
        ended >= f64::from(number) + 1.0
    })
    .await;
    assert_eq!(swarms(&client).await, ["a", "kept"]);
    let mut audit = client.node("audit").await["lines"].take();
    let lines = audit.as_array_mut().unwrap();
    lines.retain(|line| line["name"] != "a" && line["name"] != "tape");
    assert_eq!(lines.len(), 7, "{lines:?}");
    for line in lines {
        let expected = if line["name"] == "kept" {
            "ok"
        } else {
            "abandoned"
        };
        assert_eq!(line["outcomes"][0]["outcome"], expected, "{line}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_verify_of_a_client_that_is_gone_ends_at_its_deadline() {
    let daemon = Daemon::start().await;
    let (client, address) = (&daemon.client, of_daemon(&daemon));
    create_with_long_history(client).await;
    let gone = daemon.another_client().await;
    let key = keys::get(PREFIX, "a", "verify");
    // One at a time is executed: the first of them, until the deadlines of the others have passed.
    for secs in [3, 1, 1, 1, 1, 1, 1, 1] {
        let query = gone.session.get(format!("{key}?timeout_secs={secs}"));
        query.timeout(Duration::from_secs(60)).await.unwrap();
    }
    let states = ["running", "queued", "dropped_total", "executed_total"];
    until("they have arrived", async || {
        states.map(|what| lane(&address, what)).iter().sum::<f64>() >= 8.0
    })
    .await;
    gone.session.close().await.unwrap();
    until_within(PROMPT * 2, "the replays end", async || {
        lane(&address, "running") + lane(&address, "queued") == 0.0
    })
    .await;
    let ended = ["dropped_total", "executed_total"].map(|what| lane(&address, what));
    assert_eq!(ended, [7.0, 1.0]);
    // Otherwise the replay was over before its deadline, and nothing was shown.
    let executed = lane(&address, "executed_seconds_total");
    assert!(executed > 2.5, "it was executed for {executed} s");

    let error = client.query(&format!("{key}?timeout_secs=0.2"), None).await;
    let error = error.unwrap_err();
    assert_eq!(error.code, ErrorCode::DeadlineExceeded, "{error:?}");
    assert_eq!(error.details["after_secs"], 0.2, "{error:?}");
    assert_eq!(
        error.message,
        "not done within 0.2 s: the replay has ended; timeout_secs waits longer"
    );
    for invalid in ["0", "3601", "soon", "nan"] {
        let selector = format!("{key}?timeout_secs={invalid}");
        let error = client.query(&selector, None).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{error:?}");
        assert_eq!(error.details["field"], "timeout_secs", "{error:?}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_says_what_becomes_of_the_work() {
    let points = "lane-replays=sleep(1000);lane-files=sleep(1000);lane-experiments=sleep(1000)";
    let (mut process, client, _data) = start(points).await;
    client.create("a", json!({"n": 5})).await;
    client.ok("a", "step", json!({"steps": 100})).await;
    let fork = |id: Option<&str>, name: &str| {
        let args = json!({"name": name, "step": 50});
        let request = json!({"request_id": id, "timeout_secs": 0.1, "args": args}).to_string();
        (keys::cmd(PREFIX, "a", "fork"), Some(request))
    };
    let node = |verb: &str, id: Option<&str>, args: Value| {
        let request = json!({"request_id": id, "timeout_secs": 0.1, "args": args}).to_string();
        (keys::node_cmd(PREFIX, NODE, verb), Some(request))
    };
    let open = json!({"open": {"name": "b", "recording": "none"}});
    let cancel = json!({"cancel": {"name": "none"}});
    let (ended, goes_on) = ("created nothing", "the work goes on");
    for ((key, request), expected) in [
        (fork(None, "f"), ended),
        (fork(Some("1"), "g"), goes_on),
        (node("replay", None, open.clone()), ended),
        (node("replay", Some("2"), open), goes_on),
        (node("experiment", None, cancel), goes_on),
        (
            (
                format!("{}?timeout_secs=0.1", keys::get(PREFIX, "a", "verify")),
                None,
            ),
            "the replay has ended",
        ),
    ] {
        let reply = client.query(&key, request.as_deref().map(str::as_bytes));
        let error = reply.await.unwrap_err();
        assert_eq!(error.code, ErrorCode::DeadlineExceeded, "{key}: {error:?}");
        assert!(error.message.contains(expected), "{key}: {error:?}");
        // `get/wait` is of a swarm, and waits for none of these.
        assert!(!error.message.contains("get/wait"), "{key}: {error:?}");
    }
    process.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_verify_ends_when_its_http_connection_does() {
    let daemon = Daemon::start().await;
    let (client, address) = (&daemon.client, of_daemon(&daemon));
    create_with_long_history(client).await;
    let verify = || {
        let mut stream = TcpStream::connect(&address).unwrap();
        let request = format!("GET /api/get/a/get/verify HTTP/1.1\r\nHost: {address}\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        stream
    };
    let first = verify();
    until("it is executed", async || lane(&address, "running") == 1.0).await;
    let others: Vec<TcpStream> = (0..7).map(|_| verify()).collect();
    until("the others are queued", async || {
        lane(&address, "queued") == 7.0
    })
    .await;
    drop(others);
    until_within(PROMPT, "the others are dropped", async || {
        lane(&address, "dropped_total") == 7.0
    })
    .await;
    assert_eq!(lane(&address, "running"), 1.0, "it was over before");
    drop(first);
    until_within(PROMPT, "it ends", async || {
        lane(&address, "executed_total") == 1.0
    })
    .await;
    assert_eq!(lane(&address, "dropped_total"), 7.0);
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

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_disconnects_early_leaves_no_error_in_the_log() {
    let data = tempfile::tempdir().unwrap();
    let mut command = daemon_process::daemon(data.path());
    let points = "lane-files=sleep(500)";
    command
        .env("JOSTLED_HTTP", "127.0.0.1:0")
        .env("FAILPOINTS", points);
    let mut process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    client.create("a", json!({"n": 5})).await;
    let hello = client.node("hello").await;
    let address = hello["http"].as_str().unwrap().replace("http://", "");
    for _ in 0..4 {
        let mut stream = TcpStream::connect(&address).unwrap();
        let request = format!("GET /api/get/a/get/journal HTTP/1.1\r\nHost: {address}\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        std::thread::sleep(Duration::from_millis(50));
    }
    // Two were under way when their connections were closed, and are replied to all the same.
    let name = "jostle_lane_executed_total{lane=\"files\"} 2";
    until("the pages are read", async || {
        get(&address, "/metrics").2.contains(name)
    })
    .await;
    // The replies are sent in order, so those of the pages are sent before this one.
    client.get("a", "status").await;
    process.stop();
    process.end();
    let log = daemon_process::log(data.path());
    assert!(!log.contains("ERROR"), "{log}");
}
