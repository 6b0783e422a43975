//! A request with a `request_id` is executed once.

use std::time::Duration;

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::support::{Client, Daemon, NODE, PREFIX, until};

fn named(id: &str, args: Value) -> Value {
    let mut request = json!({"client": "me", "request_id": id});
    request["args"] = args;
    request
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_sent_again_is_answered_again_and_carried_out_once() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 5})).await;
    let request = named("1", json!({"steps": 3}));
    let first = client.ok("a", "step", request.clone()).await;
    client.ok("a", "step", json!({})).await;
    let hash = client.hash("a").await;
    for _ in 0..3 {
        assert_eq!(client.ok("a", "step", request.clone()).await, first);
    }
    // Another timeout or another session does not make it another request.
    let mut patient = request.clone();
    patient["timeout_secs"] = json!(60);
    let other = daemon.another_client().await;
    assert_eq!(other.ok("a", "step", patient).await, first);
    assert_eq!(client.hash("a").await, hash);
    // Nor does another spelling of its JSON.
    let key = keys::cmd(PREFIX, "a", "step");
    for spelled in [
        r#"{"args":{"steps":3},"request_id":"1","client":"me"}"#,
        r#"{ "client": "me", "request_id": "1", "args": { "return": "none", "steps": 3 } }"#,
    ] {
        let answer = client.query(&key, Some(spelled.as_bytes())).await;
        if spelled.contains("return") {
            assert_eq!(answer.unwrap_err().code, ErrorCode::Conflict);
        } else {
            assert_eq!(answer.unwrap(), first);
        }
    }
    // The same `request_id` of another client is another request.
    let mut theirs = request.clone();
    theirs["client"] = json!("they");
    assert_eq!(client.ok("a", "step", theirs).await["step"], 7);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_request_id_for_two_requests_is_a_conflict() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 5})).await;
    client.create("b", json!({"n": 5})).await;
    client
        .ok("a", "step", named("1", json!({"steps": 3})))
        .await;
    let mut later = named("1", json!({"steps": 3}));
    later["at_step"] = json!(3);
    for (swarm, verb, request) in [
        ("a", "step", named("1", json!({"steps": 4}))),
        ("b", "step", named("1", json!({"steps": 3}))),
        ("a", "run", named("1", json!({}))),
        ("a", "step", later),
    ] {
        let error = client.cmd(swarm, verb, request).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::Conflict);
        assert_eq!(error.details["field"], "request_id");
    }
    assert_eq!(client.get("a", "status").await["step"], 3);
    assert_eq!(client.get("b", "status").await["step"], 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_rejected_may_be_tried_again_under_its_name() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 5, "rate": 1})).await;
    client.ok("a", "run", json!({})).await;
    let request = named("1", json!({"steps": 3}));
    let (code, _) = client.err("a", "step", request.clone()).await;
    assert_eq!(code, ErrorCode::IncorrectState);
    client.ok("a", "pause", json!({})).await;
    let reply = client.ok("a", "step", request.clone()).await;
    assert_eq!(client.ok("a", "step", request).await, reply);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_retry_during_execution_or_after_a_deadline_gets_the_result() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 20})).await;
    let mut hasty = named("1", json!({"steps": 20_000}));
    hasty["timeout_secs"] = json!(0.01);
    let (code, _) = client.err("a", "step", hasty).await;
    assert_eq!(code, ErrorCode::DeadlineExceeded);
    let mut patient = named("1", json!({"steps": 20_000}));
    patient["timeout_secs"] = json!(60);
    let both = tokio::join!(
        client.cmd("a", "step", patient.clone()),
        client.cmd("a", "step", patient.clone()),
    );
    let (one, other) = (both.0.unwrap(), both.1.unwrap());
    assert_eq!(one, other);
    assert_eq!(one["step"], 20_000);
    assert_eq!(client.ok("a", "step", patient).await, one);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn creating_deleting_and_scheduling_are_executed_once_too() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let key = keys::node_cmd(PREFIX, NODE, "create");
    let create = named("1", json!({"name": "a", "spec": {"n": 5}})).to_string();
    let create = async || client.query(&key, Some(create.as_bytes())).await;
    let created = create().await.unwrap();
    assert_eq!(create().await.unwrap(), created);

    let schedule_command =
        json!({"client": "me", "request_id": "2", "at_step": 9, "args": {"count": 1}});
    let waits = client.ok("a", "inject", schedule_command.clone()).await;
    assert_eq!(
        client.ok("a", "inject", schedule_command.clone()).await,
        waits
    );
    client.ok("a", "step", json!({"steps": 10})).await;
    assert_eq!(client.ok("a", "inject", schedule_command).await, waits);
    assert_eq!(client.get("a", "status").await["result"]["n"], 6);

    // The swarm of that name is now another one.
    let delete = named("3", json!({}));
    let deleted = client.ok("a", "delete", delete.clone()).await;
    client.create("a", json!({"n": 7})).await;
    assert_eq!(client.ok("a", "delete", delete).await, deleted);
    assert_eq!(client.get("a", "status").await["result"]["n"], 7);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reply_with_a_state_and_the_fault_of_a_step_are_given_again() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 5})).await;
    let request = named("1", json!({"steps": 3, "return": "state"}));
    let first = client.ok("a", "step", request.clone()).await;
    assert_eq!(first["result"]["state"]["step"], 3);
    assert_eq!(client.ok("a", "step", request).await, first);

    let spec = json!({"n": 60, "pi4": 1e6, "dt": 0.2497, "seed": 2});
    client.create("faulting", spec).await;
    let mut request = named("2", json!({"steps": 20_000}));
    request["timeout_secs"] = json!(Duration::from_secs(60).as_secs());
    let first = client.cmd("faulting", "step", request.clone()).await;
    let first = first.unwrap_err();
    assert_eq!(first.code, ErrorCode::Faulted);
    client.ok("faulting", "reset", json!({})).await;
    let again = client.cmd("faulting", "step", request).await.unwrap_err();
    assert_eq!(again, first);
    assert_eq!(client.get("faulting", "status").await["step"], 0);
    daemon.stop().await;
}

/// `client` informs all individuals of `crowd` under ids `flood-N`, one request after the other.
async fn flood(client: &Client, numbers: impl Iterator<Item = u32>) {
    for number in numbers {
        let request = json!({
            "client": "flood",
            "request_id": format!("flood-{number}"),
            "args": {"direction": 0.0, "select": {"fraction": 1.0}},
        });
        client.ok("crowd", "inform", request).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clients_many_replies_evict_its_own_and_no_others() {
    const FLOOD: u32 = 8000;
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 5})).await;
    client.create("crowd", json!({"n": 2000})).await;
    let mine = named("1", json!({"count": 1}));
    let injected = client.ok("a", "inject", mine.clone()).await;
    let theirs = json!({"client": "flood", "request_id": "b", "args": {"count": 1}});
    client.create("b", json!({"n": 2})).await;
    client.ok("b", "inject", theirs.clone()).await;
    // Each reply lists 2000 ids in 9 kB: together more than the 64 MiB that are remembered.
    flood(client, 0..1).await;
    let part = |k: u32| flood(client, (1..FLOOD).filter(move |number| number % 8 == k));
    tokio::join!(
        part(0),
        part(1),
        part(2),
        part(3),
        part(4),
        part(5),
        part(6),
        part(7)
    );
    assert_eq!(client.ok("a", "inject", mine.clone()).await, injected);
    assert_eq!(client.get("a", "status").await["result"]["n"], 6);
    // The flood has lost its own oldest reply, so the total was exceeded.
    let seq = client.get("crowd", "status").await["seq"].as_u64().unwrap();
    flood(client, 0..1).await;
    assert_eq!(client.get("crowd", "status").await["seq"], seq + 1);
    flood(client, FLOOD - 1..FLOOD).await;
    assert_eq!(client.get("crowd", "status").await["seq"], seq + 1);
    // The same holds for the replies in the store. Recovery must not take evicted replies for lost
    // ones: it would replay the swarm from an older checkpoint to recompute them.
    for _ in 0..10 {
        client.ok("b", "step", json!({"steps": 10_000})).await;
    }
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    client.ok("b", "inject", theirs).await;
    assert_eq!(client.get("b", "status").await["result"]["n"], 4);
    assert_eq!(client.ok("a", "inject", mine).await, injected);
    assert_eq!(client.get("a", "status").await["result"]["n"], 6);
    flood(client, FLOOD - 1..FLOOD).await;
    assert_eq!(client.get("crowd", "status").await["seq"], seq + 1);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_large_reply_is_cached_without_its_state_which_the_swarm_still_has() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 200})).await;
    client
        .ok(
            "a",
            "join",
            json!({"controller": "ada", "select": {"fraction": 1.0}}),
        )
        .await;
    let mut request = named("1", json!({"controller": "ada", "return": "state"}));
    request["expect_step"] = json!(0);
    // The controller's session ends between the request and the reply.
    let key = keys::cmd(PREFIX, "a", "advance");
    let killed = daemon.another_client().await;
    let payload = request.to_string();
    let unheard = killed.query_all(&key, Some(payload.as_bytes()));
    _ = tokio::time::timeout(Duration::ZERO, unheard).await;
    drop(killed);
    until("it is carried out", async || {
        client.get("a", "status").await["step"] == 1
    })
    .await;
    let seq = client.get("a", "status").await["seq"].clone();
    let again = client.ok("a", "advance", request.clone()).await;
    assert_eq!((&again["step"], &again["seq"]), (&json!(1), &seq));
    assert_eq!(again["result"].get("state"), None);
    assert_eq!(again["result"]["state_hash"], client.hash("a").await);
    assert_eq!(client.ok("a", "advance", request).await, again);
    // The first reply has the state, and the reply to a retry omits it.
    let mut next = named("2", json!({"controller": "ada", "return": "state"}));
    next["expect_step"] = json!(1);
    let first = client.ok("a", "advance", next.clone()).await;
    assert_eq!(first["result"]["state"]["step"], 2);
    let mut short = first.clone();
    short["result"].as_object_mut().unwrap().remove("state");
    assert_eq!(client.ok("a", "advance", next).await, short);
    daemon.stop().await;
}
