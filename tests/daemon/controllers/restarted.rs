//! A daemon that is killed and started again keeps the controllers whose clients connect again, and only those.

use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use super::suspended::{again, controller_process, removals};
use super::{advance, join, token, weights};
use crate::contested::fleet::Router;
use crate::harness::free_ports;
use crate::support::daemon_process::DaemonProcess;
use crate::support::process::jostled;
use crate::support::{Client, PREFIX, until, until_within};

/// How long clients may take to connect again.
const GRACE: Duration = Duration::from_secs(10);

/// The same, and the rest for a busy machine.
const LOST: Duration = Duration::from_secs(15);

fn started(folder: &Path, endpoint: &str, points: &str) -> DaemonProcess {
    let mut command = jostled(&["serve", "--listen", endpoint, "--node", "test"]);
    command.arg("--data-dir").arg(folder);
    command.env("FAILPOINTS", points).stderr(Stdio::null());
    DaemonProcess::start(&mut command).unwrap()
}

fn endpoint() -> String {
    let [port] = free_ports("127.0.0.1");
    format!("tcp/127.0.0.1:{port}")
}

async fn controllers(client: &Client, swarm: &str) -> Vec<Value> {
    let listed = client.get(swarm, "controllers").await;
    let listed = listed["result"]["controllers"].as_array().unwrap();
    listed.iter().map(|it| it["controller"].clone()).collect()
}

/// The processor time of a process, in units of 10 ms.
fn cpu_time(pid: u32) -> u64 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let fields: Vec<&str> = stat.rsplit(") ").next().unwrap().split(' ').collect();
    fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_that_ends_while_the_daemon_is_down_is_lost_and_one_that_lives_is_kept() {
    let (folder, endpoint) = (tempfile::tempdir().unwrap(), endpoint());
    let mut process = started(folder.path(), &endpoint, "");
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 6})).await;
    let ada = Client::open(&endpoint).await;
    join(&ada, "ada", &[0], json!({})).await;
    let mut eve = controller_process(&endpoint);
    // One whose client ends before the step at which it joins, and one that does not hold its swarm.
    client.create("b", json!({"n": 6})).await;
    let ends = Client::open(&endpoint).await;
    let later = json!({"controller": "bob", "mode": "free_running"});
    let later = json!({"at_step": 5, "args": later});
    ends.ok("b", "join", later).await;
    client.create("c", json!({"n": 6})).await;
    let free = json!({"controller": "carl", "mode": "free_running"});
    ends.ok("c", "join", free).await;

    process.kill();
    eve.kill().unwrap();
    eve.wait().unwrap();
    ends.session.close().await.unwrap();
    let process = started(folder.path(), &endpoint, "");
    let began = Instant::now();
    let client = Client::open(&endpoint).await;
    assert_eq!(controllers(&client, "a").await, ["ada", "eve"]);
    // It goes on where it was, once the other one is lost.
    let request = json!({"request_id": "1", "expect_step": 0, "timeout_secs": 60,
        "args": {"controller": "ada"}});
    let reply = again(&ada, "advance", &request).await;
    let took = began.elapsed();
    assert_eq!(reply["step"], 1, "{reply}");
    assert!(took > GRACE - Duration::from_secs(1), "{took:?}");
    assert!(took < LOST, "{took:?}");
    let lost = ("lost".to_owned(), "eve".to_owned());
    assert_eq!(removals(&client).await, [lost]);
    for step in 1..4 {
        let reply = advance(&ada, "ada", step, json!({})).await.unwrap();
        assert_eq!(reply["step"], step + 1);
    }
    until_within(LOST, "carl is lost", async || {
        controllers(&client, "c").await.is_empty()
    })
    .await;
    client.ok("b", "step", json!({"steps": 5})).await;
    until("bob is lost", async || {
        controllers(&client, "b").await.is_empty()
    })
    .await;
    for swarm in ["a", "b", "c"] {
        let verified = client.get(swarm, "verify").await;
        assert_eq!(verified["result"]["differs_at"], Value::Null, "{swarm}");
    }
    assert_eq!(controllers(&client, "a").await, ["ada"]);
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_faulted_swarm_keeps_its_controllers_until_it_is_reset_and_does_not_spin() {
    let (folder, endpoint) = (tempfile::tempdir().unwrap(), endpoint());
    let mut process = started(folder.path(), &endpoint, "");
    let client = Client::open(&endpoint).await;
    // Bodies that turn at a touch, as in `fault`.
    let spec = json!({"n": 60, "pi4": 1e6, "dt": 0.2497, "seed": 2});
    client.create("a", spec).await;
    let [first, second] = [Client::open(&endpoint).await, Client::open(&endpoint).await];
    for (client, name) in [(&first, "ada"), (&second, "bob")] {
        let free = json!({"mode": "free_running"});
        join(client, name, &[], free).await;
    }
    let steps = json!({"timeout_secs": 30, "args": {"steps": 20_000}});
    client.cmd("a", "step", steps).await.unwrap_err();
    let is_faulted = async || client.get("a", "status").await["phase"] == "faulted";
    until("a fault", is_faulted).await;
    // The steps to it are durable then.
    client.ok("a", "annotate", json!({"text": "here"})).await;
    // The first ends before the daemon does, the second while it is down.
    first.session.close().await.unwrap();
    let key = keys::ctl_alive(PREFIX, "a", "ada");
    until("the token is gone", async || {
        let tokens = client.session.liveliness().get(&key).await.unwrap();
        tokens.recv_async().await.is_err()
    })
    .await;
    process.kill();
    second.session.close().await.unwrap();
    let process = started(folder.path(), &endpoint, "");
    let client = Client::open(&endpoint).await;
    tokio::time::sleep(GRACE + Duration::from_secs(1)).await;
    assert_eq!(controllers(&client, "a").await, ["ada", "bob"]);
    let before = cpu_time(process.child.id());
    tokio::time::sleep(Duration::from_secs(2)).await;
    let spent = cpu_time(process.child.id()) - before;
    assert!(spent < 60, "{spent} of 200");
    client.ok("a", "reset", json!({})).await;
    until("both are lost", async || {
        controllers(&client, "a").await.is_empty()
    })
    .await;
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_behind_a_router_counts_in_a_daemon_that_starts_after_it() {
    let (folder, endpoint) = (tempfile::tempdir().unwrap(), endpoint());
    let router = Router::connected_to(&[&endpoint]);
    let ada = Client::open(&router.1).await;
    // Declared before there is a daemon: it must learn of it from the router.
    let _token = token(&ada, "ada").await;
    let mut process = started(folder.path(), &endpoint, "");
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 6})).await;
    let request = json!({"request_id": "1", "args": {"controller": "ada"}});
    let joined = again(&ada, "join", &request).await;
    assert_eq!(joined["result"]["ids"], json!([]));
    process.kill();
    let process = started(folder.path(), &endpoint, "");
    let client = Client::open(&endpoint).await;
    let request = json!({"request_id": "2", "expect_step": 0, "args": {"controller": "ada"}});
    again(&ada, "advance", &request).await;
    // After the time in which it would have been lost.
    tokio::time::sleep(GRACE + Duration::from_secs(1)).await;
    assert_eq!(controllers(&client, "a").await, ["ada"]);
    assert!(removals(&client).await.is_empty());
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_that_has_joined_again_is_not_lost_by_its_first_token() {
    let (folder, endpoint) = (tempfile::tempdir().unwrap(), endpoint());
    let points = "token-queried=1*sleep(3000)->off";
    let process = started(folder.path(), &endpoint, points);
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 6})).await;
    let [first, second, other] = [
        Client::open(&endpoint).await,
        Client::open(&endpoint).await,
        Client::open(&endpoint).await,
    ];
    join(&first, "ada", &[0], json!({})).await;
    join(&other, "bob", &[1], json!({})).await;
    first.session.close().await.unwrap();
    let key = keys::ctl_alive(PREFIX, "a", "ada");
    until("the token is gone", async || {
        let tokens = client.session.liveliness().get(&key).await.unwrap();
        tokens.recv_async().await.is_err()
    })
    .await;
    // While the daemon decides about the first token.
    let _token = token(&second, "ada").await;
    join(&second, "ada", &[0], json!({"again": true})).await;
    assert_eq!(controllers(&client, "a").await, ["ada", "bob"]);
    // Decided later, by the same thread.
    other.session.close().await.unwrap();
    until("bob is lost", async || {
        !controllers(&client, "a").await.contains(&json!("bob"))
    })
    .await;
    assert_eq!(controllers(&client, "a").await, ["ada"]);
    drop(process);
}

/// The misses of a controller in a row.
async fn misses(client: &Client, controller: &str) -> Value {
    recovered(client).await;
    let listed = client.get("a", "controllers").await;
    let mut listed = listed["result"]["controllers"].as_array().unwrap().iter();
    let found = listed.find(|it| it["controller"] == controller);
    found.map_or(Value::Null, |it| it["misses"].clone())
}

/// Waits until the daemon has the swarm `a`.
async fn recovered(client: &Client) {
    let key = keys::get(PREFIX, "a", "status");
    until("the swarm is recovered", async || {
        matches!(&client.query_all(&key, None).await[..], [Ok(_)])
    })
    .await;
}

/// Kills a daemon with the swarm `a`, or ends it as an operator does.
async fn ended(mut process: DaemonProcess, client: &Client, is_killed: bool) {
    // What was done is durable then.
    client.ok("a", "annotate", json!({"text": "here"})).await;
    if is_killed {
        process.kill();
    } else {
        process.stop();
        assert_eq!(process.end(), Some(0));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_deadlines_that_a_controller_has_missed_count_after_a_restart() {
    for is_killed in [true, false] {
        let (folder, endpoint) = (tempfile::tempdir().unwrap(), endpoint());
        let mut process = started(folder.path(), &endpoint, "");
        let client = Client::open(&endpoint).await;
        client.create("a", json!({"n": 6})).await;
        let [ada, bob] = [Client::open(&endpoint).await, Client::open(&endpoint).await];
        join(&ada, "ada", &[0], json!({"deadline_secs": 60})).await;
        join(&bob, "bob", &[1], json!({"deadline_secs": 0.2})).await;
        for step in 0..3 {
            let client = Client::open(&endpoint).await;
            assert_eq!(misses(&client, "bob").await, step);
            let request = json!({"request_id": step.to_string(), "expect_step": step,
                "timeout_secs": 60, "args": {"controller": "ada"}});
            assert_eq!(again(&ada, "advance", &request).await["step"], step + 1);
            if step < 2 {
                ended(process, &Client::open(&endpoint).await, is_killed).await;
                process = started(folder.path(), &endpoint, "");
            }
        }
        let client = Client::open(&endpoint).await;
        until("bob is removed", async || {
            controllers(&client, "a").await == ["ada"]
        })
        .await;
        let missed = ("deadline".to_owned(), "bob".to_owned());
        assert_eq!(removals(&client).await, vec![missed; 3]);
        drop(process);
    }
}

/// How the client of a controller, or its daemon, ends before the controller joins again.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cause {
    /// Neither does: another process takes its name.
    Taken,
    /// The token is lost.
    Lost,
    Stopped,
    Killed,
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_that_joins_again_with_others_has_those_and_leaves_those_alone() {
    for cause in [Cause::Taken, Cause::Lost, Cause::Stopped, Cause::Killed] {
        let (folder, endpoint) = (tempfile::tempdir().unwrap(), endpoint());
        let mut process = started(folder.path(), &endpoint, "");
        let first = Client::open(&endpoint).await;
        let client = Client::open(&endpoint).await;
        client.create("a", json!({"n": 6})).await;
        let free = json!({"on_timeout": "free"});
        join(&first, "ada", &[0, 1], free.clone()).await;
        let set = json!({"set": {"ids": [0, 1], "direction": [0.1, 0.2], "weight": [1.0, 2.0]}});
        advance(&first, "ada", 0, set).await.unwrap();
        assert_eq!(weights(&client).await, [1.0, 2.0, 0.0, 0.0, 0.0, 0.0]);
        // Those that it no longer has keep their set-points, unless it was removed: then it left.
        let kept = match cause {
            Cause::Lost => 0.0,
            _ => 1.0,
        };
        let mut is_again = true;
        match cause {
            Cause::Taken => {}
            Cause::Lost => {
                first.session.close().await.unwrap();
                until("ada is lost", async || {
                    controllers(&client, "a").await.is_empty()
                })
                .await;
                is_again = false;
            }
            Cause::Stopped | Cause::Killed => {
                ended(process, &client, cause == Cause::Killed).await;
                process = started(folder.path(), &endpoint, "");
            }
        }
        let (ada, client) = (Client::open(&endpoint).await, Client::open(&endpoint).await);
        recovered(&client).await;
        let more = json!({"on_timeout": "free", "again": is_again});
        let joined = join(&ada, "ada", &[1, 2], more).await;
        assert_eq!(joined["result"]["ids"], json!([1, 2]), "{cause:?}");
        let before = weights(&client).await;
        assert_eq!(before, [kept, 2.0 * kept, 0.0, 0.0, 0.0, 0.0], "{cause:?}");
        // It no longer has the first, which another one may have.
        let set = |id: u32| json!({"set": {"ids": [id], "direction": [0.3], "weight": [3.0]}});
        let error = advance(&ada, "ada", 1, set(0)).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{cause:?}");
        let bob = json!({"controller": "bob", "mode": "free_running", "select": {"ids": [0]}});
        let joined = client.ok("a", "join", bob).await;
        assert_eq!(joined["result"]["ids"], json!([0]), "{cause:?}");
        let taken = json!({"controller": "eve", "mode": "free_running", "select": {"ids": [2]}});
        let (code, _) = client.err("a", "join", taken).await;
        assert_eq!(code, ErrorCode::Conflict, "{cause:?}");
        advance(&ada, "ada", 1, set(2)).await.unwrap();
        ended(process, &client, cause == Cause::Killed).await;
        let process = started(folder.path(), &endpoint, "");
        let client = Client::open(&endpoint).await;
        recovered(&client).await;
        let after = weights(&client).await;
        assert_eq!(after, [kept, 2.0 * kept, 3.0, 0.0, 0.0, 0.0], "{cause:?}");
        client.ok("a", "leave", json!({"controller": "ada"})).await;
        let left = weights(&client).await;
        assert_eq!(left, [kept, 0.0, 0.0, 0.0, 0.0, 0.0], "{cause:?}");
        let verified = client.get("a", "verify").await;
        assert_eq!(verified["result"]["differs_at"], Value::Null, "{cause:?}");
        drop((first, process));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn set_points_from_before_a_restart_lapse_and_those_after_it_hold() {
    /// In seconds.
    const LEASE: f64 = 3.0;
    for is_killed in [true, false] {
        let (folder, endpoint) = (tempfile::tempdir().unwrap(), endpoint());
        let mut process = started(folder.path(), &endpoint, "");
        let client = Client::open(&endpoint).await;
        client.create("a", json!({"n": 6, "rate": 2})).await;
        let ada = Client::open(&endpoint).await;
        let free = json!({"mode": "free_running", "deadline_secs": LEASE, "on_timeout": "free"});
        join(&ada, "ada", &[3, 4], free).await;
        client.ok("a", "run", json!({})).await;
        let key = keys::ctl(PREFIX, "a", "ada");
        let put = async |sequence: u64, weight: f64| {
            let set = json!({"ids": [3], "direction": [1.0], "weight": [weight]});
            let set = json!({"sequence": sequence, "set": set}).to_string();
            let sent = ada.session.put(&key, set).encoding("application/json");
            sent.await.unwrap();
        };
        put(1, 2.0).await;
        until("it is applied", async || weights(&client).await[3] == 2.0).await;
        ended(process, &client, is_killed).await;
        process = started(folder.path(), &endpoint, "");
        let client = Client::open(&endpoint).await;
        recovered(&client).await;
        assert_eq!(weights(&client).await[3], 2.0, "{is_killed}");
        let is_free = async || weights(&client).await.iter().all(|weight| *weight == 0.0);
        until_within(LOST, "the lease ends", is_free).await;
        // The controller itself is still there, and its next set-points hold as long as they come.
        assert_eq!(controllers(&client, "a").await, ["ada"]);
        let began = Instant::now();
        let mut sequence = 2;
        while began.elapsed().as_secs_f64() < 2.0 * LEASE {
            put(sequence, 4.0).await;
            let is_held = async || weights(&client).await[3] == 4.0;
            until("they hold", is_held).await;
            sequence += 1;
        }
        until_within(LOST, "the lease ends again", is_free).await;
        client.ok("a", "pause", json!({})).await;
        let verified = client.get("a", "verify").await;
        assert_eq!(verified["result"]["differs_at"], Value::Null);
        drop(process);
    }
}
