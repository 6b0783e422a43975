//! Experiments: the effect of each change of state on everything that can be observed.

use std::collections::BTreeSet;
use std::time::Duration;

use serde_json::{Map, Value, json};

use super::{End, Observation, Served, Table};
use crate::experiments::{ok, progress, rows, submit, wait_for_phase};
use crate::support::{Client, until};

fn many() -> String {
    "name = \"many\"\nseed = 3\nreplicates = 2000\nduration = 60\n[[grid]]\nn = [3, 4]\n".to_owned()
}

async fn observe(client: &Client) -> Observation {
    let rows = rows(client, "many", 1000).await;
    let progress = progress(client, "many").await;
    let name = |row: &Value| row["run"].as_str().unwrap().to_owned();
    let names: BTreeSet<String> = rows.iter().map(name).collect();
    // While it runs, runs end between the two queries.
    let is_still = progress["phase"] != "running";
    let without = is_still.then(|| progress["finished"].as_u64().unwrap() - rows.len() as u64);
    let results: Map<String, Value> = rows.iter().map(|row| (name(row), row.clone())).collect();
    Observation::from([
        ("phase", progress["phase"].clone()),
        ("runs", progress["runs"].clone()),
        ("finished", progress["finished"].clone()),
        ("a run has two rows", json!(names.len() < rows.len())),
        ("finished without a row", json!(without)),
        (
            "has run for some time",
            json!(progress["elapsed_secs"].as_f64() > Some(0.0)),
        ),
        ("results", Value::Object(results)),
        ("faulted", progress["faulted"].clone()),
        ("share", progress["share"].clone()),
        ("elapsed_secs", progress["elapsed_secs"].clone()),
    ])
}

/// Waits until some more runs are finished.
async fn assert_continues(client: &Client, before: &Observation) {
    let finished = before["finished"].as_u64().unwrap();
    until("it goes on", async || {
        progress(client, "many").await["finished"].as_u64() >= Some(finished + 3)
    })
    .await;
}

/// Waits until the step that each run is at is finished.
async fn stands_still(client: &Client) {
    until("its runs stand still", async || {
        let before = observe(client).await;
        tokio::time::sleep(Duration::from_millis(50)).await;
        before == observe(client).await
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_change_of_an_experiment_restarts_and_continues_the_values_in_the_table() {
    let mut table = Table::of("experiments");
    for change in [
        "pause",
        "pause, resume",
        "cancel",
        "cancel, resume",
        "daemon stops, starts",
        "daemon killed, starts",
        "paused, daemon stops, starts",
        "paused, daemon killed, starts",
        "deleted, submitted again",
    ] {
        let data = tempfile::tempdir().unwrap();
        let mut daemon = Served::on(data.path(), "").await;
        let client = &daemon.client;
        let name = json!({"name": "many"});
        let act = async |what: &str| ok(client, json!({what: name})).await;
        let made = json!({"finished": 0, "results": {}, "share": 0, "elapsed_secs": 0});
        let made: Observation = ["finished", "results", "share", "elapsed_secs"]
            .map(|row| (row, made[row].clone()))
            .into();
        submit(client, &many()).await;
        until("some runs are finished", async || {
            progress(client, "many").await["finished"].as_u64() >= Some(5)
        })
        .await;
        if change.starts_with("paused") {
            act("pause").await;
            stands_still(client).await;
        }
        let before = observe(client).await;
        match change {
            "pause" => {
                act("pause").await;
                stands_still(client).await;
            }
            "cancel" => drop(act("cancel").await),
            "pause, resume" | "cancel, resume" => {
                act(change.split(',').next().unwrap()).await;
                act("resume").await;
                wait_for_phase(client, "many", "running").await;
                assert_continues(client, &before).await;
            }
            "deleted, submitted again" => {
                act("cancel").await;
                act("delete").await;
                let mut submitted = submit(client, &many()).await;
                assert_eq!(submitted["created"], true);
                let mut after = Observation::new();
                for row in [
                    "phase",
                    "runs",
                    "finished",
                    "faulted",
                    "share",
                    "elapsed_secs",
                ] {
                    after.insert(row, submitted["progress"][row].take());
                }
                after.insert(
                    "has run for some time",
                    json!(after["elapsed_secs"].as_f64() > Some(0.0)),
                );
                table.judge(change, &made, &before, &after);
                continue;
            }
            _ => {
                daemon.end(match change.contains("stops") {
                    true => End::Stop,
                    false => End::Kill,
                });
                daemon = Served::on(data.path(), "").await;
                if !change.starts_with("paused") {
                    wait_for_phase(&daemon.client, "many", "running").await;
                    assert_continues(&daemon.client, &before).await;
                }
            }
        }
        let after = observe(&daemon.client).await;
        table.judge(change, &made, &before, &after);
    }
    table.finish();
}
