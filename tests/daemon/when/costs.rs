//! Conditions whose measures cost much.

use jostle_proto::{ErrorCode, Snapshot};
use serde_json::{Value, json};

use super::{pause, restore, snapshot_of, spec, verifies};
use crate::support::Client;
use crate::support::daemon_process::{killed, log, start};

/// A condition that never holds, on the clusters of a gap of its own.
fn clusters(k: u32) -> String {
    format!("clusters.count(0.0{k}) > 99")
}

/// The conditions that wait, each with whether it is evaluated.
async fn conditions(client: &Client, swarm: &str) -> Vec<(String, bool)> {
    let status = client.get(swarm, "status").await;
    let all = status["result"]["conditions"].as_array().cloned();
    let all = all.unwrap_or_default().into_iter();
    all.map(|it| {
        let condition = it["condition"].as_str().unwrap().to_owned();
        // The field is left out if it is.
        assert!([Value::Null, json!(false)].contains(&it["evaluated"]));
        (condition, it["evaluated"].is_null())
    })
    .collect()
}

async fn rejected(client: &Client, request: Value) {
    let (code, message) = client.err("a", "when", request.clone()).await;
    assert_eq!(code, ErrorCode::ResourceExhausted, "{request}: {message}");
    assert!(message.contains("after every step"), "{message}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scheduled_condition_that_costs_too_much_is_rejected_and_stays_so() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let client = &daemon.1;
    client.create("a", spec()).await;
    let at = |at_step: u64, k: u32| json!({"at_step": at_step, "args": pause(&clusters(k))});
    client.ok("a", "when", pause(&clusters(1))).await;
    // Beside one that waits.
    rejected(client, at(30, 2)).await;
    client.ok("a", "when", json!({"cancel": true})).await;
    // Beside one that is scheduled, at the same step and now; equal ones cost nothing more.
    client.ok("a", "when", at(30, 3)).await;
    rejected(client, at(30, 4)).await;
    rejected(client, pause(&clusters(5))).await;
    client.ok("a", "when", at(40, 3)).await;
    let journal = client.get("a", "journal").await;
    let entries = journal["result"]["entries"].as_array().unwrap().len();

    daemon = killed(folder.path(), daemon).await;
    let client = &daemon.1;
    let status = client.get("a", "status").await["result"].take();
    assert_eq!(status["scheduled"], 2, "{status}");
    client.ok("a", "fork", json!({"name": "forked"})).await;
    for name in ["a", "forked"] {
        client.ok(name, "step", json!({"steps": 60})).await;
        assert_eq!(conditions(client, name).await, [(clusters(3), true)]);
        verifies(client, name).await;
    }
    client
        .ok("a", "fork", json!({"name": "earlier", "step": 35}))
        .await;
    client.ok("earlier", "step", json!({"steps": 25})).await;
    assert_eq!(conditions(client, "earlier").await, [(clusters(3), true)]);
    let hash = client.hash("a").await;
    for name in ["forked", "earlier"] {
        assert_eq!(client.hash(name).await, hash, "{name}");
    }
    // The step, and the two that were scheduled.
    let journal = client.get("a", "journal").await;
    let after = journal["result"]["entries"].as_array().unwrap().len();
    assert_eq!(after, entries + 3, "{journal}");
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn one_condition_may_compare_what_several_may_not() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let client = &daemon.1;
    client.create("a", spec()).await;
    let both = "front > 0.9 and clusters.count < 3";
    client.ok("a", "when", pause(both)).await;
    for part in ["front > 0.8", "clusters.count < 2"] {
        client.ok("a", "when", pause(part)).await;
    }
    rejected(client, pause(&clusters(1))).await;
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn stored_conditions_beyond_the_bound_are_shown_and_logged() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let client = &daemon.1;
    client.create("a", spec()).await;
    client.ok("a", "when", pause(&clusters(1))).await;
    // As an earlier version stored it, which accepted all.
    let mut snapshot: Snapshot = ciborium::from_reader(&*snapshot_of(client, "a").await).unwrap();
    for k in 2..=3 {
        let mut more = snapshot.when[0].clone();
        more.sent.args = more.sent.args.replace("0.01", &format!("0.0{k}"));
        snapshot.when.push(more);
    }
    restore(client, &jostle_proto::to_cbor(&snapshot.sealed()), "b").await;
    let before = [
        (clusters(1), true),
        (clusters(2), false),
        (clusters(3), false),
    ];
    assert_eq!(conditions(client, "b").await, before);
    client.ok("b", "step", json!({"steps": 20})).await;
    let logged = |k: u32| {
        let lines = log(folder.path());
        let lines = lines
            .lines()
            .filter(|it| it.contains("a condition is not evaluated"));
        lines.filter(|it| it.contains(&clusters(k))).count()
    };
    assert_eq!([1, 2, 3].map(logged), [0, 1, 1]);
    daemon = killed(folder.path(), daemon).await;
    let client = &daemon.1;
    assert_eq!(conditions(client, "b").await, before);
    // Once the dearer ones are gone, the next is evaluated.
    let status = client.get("b", "status").await["result"].take();
    let cancel = json!({"cancel": true, "id": status["conditions"][0]["id"]});
    client.ok("b", "when", cancel).await;
    assert_eq!(
        conditions(client, "b").await,
        [(clusters(2), true), (clusters(3), false)]
    );
    client.ok("b", "step", json!({"steps": 5})).await;
    verifies(client, "b").await;
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn conditions_of_a_group_that_has_grown_are_not_evaluated() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let client = &daemon.1;
    client.create("a", spec()).await;
    // 10,000 steps of n + 8 poses.
    for condition in ["msd(200) >= 0", "order > 1"] {
        client.ok("a", "when", pause(condition)).await;
    }
    client.ok("a", "inject", json!({"count": 20})).await;
    client.ok("a", "step", json!({"steps": 3})).await;
    let grown = [("msd(200) >= 0".into(), false), ("order > 1".into(), true)];
    assert_eq!(conditions(client, "a").await, grown);
    let remove = json!({"select": {"count": 20}});
    client.ok("a", "remove", remove).await;
    let smaller = [("msd(200) >= 0".into(), true), ("order > 1".into(), true)];
    assert_eq!(conditions(client, "a").await, smaller);
    client.ok("a", "step", json!({"steps": 3})).await;
    assert_eq!(conditions(client, "a").await, smaller);
    daemon.0.kill();
}
