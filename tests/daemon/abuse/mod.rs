//! A bad request gets an error that names the field, at once, and has no other effect.
//!
//! The tables beside this file contain the bad requests, a line each; [`made_up`] makes those that are
//! too long or are not text.

mod made_up;
mod wildcards;

use std::time::{Duration, Instant};

use jostle_proto::ErrorCode::{self, InvalidArgument, ResourceExhausted};
use jostle_proto::keys;
use serde_json::{Value, json};

use crate::support::bad_requests::{BadRequest, prepare_swarms, read_all};
use crate::support::{Client, Daemon, NODE, PREFIX, QueryResult, TIMEOUT};

/// The problem of a reply to a bad request, if there is one.
fn problem_of(answer: Option<QueryResult>, bad: &BadRequest) -> Option<String> {
    let error = match answer {
        None => return Some("was not answered".into()),
        Some(Ok(reply)) => return Some(format!("was accepted: {reply}")),
        Some(Err(error)) => error,
    };
    let named = error.details.get("field").and_then(Value::as_str);
    if error.code != bad.code || named != bad.field.as_deref() {
        let BadRequest { code, field, .. } = bad;
        return Some(format!("{code:?} {field:?} expected: {error:?}"));
    }
    if error.message.is_empty() || error.message.chars().count() > 1000 {
        return Some(format!("{} bytes: {error:?}", error.message.len()));
    }
    None
}

/// The reply to a bad request; `None` without one.
async fn answer_to(client: &Client, bad: &BadRequest) -> Option<QueryResult> {
    let mut query = client.session.get(&bad.selector).timeout(TIMEOUT);
    if let Some(payload) = &bad.payload {
        query = query.payload(&payload[..]);
    }
    let reply = query.await.unwrap().recv_async().await.ok()?;
    let bytes = match reply.into_result() {
        Ok(sample) => return Some(Ok(sample.key_expr().as_str().into())),
        Err(error) => error.payload().to_bytes().into_owned(),
    };
    serde_json::from_slice(&bytes).ok().map(Err)
}

/// Sends one after the other, and compares the swarm's status after each.
async fn assert_all_rejected(client: &Client, requests: &[BadRequest]) {
    let standing = async |swarm: &str| {
        let status = client.get(swarm, "status").await;
        let place = ["epoch", "step", "seq", "phase"].map(|name| status[name].clone());
        let result = &status["result"];
        let hidden = ["state_hash", "scheduled", "rate", "parameters"];
        (place, hidden.map(|name| result[name].clone()))
    };
    let mut stood = standing("twin").await;
    let (mut wrong, mut slowest) = (Vec::new(), Duration::ZERO);
    for bad in requests {
        let began = Instant::now();
        let answer = answer_to(client, bad).await;
        slowest = slowest.max(began.elapsed());
        if let Some(problem) = problem_of(answer, bad) {
            wrong.push(format!("{}: {problem}", bad.summary()));
        }
        let victim = standing("victim").await;
        if victim != stood {
            wrong.push(format!(
                "{}: changed the swarm to {victim:?}",
                bad.summary()
            ));
            stood = victim;
        }
    }
    println!(
        "{} requests rejected, the slowest after {slowest:?}",
        requests.len()
    );
    assert!(
        wrong.is_empty(),
        "{} of {}:\n{}",
        wrong.len(),
        requests.len(),
        wrong.join("\n")
    );
}

/// A daemon with two equal swarms, `victim` and `twin`.
async fn victim_and_twin() -> Daemon {
    let daemon = Daemon::start().await;
    prepare_swarms(&daemon.client, &["victim", "twin"]).await;
    daemon
}

/// Fails unless no swarm was created, no event occurred and both swarms step to equal states.
async fn are_still_twins(client: &Client) {
    let swarms = client.node("swarms").await;
    assert_eq!(swarms["swarms"].as_array().unwrap().len(), 2);
    let newest_event =
        async |swarm: &str| client.get(swarm, "events").await["result"]["newest"].clone();
    assert_eq!(newest_event("victim").await, newest_event("twin").await);
    for name in ["victim", "twin"] {
        client.ok(name, "step", json!({"steps": 20})).await;
    }
    assert_eq!(client.hash("victim").await, client.hash("twin").await);
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_requests_are_rejected_by_name_at_once_and_change_nothing() {
    let requests = read_all();
    let mut sent: Vec<_> = requests
        .iter()
        .map(|bad| (&bad.selector, &bad.payload))
        .collect();
    sent.sort_unstable();
    sent.dedup();
    assert_eq!(sent.len(), requests.len(), "one is there twice");
    assert!(requests.len() >= 200, "{}", requests.len());

    let daemon = victim_and_twin().await;
    assert_all_rejected(&daemon.client, &requests).await;
    are_still_twins(&daemon.client).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn huge_and_non_text_requests_are_rejected_as_quickly() {
    let daemon = victim_and_twin().await;
    let client = &daemon.client;
    // The maximum length of a request, and of a message.
    assert_all_rejected(client, &made_up::all(250_000)).await;
    assert_all_rejected(client, &made_up::too_long(1_000_000)).await;

    // A larger message is dropped on the way, and the link stays open.
    let query = client.session.get("jostle/victim/cmd/step");
    let query = query.payload(vec![b' '; 2 << 20]);
    let replies = query.timeout(Duration::from_millis(300)).await.unwrap();
    while let Ok(reply) = replies.recv_async().await {
        assert!(reply.into_result().is_err());
    }
    are_still_twins(client).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_used_request_id_is_a_conflict_on_every_key() {
    let daemon = victim_and_twin().await;
    let client = &daemon.client;
    let again = json!({"client": "me", "request_id": "taken", "args": {"pi3": 1}});
    let (code, _) = client.err("twin", "set", again).await;
    assert_eq!(code, ErrorCode::Conflict);
    let create = json!({"client": "me", "request_id": "taken",
        "args": {"name": "new", "spec": {"n": 1}}});
    let key = keys::node_cmd(PREFIX, NODE, "create");
    let answer = client
        .query(&key, Some(create.to_string().as_bytes()))
        .await;
    assert_eq!(answer.unwrap_err().code, ErrorCode::Conflict);
    are_still_twins(client).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn memory_is_reserved_before_it_is_allocated() {
    let daemon = Daemon::with(&[
        ("max_swarms", "4"),
        ("max_memory_mb", "7"),
        ("max_individuals", "1000000"),
    ])
    .await;
    let client = &daemon.client;
    let check = |what: &str, answer: QueryResult, code: ErrorCode, named: &str| match answer {
        Ok(reply) => panic!("{what}: was accepted: {reply}"),
        Err(error) => {
            assert_eq!(error.code, code, "{what}: {error:?}");
            assert!(error.message.contains(named), "{what}: {error:?}");
        }
    };
    let key = format!("jostle/@node/{NODE}/cmd/create");
    let create = async |name: &str, n: u64| {
        let request = json!({"name": name, "spec": {"n": n}}).to_string();
        client.query(&key, Some(request.as_bytes())).await
    };
    check(
        "n = 1e6",
        create("big", 1_000_000).await,
        ResourceExhausted,
        "max_memory_mb",
    );
    check(
        "n = 1e9",
        create("big", 1_000_000_000).await,
        InvalidArgument,
        "n =",
    );
    for name in ["a", "b", "c", "d"] {
        create(name, 10).await.unwrap();
    }
    check(
        "five",
        create("e", 10).await,
        ResourceExhausted,
        "max_swarms",
    );
    client.ok("d", "delete", json!({})).await;
    create("e", 10).await.unwrap();
    client.ok("e", "delete", json!({})).await;
    // Memory of removed individuals may be used by other swarms, and is then missing for a reset.
    client.ok("c", "delete", json!({})).await;
    create("c", 300).await.unwrap();
    client
        .ok("c", "remove", json!({"select": {"count": 299}}))
        .await;
    client.ok("b", "delete", json!({})).await;
    create("b", 300).await.unwrap();
    let answer = client.cmd("c", "reset", json!({})).await;
    check("reset", answer, ResourceExhausted, "max_memory_mb");
    client.ok("b", "delete", json!({})).await;
    client.ok("c", "reset", json!({})).await;
    // A larger group needs a reservation as a new swarm does.
    let answer = client.cmd("a", "inject", json!({"count": 5000})).await;
    check("inject", answer, ResourceExhausted, "max_memory_mb");
    daemon.stop().await;
}
