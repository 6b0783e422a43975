//! Playbacks: the effect of each change of state on everything that can be observed.

use jostle_proto::keys;
use serde_json::{Value, json};
use tokio::task::JoinHandle;

use super::{Observation, Served, Table};
use crate::support::playback::{recorded_file, upload_and_open};
use crate::support::streams::subscribe;
use crate::support::{Client, PREFIX, QueryResult, until};

async fn observe(client: &Client) -> Observation {
    let listed = client.node("swarms").await;
    let mut listed = listed["swarms"].as_array().unwrap().iter();
    let listed = listed.any(|it| it["swarm"] == "tape");
    let first = |answers: Vec<QueryResult>| match answers.into_iter().next() {
        Some(answer) => answer.unwrap(),
        None => Value::Null,
    };
    let status = first(
        client
            .query_all(&keys::get(PREFIX, "tape", "status"), None)
            .await,
    );
    let events = first(
        client
            .query_all(&keys::get(PREFIX, "tape", "events"), None)
            .await,
    );
    let state = format!("{}?format=json", keys::state(PREFIX, "tape"));
    let state = first(client.query_all(&state, None).await);
    let result = &status["result"];
    let phase = match &status["phase"] {
        Value::Null => Value::Null,
        phase => json!([phase, result["reason"]]),
    };
    Observation::from([
        ("phase", phase),
        ("frame shown", result["replay"]["frame"].clone()),
        ("position", result["replay"]["position"].clone()),
        ("rate", result["rate"].clone()),
        ("until_step", result["until_step"].clone()),
        ("epoch", status["epoch"].clone()),
        ("step", status["step"].clone()),
        ("seq", status["seq"].clone()),
        ("published frames", state["frame"].clone()),
        ("event number", events["result"]["newest"].clone()),
        ("listed", json!(listed)),
    ])
}

/// The result of a query that waits.
async fn waited(waiter: JoinHandle<Vec<QueryResult>>, has_ended: bool) -> Value {
    if !has_ended && !waiter.is_finished() {
        return json!("waits");
    }
    match waiter.await.unwrap().pop() {
        Some(answer) => json!(format!("{answer:?}")),
        None => json!("no reply"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn each_change_of_a_playback_restarts_and_continues_the_values_in_the_table() {
    let mut table = Table::of("playback");
    for change in [
        "pause",
        "pause, run",
        "seek",
        "pause, seek",
        "to the end",
        "to the end, run",
        "reset",
        "daemon stops, starts",
    ] {
        let data = tempfile::tempdir().unwrap();
        let mut daemon = Served::on(data.path(), "").await;
        let client = &daemon.client;
        let file = recorded_file(client).await;
        upload_and_open(client, "tape", &file).await.unwrap();
        let _states = subscribe(client, keys::state(PREFIX, "tape")).await;
        let made = observe(client).await;
        client.ok("tape", "seek", json!({"step": 10})).await;
        let ends = async || {
            client
                .get("tape", "wait?phase=paused;timeout_secs=20")
                .await;
        };
        let run = json!({"rate": 1000, "until_step": 50});
        client.ok("tape", "run", run).await;
        ends().await;
        // A frame in a hundred seconds: it stays where it is while it runs.
        let run = json!({"rate": 0.001, "until_step": 190});
        client.ok("tape", "run", run).await;
        until("the frames are published", async || {
            observe(client).await["published frames"].as_u64() > Some(2)
        })
        .await;
        let key = keys::get(PREFIX, "tape", "wait?phase=faulted;timeout_secs=30");
        let asking = Client {
            session: client.session.clone(),
        };
        let waiter = tokio::spawn(async move { asking.query_all(&key, None).await });
        let mut before = observe(client).await;
        before.insert("get/wait for a fault", json!("waits"));

        if change.starts_with("pause") {
            client.ok("tape", "pause", json!({})).await;
        }
        if change.starts_with("to the end") {
            client.ok("tape", "pause", json!({})).await;
            client.ok("tape", "run", json!({"rate": 1000})).await;
            ends().await;
            before.insert("rate", json!(1000));
        }
        match change {
            "pause, run" => drop(client.ok("tape", "run", json!({})).await),
            "seek" | "pause, seek" => {
                drop(client.ok("tape", "seek", json!({"step": 100})).await);
            }
            "to the end, run" => {
                let slow = json!({"rate": 0.001});
                drop(client.ok("tape", "run", slow).await);
                before.insert("rate", json!(0.001));
            }
            "reset" => drop(client.ok("tape", "reset", json!({})).await),
            "daemon stops, starts" => {
                daemon.stop();
                daemon = Served::on(data.path(), "").await;
            }
            _ => {}
        }
        let mut after = observe(&daemon.client).await;
        let has_ended = change == "daemon stops, starts";
        after.insert("get/wait for a fault", waited(waiter, has_ended).await);
        table.judge(change, &made, &before, &after);
    }
    table.finish();
}
