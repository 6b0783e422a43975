//! Whatever a client sends: an error that names the field, at once, and nothing else happens.
//!
//! The bad requests stand in the tables beside this file, a line each; those that are too long or
//! are no text are made up in [`made_up`].

mod made_up;
mod memory;
mod wildcards;

use std::time::{Duration, Instant};

use jostle_proto::ErrorCode::{self, InvalidArgument, ResourceExhausted};
use jostle_proto::keys;
use serde_json::{Value, json};

use crate::support::{Answer, Client, Daemon, NODE, PATIENCE, PREFIX, alone};

const TO_A_SWARM: &str = include_str!("to_a_swarm.txt");
const TO_THE_NODE: &str = include_str!("to_the_node.txt");
const SELECTORS: &str = include_str!("selectors.txt");

/// A bad request and how it is refused.
struct Bad {
    selector: String,
    payload: Option<Vec<u8>>,
    code: ErrorCode,
    /// What `details.field` says; none if the error is about no field.
    field: Option<String>,
}

impl Bad {
    /// What is sent, as far as it fits a line.
    fn told(&self) -> String {
        let payload = self.payload.as_deref().unwrap_or_default();
        let text: String = String::from_utf8_lossy(payload).chars().take(200).collect();
        format!("{} {text}", self.selector)
    }
}

/// The lines of a table that are not empty or remarks, each cut into `columns` words and the rest.
fn lines(table: &str, columns: usize) -> impl Iterator<Item = (Vec<&str>, &str)> {
    let lines = table.lines();
    let rows = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
    rows.map(move |line| {
        let mut rest = line;
        let words = (0..columns).map(|_| {
            let (word, others) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
            rest = others.trim_start();
            word
        });
        (words.collect(), rest)
    })
}

fn code(name: &str) -> ErrorCode {
    serde_json::from_value(json!(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn field(name: &str) -> Option<String> {
    (name != "-").then(|| name.to_owned())
}

fn to_keys(table: &'static str, key_of: fn(&str) -> String) -> impl Iterator<Item = Bad> {
    lines(table, 3).map(move |(words, payload)| Bad {
        selector: key_of(words[0]),
        payload: Some(payload.as_bytes().to_vec()),
        code: code(words[1]),
        field: field(words[2]),
    })
}

/// Every bad request there is a line for.
fn written_down() -> Vec<Bad> {
    let to_a_swarm = to_keys(TO_A_SWARM, |verb| keys::cmd(PREFIX, "victim", verb));
    let to_the_node = to_keys(TO_THE_NODE, |verb| keys::node_cmd(PREFIX, NODE, verb));
    let selectors = lines(SELECTORS, 3).map(|(words, _)| Bad {
        selector: words[0].to_owned(),
        payload: None,
        code: code(words[1]),
        field: field(words[2]),
    });
    to_a_swarm.chain(to_the_node).chain(selectors).collect()
}

/// What is wrong with an answer to a bad request.
fn wrong_with(answer: Option<Answer>, bad: &Bad) -> Option<String> {
    let error = match answer {
        None => return Some("was not answered".into()),
        Some(Ok(reply)) => return Some(format!("was accepted: {reply}")),
        Some(Err(error)) => error,
    };
    let named = error.details.get("field").and_then(Value::as_str);
    if error.code != bad.code || named != bad.field.as_deref() {
        let Bad { code, field, .. } = bad;
        return Some(format!("{code:?} {field:?} expected: {error:?}"));
    }
    if error.message.is_empty() || error.message.chars().count() > 1000 {
        return Some(format!("{} bytes: {error:?}", error.message.len()));
    }
    None
}

/// The one answer to a bad request; silence is none.
async fn answer_to(client: &Client, bad: &Bad) -> Option<Answer> {
    let mut query = client.session.get(&bad.selector).timeout(PATIENCE);
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

/// Sends each, alone on the machine, and looks at the swarm after each.
async fn are_refused(client: &Client, requests: &[Bad]) {
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
        if let Some(problem) = wrong_with(answer, bad) {
            wrong.push(format!("{}: {problem}", bad.told()));
        }
        let victim = standing("victim").await;
        if victim != stood {
            wrong.push(format!("{}: changed the swarm to {victim:?}", bad.told()));
            stood = victim;
        }
    }
    println!(
        "{} requests refused, the slowest after {slowest:?}",
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

/// Two swarms as the tables have them: at step 20, with one change behind them.
async fn stand(client: &Client, names: &[&str; 2]) {
    for (name, id) in names.iter().zip(["taken", "other"]) {
        client.create(name, json!({"n": 10, "seed": 4})).await;
        client.ok(name, "step", json!({"steps": 20})).await;
        let request = json!({"client": "me", "request_id": id, "args": {"pi3": 1}});
        client.ok(name, "set", request).await;
    }
}

/// A daemon with a swarm and its twin.
async fn victim_and_twin() -> Daemon {
    let daemon = Daemon::for_measuring().await;
    stand(&daemon.client, &["victim", "twin"]).await;
    daemon
}

/// Whether nothing was created, told or scheduled, and both swarms still have one future.
async fn are_still_twins(client: &Client) {
    let swarms = client.node("swarms").await;
    assert_eq!(swarms["swarms"].as_array().unwrap().len(), 2);
    let told = async |swarm: &str| client.get(swarm, "events").await["result"]["newest"].clone();
    assert_eq!(told("victim").await, told("twin").await);
    for name in ["victim", "twin"] {
        client.ok(name, "step", json!({"steps": 20})).await;
    }
    assert_eq!(client.hash("victim").await, client.hash("twin").await);
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_requests_are_refused_by_name_at_once_and_change_nothing() {
    let _alone = alone().await;
    let requests = written_down();
    let mut sent: Vec<_> = requests
        .iter()
        .map(|bad| (&bad.selector, &bad.payload))
        .collect();
    sent.sort_unstable();
    sent.dedup();
    assert_eq!(sent.len(), requests.len(), "one is there twice");
    assert!(requests.len() >= 200, "{}", requests.len());

    let daemon = victim_and_twin().await;
    are_refused(&daemon.client, &requests).await;
    are_still_twins(&daemon.client).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_huge_or_no_text_is_refused_as_quickly() {
    let _alone = alone().await;
    let daemon = victim_and_twin().await;
    let client = &daemon.client;
    // As long as a request may be, and as long as a message may be.
    are_refused(client, &made_up::all(250_000)).await;
    are_refused(client, &made_up::too_long(1_000_000)).await;

    // What is larger than a message may be vanishes on the way, and the link stays.
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
async fn a_request_id_that_is_taken_is_taken_on_every_key() {
    let _alone = alone().await;
    let daemon = victim_and_twin().await;
    let client = &daemon.client;
    let again = json!({"client": "me", "request_id": "taken", "args": {"pi3": 1}});
    let (code, _) = client.err("twin", "set", again).await;
    assert_eq!(code, ErrorCode::Conflict);
    let create = json!({"client": "me", "request_id": "taken",
        "args": {"name": "new", "spec": {"n": 1}}});
    let key = keys::node_cmd(PREFIX, NODE, "create");
    let answer = client.one(&key, Some(create.to_string().as_bytes())).await;
    assert_eq!(answer.unwrap_err().code, ErrorCode::Conflict);
    are_still_twins(client).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn memory_is_admitted_before_it_is_taken() {
    let daemon = Daemon::with(&[
        ("max_swarms", "4"),
        ("max_memory_mb", "7"),
        ("max_individuals", "1000000"),
    ])
    .await;
    let client = &daemon.client;
    let check = |told: &str, answer: Answer, code: ErrorCode, named: &str| match answer {
        Ok(reply) => panic!("{told}: was accepted: {reply}"),
        Err(error) => {
            assert_eq!(error.code, code, "{told}: {error:?}");
            assert!(error.message.contains(named), "{told}: {error:?}");
        }
    };
    let key = format!("jostle/@node/{NODE}/cmd/create");
    let create = async |name: &str, n: u64| {
        let request = json!({"name": name, "spec": {"n": n}}).to_string();
        client.one(&key, Some(request.as_bytes())).await
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
    // What was taken out may be taken by others, and is then not there for a reset.
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
    // Growing is admitted like creating.
    let answer = client.cmd("a", "inject", json!({"count": 5000})).await;
    check("inject", answer, ResourceExhausted, "max_memory_mb");
    daemon.stop().await;
}
