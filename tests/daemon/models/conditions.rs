//! Conditions that hold at other steps under this version than under the earlier one.

use std::sync::Arc;

use jostled::swarm::journal::Record;
use serde_json::{Value, json};

use super::folders::{EARLIER, aged, killed};
use crate::support::Client;
use crate::support::daemon_process::{StoreCopy, start};
use crate::when;

const ONE: &str = "\"ids\":[0]";
const FIVE: &str = "\"ids\":[0,1,2,3,4]";

/// The record of an `inform` of one individual in place of five, after which the orders of all steps are others.
fn informs_one(record: Record) -> Record {
    let Record::Input {
        at_step,
        sender,
        seq,
        unix_secs,
    } = record
    else {
        return record;
    };
    let mut sender = (*sender).clone();
    if sender.verb == "inform" {
        assert!(sender.args.contains(FIVE), "{}", sender.args);
        sender.args = sender.args.replace(FIVE, ONE);
    }
    Record::Input {
        at_step,
        sender: Arc::new(sender),
        seq,
        unix_secs,
    }
}

/// Creates a swarm that pauses on a condition, and informs individuals.
async fn begin(client: &Client, name: &str, ids: &[u32]) {
    client.create(name, when::spec()).await;
    let inform = json!({"select": {"ids": ids}, "direction": 1.0});
    client.ok(name, "inform", inform).await;
    client.ok(name, "when", when::pause(when::CONDITION)).await;
}

async fn assert_upgraded(client: &Client, step: u64, seq: u64, when: Value) {
    let status = client.get("school", "status").await;
    let marks = &status["result"]["earlier_models"];
    assert_eq!(marks[0]["model_version"], EARLIER, "{status}");
    let at = (&status["phase"], &status["step"], &status["seq"]);
    assert_eq!(
        at,
        (&json!("paused"), &json!(step), &json!(seq)),
        "{status}"
    );
    assert_eq!(status["result"]["when"], when, "{status}");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_that_has_held_is_executed_at_its_step_though_it_would_not_hold_there() {
    let step = when::expected_step();
    let folder = killed(async |client: &Client| {
        begin(client, "school", &[0, 1, 2, 3, 4]).await;
        client.ok("school", "run", json!({"rate": null})).await;
        client.get("school", "wait?phase=paused").await;
        client
            .ok("school", "annotate", json!({"text": "here"}))
            .await;
    })
    .await;
    let aged = aged(folder.path(), informs_one);
    assert_eq!(StoreCopy::of(aged.path()).newest_checkpoint("school").1, 0);
    let (_process, client) = start(aged.path()).await;
    // `inform`, `when`, `run`, `fired` and `annotate`.
    assert_upgraded(&client, step, 5, Value::Null).await;
    let status = client.get("school", "status").await;
    assert_eq!(status["result"]["reason"], "condition", "{status}");
    client.ok("school", "step", json!({"steps": 10})).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_that_would_have_held_before_holds_at_the_next_step() {
    let mut step = 0;
    let folder = killed(async |client: &Client| {
        begin(client, "twin", &[0]).await;
        client.ok("twin", "run", json!({"rate": null})).await;
        let paused = client.get("twin", "wait?phase=paused").await;
        step = paused["step"].as_u64().unwrap() + 20;
        client.ok("twin", "delete", json!({})).await;
        assert!(step < when::expected_step());
        begin(client, "school", &[0, 1, 2, 3, 4]).await;
        client.ok("school", "step", json!({"steps": step})).await;
        let last = json!({"text": "here"});
        client.ok("school", "annotate", last).await;
    })
    .await;
    let aged = aged(folder.path(), informs_one);
    assert_eq!(StoreCopy::of(aged.path()).newest_checkpoint("school").1, 0);
    let (_process, client) = start(aged.path()).await;
    assert_upgraded(&client, step, 4, json!([when::CONDITION])).await;
    client.ok("school", "run", json!({"rate": null})).await;
    let status = client.get("school", "wait?phase=paused").await;
    assert_eq!(status["step"], step + 1, "{status}");
    assert_eq!(status["result"]["reason"], "condition", "{status}");
}
