//! Experiments: what a change of state does to each thing that can be observed of them.

use std::collections::BTreeSet;

use serde_json::{Map, Value, json};

use super::{End, Look, Served, Table};
use crate::experiments::{ok, progress, reach, rows, submit};
use crate::support::{Client, beside_others, until};

const TABLE: &str = r#"
| observable             | pause       | pause, resume   | cancel      | cancel, resume  | daemon stops, starts | daemon killed, starts | paused, daemon stops, starts | paused, daemon killed, starts | deleted, submitted again |
|------------------------|-------------|-----------------|-------------|-----------------|----------------------|-----------------------|------------------------------|-------------------------------|--------------------------|
| phase                  | "paused"    | still "running" | "cancelled" | still "running" | still "running"      | still "running"       | still "paused"               | still "paused"                | n/a 1                    |
| runs                   | still 400   | still 400       | still 400   | still 400       | still 400            | still 400             | still 400                    | still 400                     | still 400                |
| finished               | goes on     | goes on         | goes on     | goes on         | goes on              | goes on               | unchanged                    | unchanged                     | 0                        |
| results                | goes on     | goes on         | goes on     | goes on         | goes on              | goes on               | unchanged                    | unchanged                     | n/a 1                    |
| a run has two rows     | still false | still false     | still false | still false     | still false          | still false           | still false                  | still false                   | n/a 1                    |
| as many rows as runs   | still true  | still true      | still true  | still true      | still true           | still true            | still true                   | still true                    | n/a 1                    |
| faulted                | still 0     | still 0         | still 0     | still 0         | still 0              | still 0               | still 0                      | still 0                       | still 0                  |
| share                  | goes on     | goes on         | goes on     | goes on         | goes on              | goes on               | goes on                      | goes on                       | 0                        |
| elapsed_secs           | goes on     | goes on         | goes on     | goes on         | goes on              | goes on               | goes on                      | goes on                       | 0                        |

1: it has no results yet, and begins at once if no other experiment is running
"#;

fn many() -> String {
    "name = \"many\"\nseed = 3\nreplicates = 200\nduration = 60\n[[grid]]\nn = [3, 4]\n".to_owned()
}

async fn look(client: &Client) -> Look {
    // Runs may be finished in between: as many rows as at the one time or the other.
    let before = progress(client, "many").await["finished"].as_u64();
    let rows = rows(client, "many", 1000).await;
    let progress = progress(client, "many").await;
    let name = |row: &Value| row["run"].as_str().unwrap().to_owned();
    let names: BTreeSet<String> = rows.iter().map(name).collect();
    let count = Some(rows.len() as u64);
    let is_right = before <= count && count <= progress["finished"].as_u64();
    let results: Map<String, Value> = rows.iter().map(|row| (name(row), row.clone())).collect();
    Look::from([
        ("phase", progress["phase"].clone()),
        ("runs", progress["runs"].clone()),
        ("finished", progress["finished"].clone()),
        ("a run has two rows", json!(names.len() < rows.len())),
        ("as many rows as runs", json!(is_right)),
        ("results", Value::Object(results)),
        ("faulted", progress["faulted"].clone()),
        ("share", progress["share"].clone()),
        ("elapsed_secs", progress["elapsed_secs"].clone()),
    ])
}

/// Waits until some more runs are finished.
async fn goes_on(client: &Client, before: &Look) {
    let finished = before["finished"].as_u64().unwrap();
    until("it goes on", async || {
        progress(client, "many").await["finished"].as_u64() >= Some(finished + 3)
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn after_each_change_of_an_experiment_what_starts_over_does_and_what_goes_on_does() {
    let _machine = beside_others().await;
    let mut table = Table::read(TABLE);
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
        let made: Look = ["finished", "results", "share", "elapsed_secs"]
            .map(|row| (row, made[row].clone()))
            .into();
        submit(client, &many()).await;
        until("some runs are finished", async || {
            progress(client, "many").await["finished"].as_u64() >= Some(5)
        })
        .await;
        if change.starts_with("paused") {
            act("pause").await;
            until("its runs stand still", async || {
                let before = look(client).await;
                tokio::time::sleep(std::time::Duration::from_millis(50)).await;
                before == look(client).await
            })
            .await;
        }
        let before = look(client).await;
        match change {
            "pause" => drop(act("pause").await),
            "cancel" => drop(act("cancel").await),
            "pause, resume" | "cancel, resume" => {
                act(change.split(',').next().unwrap()).await;
                act("resume").await;
                reach(client, "many", "running").await;
                goes_on(client, &before).await;
            }
            "deleted, submitted again" => {
                act("cancel").await;
                act("delete").await;
                let mut submitted = submit(client, &many()).await;
                assert_eq!(submitted["created"], true);
                let mut after = Look::new();
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
                    reach(&daemon.client, "many", "running").await;
                    goes_on(&daemon.client, &before).await;
                }
            }
        }
        let after = look(&daemon.client).await;
        table.judge(change, &made, &before, &after);
    }
    table.finish();
}
