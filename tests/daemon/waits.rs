//! Waits for conditions by `get/wait`: they are no part of a swarm, and end shortly after their clients.

mod bounds;
mod clients;

use std::time::Duration;

use jostle_proto::{Error, ErrorCode, keys};
use serde_json::{Value, json};
use zenoh::liveliness::LivelinessToken;

use crate::support::daemon_process::start;
use crate::support::{Client, Daemon, PREFIX, QueryResult, until_within};

/// A wait ends 2 s after its client; the rest is for a busy machine.
const GONE: Duration = Duration::from_secs(6);

/// The limit of a swarm.
const MAX_WAITS: usize = 16;

fn spec(n: usize) -> Value {
    json!({"n": n, "seed": 5, "rate": null})
}

fn selector(swarm: &str, condition: &str, id: &str, secs: f64) -> String {
    let noun = format!("wait?condition={condition};id={id};timeout_secs={secs}");
    keys::get(PREFIX, swarm, &noun)
}

async fn hold(client: &Client, swarm: &str, id: &str) -> LivelinessToken {
    let key = keys::wait_alive(PREFIX, swarm, id);
    client
        .session
        .liveliness()
        .declare_token(key)
        .await
        .unwrap()
}

async fn wait(client: &Client, swarm: &str, condition: &str, id: &str, secs: f64) -> QueryResult {
    client
        .query(&selector(swarm, condition, id, secs), None)
        .await
}

fn code(result: QueryResult) -> Option<ErrorCode> {
    result.map_or_else(|error| Some(error.code), |_| None)
}

/// The conditions for which clients wait.
async fn waits(client: &Client, swarm: &str) -> Vec<Value> {
    let status = client.get(swarm, "status").await;
    let waits = status["result"]["waits"].as_array().cloned();
    waits.unwrap_or_default()
}

/// Begins a wait that never ends by itself.
async fn begin(client: &Client, swarm: &str, id: &str) -> Result<LivelinessToken, Error> {
    let token = hold(client, swarm, id).await;
    match wait(client, swarm, "order > 1", id, 0.05)
        .await
        .unwrap_err()
    {
        error if error.code == ErrorCode::DeadlineExceeded => Ok(token),
        error => Err(error),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wait_has_the_state_in_which_its_condition_holds_and_leaves_no_trace() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let draw = json!({"select": {"count": 3}, "direction": -1.0});
    for name in ["a", "twin"] {
        client.create(name, spec(12)).await;
    }
    let token = hold(client, "a", "w").await;
    // In the present state.
    let now = wait(client, "a", "order >= 0", "w", 10.0).await.unwrap();
    assert_eq!((&now["step"], &now["phase"]), (&json!(0), &json!("paused")));
    // After 50 steps in a row, of 0.02 each.
    let other = daemon.another_client().await;
    let waiting = wait(&other, "a", "order >= 0 for 1", "w", 20.0);
    let stepping = async {
        until_within(GONE, "it waits", async || {
            waits(client, "a").await == [json!({"condition": "order >= 0 for 1", "user": null})]
        })
        .await;
        client.ok("a", "inform", draw.clone()).await;
        client.ok("a", "step", json!({"steps": 80})).await;
    };
    let (held, ()) = tokio::join!(waiting, stepping);
    let held = held.unwrap();
    assert_eq!((&held["step"], &held["time"]), (&json!(50), &json!(1.0)));
    // The twin, for which nobody waits, has the same state there, with the same draws.
    client.ok("twin", "inform", draw).await;
    client.ok("twin", "step", json!({"steps": 50})).await;
    assert_eq!(held["result"]["state_hash"], client.hash("twin").await);
    client.ok("twin", "step", json!({"steps": 30})).await;
    assert_eq!(client.hash("a").await, client.hash("twin").await);
    let journal = client.get("a", "journal").await;
    let entries = journal["result"]["entries"].as_array().unwrap().iter();
    let verbs: Value = entries.map(|it| it["verb"].clone()).collect();
    assert_eq!(
        (verbs, &journal["seq"]),
        (json!(["inform", "step"]), &json!(2))
    );
    drop(token);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_duration_goes_on_while_the_query_is_repeated() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    let _token = hold(client, "a", "w").await;
    let condition = "order >= 0 for 2";
    // 100 steps: each query lasts for 30 of them.
    for k in 1..=3 {
        let expired = wait(client, "a", condition, "w", 0.05).await;
        assert_eq!(code(expired), Some(ErrorCode::DeadlineExceeded));
        client.ok("a", "step", json!({"steps": 30})).await;
        assert_eq!(waits(client, "a").await.len(), 1, "{k}");
    }
    // It holds while no query waits: the next one gets the state in which it held.
    client.ok("a", "step", json!({"steps": 30})).await;
    client.create("twin", spec(12)).await;
    client.ok("twin", "step", json!({"steps": 100})).await;
    for _ in 0..2 {
        let held = wait(client, "a", condition, "w", 20.0).await.unwrap();
        assert_eq!(held["step"], 100, "{held}");
        assert_eq!(held["result"]["state_hash"], client.hash("twin").await);
    }
    // With another condition the same id is another wait.
    let expired = wait(client, "a", "order >= 0 for 3", "w", 0.05).await;
    assert_eq!(code(expired), Some(ErrorCode::DeadlineExceeded));
    client.ok("a", "step", json!({"steps": 140})).await;
    let expired = wait(client, "a", "order >= 0 for 4", "w", 0.05).await;
    assert_eq!(code(expired), Some(ErrorCode::DeadlineExceeded));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reset_begins_a_wait_anew() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    let _token = hold(client, "a", "w").await;
    let other = daemon.another_client().await;
    let waiting = wait(&other, "a", "order >= 0 for 2 and msd(1) > 0", "w", 20.0);
    let resetting = async {
        until_within(GONE, "it waits", async || {
            waits(client, "a").await.len() == 1
        })
        .await;
        client.ok("a", "step", json!({"steps": 90})).await;
        client.ok("a", "reset", json!({})).await;
        client.ok("a", "when", json!({"cancel": true})).await;
        client.ok("a", "step", json!({"steps": 120})).await;
    };
    let (held, ()) = tokio::join!(waiting, resetting);
    let held = held.unwrap();
    // The first observed state is that after the first step.
    assert_eq!((&held["epoch"], &held["step"]), (&json!(2), &json!(101)));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_held_before_a_reset_is_no_reply_after_it() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    let _token = hold(client, "a", "w").await;
    let query = async || wait(client, "a", "order >= 0 for 1", "w", 0.05).await;
    assert_eq!(code(query().await), Some(ErrorCode::DeadlineExceeded));
    // It holds while no query waits.
    client.ok("a", "step", json!({"steps": 60})).await;
    assert!(waits(client, "a").await.is_empty());
    client.ok("a", "reset", json!({})).await;
    assert_eq!(code(query().await), Some(ErrorCode::DeadlineExceeded));
    client.ok("a", "step", json!({"steps": 60})).await;
    let held = query().await.unwrap();
    assert_eq!((&held["epoch"], &held["step"]), (&json!(2), &json!(50)));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_wait_is_rejected() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    let get = async |parameters: &str| {
        let key = keys::get(PREFIX, "a", &format!("wait?{parameters}"));
        client.query(&key, None).await.unwrap_err()
    };
    for (parameters, part) in [
        ("condition=order > 0", "id is missing"),
        ("condition=order > 0;id=A", "invalid id"),
        ("condition=order > 0;id=a;step=3", "only one of them"),
        ("step=3;id=a", "leave it out"),
        ("id=a", "only one of them"),
        ("condition=ordr > 0;id=a", "column 1"),
        ("condition=order > 1.5;id=a", "never holds"),
        ("condition=msd(250.02) > 1;id=a", "poses"),
        ("condition=order > 0;id=a;id=b", "twice"),
    ] {
        let error = get(parameters).await;
        let is_expected = error.code == ErrorCode::InvalidArgument && error.message.contains(part);
        assert!(is_expected, "{parameters}: {error:?}");
    }
    // Without a token it ends after 2 s, with the key of the token.
    let error = wait(client, "a", "order > 1", "w", 20.0).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::IncorrectState, "{error:?}");
    let key = keys::wait_alive(PREFIX, "a", "w");
    assert!(error.message.contains(&key), "{error:?}");
    assert_eq!(error.details["token"], key);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn forks_and_snapshots_have_no_conditions_with_an_event() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    let event = json!({"condition": "msd(1) > 9", "event": "mine"});
    client.ok("a", "when", event.clone()).await;
    let pause = json!({"condition": "order > 1", "pause": true});
    client.ok("a", "when", pause).await;
    let later = json!({"at_step": 500, "args": {"condition": "order > 1", "event": "later"}});
    client.ok("a", "when", later).await;
    let _token = begin(client, "a", "w").await.unwrap();
    client.ok("a", "step", json!({"steps": 60})).await;
    let snapshot = super::when::snapshot_of(client, "a").await;
    client.ok("a", "fork", json!({"name": "forked"})).await;
    client
        .ok("a", "fork", json!({"name": "earlier", "step": 20}))
        .await;
    super::when::restore(client, &snapshot, "restored").await;
    let when = async |name: &str| client.get(name, "status").await["result"]["when"].take();
    for name in ["forked", "earlier", "restored"] {
        assert_eq!(when(name).await, json!(["order > 1"]), "{name}");
        let status = client.get(name, "status").await["result"].take();
        assert_eq!(status["scheduled"], 0, "{name}");
        assert_eq!(status["waits"], Value::Null, "{name}");
        let verified = client.get(name, "verify").await["result"].take();
        assert_eq!(verified["differs_at"], Value::Null, "{name}: {verified}");
    }
    assert_eq!(when("a").await, json!(["msd(1) > 9", "order > 1"]));
    client.ok("a", "delete", json!({})).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_held_before_a_fault_is_told_again() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", crate::commands::faulting_spec()).await;
    let _token = hold(client, "a", "w").await;
    // It holds at step 1, and the swarm faults later.
    let condition = "order >= 0 for 0.2";
    let expired = wait(client, "a", condition, "w", 0.05).await;
    assert_eq!(code(expired), Some(ErrorCode::DeadlineExceeded));
    crate::commands::fault_soon(client, "a").await;
    // Its reply has missed the client, which sends the query again.
    for _ in 0..2 {
        let held = wait(client, "a", condition, "w", 20.0).await.unwrap();
        assert_eq!(
            (&held["step"], &held["phase"]),
            (&json!(1), &json!("running"))
        );
    }
    let other = wait(client, "a", "order > 1", "w", 20.0).await.unwrap();
    assert_eq!(other["phase"], "faulted");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deleted_or_faulted_swarm_ends_its_waits() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    crate::commands::fault(client, "b").await;
    let _tokens = [hold(client, "a", "w").await, hold(client, "b", "w").await];
    let other = daemon.another_client().await;
    let waiting = wait(&other, "a", "order > 1", "w", 20.0);
    let deleting = async {
        until_within(GONE, "it waits", async || {
            waits(client, "a").await.len() == 1
        })
        .await;
        client.ok("a", "delete", json!({})).await;
    };
    let (gone, ()) = tokio::join!(waiting, deleting);
    assert_eq!(code(gone), Some(ErrorCode::NotFound));
    let faulted = wait(client, "b", "order > 1", "w", 20.0).await.unwrap();
    assert_eq!(faulted["phase"], "faulted");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_was_declared_before_the_query_holds_the_wait() {
    let folder = tempfile::tempdir().unwrap();
    let (process, client) = start(folder.path()).await;
    client.create("a", spec(12)).await;
    let _token = hold(&client, "a", "w").await;
    // Without a token it would end after 2 s, and with `incorrect_state`.
    let ended = wait(&client, "a", "order > 1", "w", 3.5).await;
    assert_eq!(code(ended), Some(ErrorCode::DeadlineExceeded));
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_id_may_be_used_again_while_its_first_wait_ends() {
    let folder = tempfile::tempdir().unwrap();
    let (process, client) = start(folder.path()).await;
    let client = &client;
    client.create("a", spec(12)).await;
    let token = begin(client, "a", "w").await.unwrap();
    token.undeclare().await.unwrap();
    // The wait ends 2 s after the token. Another one begins before, and its token arrives after that.
    tokio::time::sleep(Duration::from_millis(1500)).await;
    let waiting = wait(client, "a", "order >= 0 for 1", "w", 20.0);
    let declaring = async {
        tokio::time::sleep(Duration::from_millis(1000)).await;
        let token = hold(client, "a", "w").await;
        tokio::time::sleep(Duration::from_millis(2500)).await;
        client.ok("a", "step", json!({"steps": 80})).await;
        token
    };
    let (held, _token) = tokio::join!(waiting, declaring);
    assert_eq!(held.unwrap()["step"], 50);
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_missed_deadline_is_rounded_in_the_message_and_exact_in_the_details() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(5)).await;
    for (secs, shown) in [(0.049988056, "0.05"), (0.2, "0.2"), (1.2345, "1.23")] {
        let key = keys::get(
            PREFIX,
            "a",
            &format!("wait?phase=running;timeout_secs={secs}"),
        );
        let error = client.query(&key, None).await.unwrap_err();
        assert_eq!(
            error.message,
            format!("condition not met within {shown} s: retry")
        );
        assert_eq!(error.details["after_secs"], secs, "{error:?}");
    }
    let request = json!({"timeout_secs": 0.049988056, "args": {"steps": 100_000_000}});
    let error = client.cmd("a", "step", request).await.unwrap_err();
    assert!(
        error.message.starts_with("not done within 0.05 s: "),
        "{error:?}"
    );
    assert_eq!(error.details["after_secs"], 0.049988056, "{error:?}");
    daemon.stop().await;
}
