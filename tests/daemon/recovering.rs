//! What clients see while a daemon recovers its swarms after a start.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use jostle_client::proto::verbs::PauseArgs;
use jostle_client::{Client as RustClient, CommandOptions, ConnectOptions, Error as ClientError};
use jostle_client::{FollowOptions, proto};
use jostle_proto::{Error, ErrorCode, keys};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::free_ports;
use crate::support::daemon_process::{DaemonProcess, daemon};
use crate::support::process::jostled;
use crate::support::supervisor::Supervisor;
use crate::support::{Client, NODE, PREFIX, QueryResult, TIMEOUT, http, until, websocket};

/// The swarms, in the order in which they are recovered.
const SWARMS: [&str; 8] = ["s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7"];

/// The recovery of four swarms, a long pause, and that of the others.
const SLOW: &str = "recover-swarm=4*sleep(100)->1*sleep(6000)->off";
/// As [`SLOW`], with a pause that a test waits for.
const PAUSED: &str = "recover-swarm=4*sleep(100)->1*sleep(2000)->off";

/// A daemon that is killed and started again on the same ports.
struct Place {
    folder: TempDir,
    endpoint: String,
    http: String,
}

/// A daemon that is killed when dropped.
struct Started(Child);

impl Drop for Started {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Place {
    fn new() -> Self {
        let [endpoint, http] = free_ports("127.0.0.1");
        Place {
            folder: tempfile::tempdir().unwrap(),
            endpoint: format!("tcp/127.0.0.1:{endpoint}"),
            http: format!("127.0.0.1:{http}"),
        }
    }

    fn command(&self) -> Command {
        let mut command = jostled(&["serve", "--listen", &self.endpoint, "--node", NODE]);
        command.args(["--http", &self.http]);
        command.arg("--data-dir").arg(self.folder.path());
        command.stdout(Stdio::null());
        command
    }

    /// Starts a daemon that fails at these points, without waiting for it.
    fn start(&self, points: &str) -> Started {
        Started(self.command().env("FAILPOINTS", points).spawn().unwrap())
    }

    /// A daemon with the swarms, and a client of it.
    async fn with_swarms() -> (Self, Started, Client) {
        let place = Place::new();
        let started = place.start("");
        let client = place.client().await;
        for swarm in SWARMS {
            client.create(swarm, json!({"n": 3})).await;
        }
        (place, started, client)
    }

    /// A daemon that was killed, and recovers its swarms; and a client of it.
    async fn recovering(points: &str) -> (Self, Started, Client) {
        let (place, started, client) = Self::with_swarms().await;
        drop((started, client));
        let started = place.start(points);
        let client = place.connected().await;
        (place, started, client)
    }

    /// A client of a daemon that may recover its swarms.
    async fn connected(&self) -> Client {
        let began = Instant::now();
        loop {
            match Client::try_open(&self.endpoint).await {
                Ok(client) => return client,
                Err(error) => assert!(began.elapsed() < TIMEOUT, "{error}"),
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// A client of a daemon that has recovered its swarms.
    async fn client(&self) -> Client {
        let client = self.connected().await;
        let key = keys::node_get(PREFIX, NODE, "hello");
        until("it is ready", async || {
            let replies = client.query_all(&key, None).await;
            matches!(replies[..], [Ok(_)])
        })
        .await;
        client
    }
}

/// The number of swarms that are left, if the reply is the one during a recovery.
fn left(reply: &QueryResult) -> Option<u64> {
    let Err(error) = reply else {
        return None;
    };
    left_in(error)
}

fn left_in(error: &Error) -> Option<u64> {
    let is_busy = error.code == ErrorCode::Busy && error.details["reason"] == "recovering";
    is_busy.then(|| error.details["swarms_left"].as_u64().unwrap())
}

/// Waits until exactly the first four swarms are recovered. Until the first reply, the keys may not be
/// declared; from then on each reply is `busy`.
async fn until_four_are_left(client: &Client) -> Vec<u64> {
    let key = keys::get(PREFIX, "s7", "status");
    let mut seen = Vec::new();
    until("four swarms are left", async || {
        let replies = client.query_all(&key, None).await;
        match &replies[..] {
            [] => assert_eq!(seen, [0; 0], "no reply after the first one"),
            [reply] => {
                let left = left(reply).unwrap_or_else(|| panic!("{reply:?}"));
                seen.push(left);
            }
            more => panic!("{more:?}"),
        }
        seen.last() == Some(&4)
    })
    .await;
    seen
}

/// A request over HTTP with the token of the page: its status and its body.
fn request(place: &Place, method: &str, path: &str, body: &str) -> (u16, Value) {
    let token = std::fs::read_to_string(place.folder.path().join("page-token"));
    let token = token.unwrap_or_default();
    let request = format!(
        "{method} {path} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {}\r\n\
         Content-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}",
        place.http,
        token.trim(),
        body.len()
    );
    let (status, _, body) = http::send(&place.http, &request);
    (status, serde_json::from_str(&body).unwrap_or(Value::Null))
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_get_busy_until_the_swarms_are_recovered() {
    let (place, _started, client) = Place::recovering(SLOW).await;
    let seen = until_four_are_left(&client).await;
    assert!(seen.is_sorted_by(|a, b| a >= b), "{seen:?}");

    // Of a swarm that is to be recovered, and of swarms in general.
    let command = |args: Value| json!({"args": args}).to_string();
    let create = command(json!({"name": "s7", "spec": {"n": 3}}));
    let new = command(json!({"name": "new", "spec": {"n": 3}}));
    let fork = command(json!({"name": "s7"}));
    let node_get = |noun| (keys::node_get(PREFIX, NODE, noun), None);
    for (key, payload) in [
        (keys::state(PREFIX, "s7"), None),
        (keys::get(PREFIX, "s7", "journal"), None),
        (keys::cmd(PREFIX, "s7", "step"), Some("{}")),
        (keys::cmd(PREFIX, "s7", "delete"), Some("{}")),
        // The name may be one that is to be recovered.
        (keys::cmd(PREFIX, "s0", "fork"), Some(fork.as_str())),
        (keys::node_cmd(PREFIX, NODE, "create"), Some(&create)),
        (keys::node_cmd(PREFIX, NODE, "create"), Some(&new)),
        (keys::node_cmd(PREFIX, NODE, "record"), Some("{}")),
        (keys::node_cmd(PREFIX, NODE, "experiment"), Some("{}")),
        node_get("hello"),
        node_get("status"),
        node_get("swarms"),
        node_get("experiments"),
        node_get("recordings"),
        (keys::experiment(PREFIX, NODE, "a", "progress"), None),
    ] {
        let reply = client.query(&key, payload.map(str::as_bytes)).await;
        assert_eq!(left(&reply), Some(4), "{key}: {reply:?}");
    }
    for (method, path, body) in [
        ("GET", "/api/get/s7/get/status", ""),
        ("GET", "/api/get/@node/get/swarms", ""),
        // It is not known yet that there is no such swarm.
        ("GET", "/api/get/nobody/state", ""),
        ("POST", "/api/cmd/s7/step", "{}"),
        ("POST", "/api/node/create", create.as_str()),
    ] {
        let (status, body) = request(&place, method, path, body);
        assert_eq!(status, 429, "{path}: {body}");
        let error: Error = serde_json::from_value(body).unwrap();
        assert_eq!(left_in(&error), Some(4), "{path}");
    }
    let tab = websocket::open(&place.http, "/api/ws?swarm=s7", None).await;
    assert!(tab.is_err(), "the page would be told that s7 is gone");

    // What does not depend on the other swarms is answered.
    for noun in ["whoami", "schema", "metrics"] {
        client.node(noun).await;
    }
    let status = client.get("s0", "status").await;
    assert_eq!((&status["step"], &status["epoch"]), (&json!(0), &json!(2)));
    client.ok("s0", "step", json!({})).await;

    // Not ready, but alive.
    let (status, health) = http::health(&place.http);
    assert_eq!(status, 503, "{health}");
    let reason = &health["reasons"][0];
    assert_eq!(reason["code"], "recovering", "{health}");
    assert_eq!(reason["swarms_left"], 4, "{health}");
    let (status, _, body) = http::get(&place.http, "/livez");
    assert_eq!(status, 200, "{body}");
    let (_, _, metrics) = http::get(&place.http, "/metrics");
    assert!(metrics.contains("\njostle_recovering_swarms 4\n"));

    let client = place.client().await;
    assert_eq!(http::health(&place.http).0, 200);
    assert_eq!(http::get(&place.http, "/livez").0, 200);
    let (_, _, metrics) = http::get(&place.http, "/metrics");
    assert!(metrics.contains("\njostle_recovering_swarms 0\n"));
    let swarms = client.node("swarms").await;
    let names: Vec<_> = swarms["swarms"].as_array().unwrap().iter().collect();
    assert_eq!(names.len(), SWARMS.len(), "{swarms}");
    for (swarm, steps) in SWARMS.iter().zip([1, 0, 0, 0, 0, 0, 0, 0]) {
        let status = client.get(swarm, "status").await;
        assert_eq!(status["step"], steps, "{swarm}: a rejected step changed it");
    }
    let key = keys::node_cmd(PREFIX, NODE, "create");
    let reply = client.query(&key, Some(create.as_bytes())).await;
    assert_eq!(reply.unwrap_err().code, ErrorCode::AlreadyExists);
    let (status, _) = request(&place, "GET", "/api/get/nobody/state", "");
    assert_eq!(status, 404);
}

/// Sends a request until its reply is not `busy`. Every reply before is.
async fn retried(client: &Client, key: &str, request: &Value) -> QueryResult {
    let began = Instant::now();
    loop {
        let replies = client
            .query_all(key, Some(request.to_string().as_bytes()))
            .await;
        match replies.into_iter().next() {
            Some(reply) if left(&reply).is_none() => return reply,
            // Without a reply the keys are not declared yet.
            _ => assert!(began.elapsed() < TIMEOUT, "{key}"),
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_retry_after_a_kill_gets_the_first_reply() {
    let (place, started, client) = Place::with_swarms().await;
    let step = json!({"request_id": "a", "client": "c", "args": {"steps": 3}});
    let create =
        json!({"request_id": "b", "client": "c", "args": {"name": "new", "spec": {"n": 3}}});
    let delete = json!({"request_id": "d", "client": "c"});
    let fork = json!({"request_id": "f", "client": "c", "args": {"name": "forked"}});
    let sent = [
        (keys::cmd(PREFIX, "s7", "step"), &step),
        (keys::node_cmd(PREFIX, NODE, "create"), &create),
        (keys::cmd(PREFIX, "s6", "delete"), &delete),
        (keys::cmd(PREFIX, "s0", "fork"), &fork),
    ];
    let mut first = Vec::new();
    for (key, request) in &sent {
        let reply = client
            .query(key, Some(request.to_string().as_bytes()))
            .await;
        first.push(without_durable_step(reply));
    }
    drop((started, client));
    let _started = place.start(PAUSED);
    let client = place.connected().await;
    for ((key, request), first) in sent.iter().zip(first) {
        let again = retried(&client, key, request).await;
        assert_eq!(without_durable_step(again), first, "{key}");
    }
    let client = place.client().await;
    let status = client.get("s7", "status").await;
    assert_eq!(status["step"], 3, "it was executed twice");
    let journal = client.get("s7", "journal").await;
    assert_eq!(journal["result"]["entries"].as_array().unwrap().len(), 1);
    let key = keys::get(PREFIX, "s6", "status");
    assert_eq!(client.query_all(&key, None).await.len(), 0, "it is deleted");
}

/// A reply without the last step that is durable, which grows.
fn without_durable_step(reply: QueryResult) -> Value {
    let mut reply = reply.unwrap();
    if let Some(result) = reply["result"].as_object_mut() {
        result.remove("durable_step");
    }
    reply
}

/// Options with this timeout.
fn options(place: &Place, secs: f64) -> ConnectOptions {
    ConnectOptions {
        timeout: Duration::from_secs_f64(secs),
        ..ConnectOptions::to(&*place.endpoint)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_rust_client_waits_for_a_daemon_that_is_not_there_and_for_its_swarms() {
    let (place, started, client) = Place::with_swarms().await;
    drop((started, client));
    let connecting = tokio::spawn(RustClient::connect(options(&place, 30.0)));
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(!connecting.is_finished(), "there is no daemon");
    let _started = place.start(PAUSED);
    let raw = place.connected().await;
    until_four_are_left(&raw).await;

    // A client with a short timeout gets the reason.
    let error = RustClient::connect(options(&place, 0.2)).await.unwrap_err();
    let ClientError::Rejected(rejection) = &error else {
        panic!("{error:?}");
    };
    assert_eq!(left_in(rejection), Some(4));
    assert!(error.is_transient());
    // One that does not wait: its requests do.
    let impatient = RustClient::connect(ConnectOptions {
        wait: Duration::ZERO,
        ..options(&place, 30.0)
    });
    let impatient = impatient.await.unwrap();
    assert!(impatient.nodes().await.unwrap().is_empty(), "it recovers");
    let (status, node, command) = tokio::join!(
        impatient.status("s7"),
        impatient.get_node("swarms"),
        impatient.command("s6", "pause", &PauseArgs {}, CommandOptions::default()),
    );
    assert_eq!(status.unwrap().step, 0);
    let swarms: proto::NodeReply<proto::Swarms> = node.unwrap().read().unwrap();
    assert_eq!(swarms.result.swarms.len(), SWARMS.len());
    command.unwrap();

    let client = connecting.await.unwrap().unwrap();
    assert_eq!(client.swarms().await.unwrap(), SWARMS);
    let error = client.status("nobody").await.unwrap_err();
    assert!(matches!(error, ClientError::NoSwarm { .. }), "{error:?}");
    assert!(!error.is_transient());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_address_fails_within_the_timeout_and_says_how_long_it_was_tried() {
    let place = Place::new();
    let began = Instant::now();
    let error = RustClient::connect(options(&place, 0.5)).await.unwrap_err();
    assert!(began.elapsed() < TIMEOUT);
    assert!(error.to_string().contains("tried for 0.5 s"), "{error}");
    let hasty = ConnectOptions {
        wait: Duration::ZERO,
        ..options(&place, 2.0 * TIMEOUT.as_secs_f64())
    };
    let error = RustClient::connect(hasty).await.unwrap_err();
    assert!(matches!(error, ClientError::NoDaemon { .. }), "{error:?}");
    let host = ConnectOptions {
        timeout: 2 * TIMEOUT,
        ..ConnectOptions::to("tcp/no-such-host.invalid:7447")
    };
    let error = RustClient::connect(host).await.unwrap_err();
    assert!(
        matches!(error, ClientError::UnknownHost { .. }),
        "{error:?}"
    );
    assert!(began.elapsed() < 2 * TIMEOUT);
}

#[tokio::test]
async fn a_current_thread_runtime_is_an_error_with_its_remedy() {
    let error = RustClient::connect(ConnectOptions::default()).await;
    let message = error.unwrap_err().to_string();
    assert!(message.contains("flavor = \"multi_thread\""), "{message}");
}

#[tokio::test(flavor = "multi_thread")]
async fn following_a_swarm_that_does_not_exist_is_an_error() {
    let (place, _started, _client) = Place::with_swarms().await;
    let client = RustClient::connect(options(&place, TIMEOUT.as_secs_f64()))
        .await
        .unwrap();
    let following = client.follow("nobody", FollowOptions::default());
    let following = tokio::time::timeout(TIMEOUT, following).await.unwrap();
    let error = following.unwrap_err();
    assert!(matches!(error, ClientError::NoSwarm { .. }), "{error:?}");
    client.follow("s0", FollowOptions::default()).await.unwrap();
}

/// A daemon with a supervisor on this folder.
fn supervised(folder: &Path, supervisor: &Supervisor, points: &str) -> Command {
    let mut command = daemon(folder);
    command
        .env("NOTIFY_SOCKET", supervisor.folder.path().join("notify"))
        .env("FAILPOINTS", points);
    command
}

#[tokio::test(flavor = "multi_thread")]
async fn a_supervisor_is_told_of_the_recovery_and_ready_after_it() {
    let (place, started, client) = Place::with_swarms().await;
    drop((started, client));
    let supervisor = Supervisor::listen();
    let mut command = supervised(place.folder.path(), &supervisor, PAUSED);
    let process = DaemonProcess::start(&mut command).unwrap();
    let before = supervisor.receive_until("READY=1");
    let recovering = before.iter().any(|it| {
        it.contains("EXTEND_TIMEOUT_USEC=300000000\n")
            && it.contains("STATUS=recovering the swarms, 4 swarms left")
    });
    assert!(recovering, "{before:?}");
    assert_eq!(supervisor.receive(), "STATUS=8 swarms, healthy\n");
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_supervisor_waits_as_long_as_the_replay_of_one_swarm_goes_on() {
    let (place, started, client) = Place::with_swarms().await;
    // Too few for a checkpoint, which would shorten the replay.
    client.ok("s0", "step", json!({"steps": 300})).await;
    // A replay ends with the last command.
    client.ok("s0", "annotate", json!({"text": "here"})).await;
    drop((started, client));
    let supervisor = Supervisor::listen();
    let points = "step=sleep(15)";
    let mut command = supervised(place.folder.path(), &supervisor, points);
    let process = DaemonProcess::start(&mut command).unwrap();
    let before = supervisor.receive_until("READY=1");
    let one_left = |it: &&String| {
        it.contains("EXTEND_TIMEOUT_USEC=300000000\n") && it.contains(", 1 swarm left")
    };
    let extensions = before.iter().filter(one_left).count();
    assert!(extensions >= 3, "{before:?}");
    drop(process);
}
