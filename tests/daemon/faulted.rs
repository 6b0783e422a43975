//! What a faulted swarm executes, before and after a kill, is what the table of phases in
//! `proto/README.md` says.

use std::collections::BTreeMap;
use std::fs;

use jostle_contract::{fixtures, folder};
use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::support::daemon_process::{self, killed};
use crate::support::{Client, PREFIX};

/// Whether the table says that a faulted swarm executes it, of each verb.
fn executed() -> BTreeMap<String, bool> {
    let text = fs::read_to_string(folder().join("README.md")).unwrap();
    let (_, table) = text.split_once("| verb | `paused`").unwrap();
    let mut executed = BTreeMap::new();
    for row in table.lines().skip(2).take_while(|it| it.starts_with('|')) {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let verbs = cells[1].split('`').skip(1).step_by(2);
        let is_executed = !cells[4].starts_with("`incorrect_state`");
        // `get` is every query.
        let verbs = verbs.filter(|verb| *verb != "get");
        executed.extend(verbs.map(|verb| (verb.to_owned(), is_executed)));
    }
    executed
}

/// The arguments of a verb in its fixture.
fn args(verb: &str) -> Value {
    let message = format!("{verb}.args");
    let mut of_verb = fixtures().unwrap().into_iter();
    let (.., text) = of_verb.find(|it| it.0 == message).unwrap();
    serde_json::from_str(&text).unwrap()
}

async fn status(client: &Client, name: &str) -> [Value; 5] {
    let status = client.get(name, "status").await;
    let result = &status["result"];
    [
        status["phase"].clone(),
        status["seq"].clone(),
        result["state_hash"].clone(),
        result["fault"].clone(),
        result["protected"].clone(),
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn a_faulted_swarm_executes_what_the_table_of_phases_says_before_and_after_a_kill() {
    let executed = executed();
    let verbs: Vec<&str> = executed.keys().map(String::as_str).collect();
    let mut known = keys::SWARM_VERBS;
    known.sort_unstable();
    assert_eq!(verbs, known);

    let folder = tempfile::tempdir().unwrap();
    let mut running = daemon_process::start(folder.path()).await;
    crate::commands::fault(&running.1, "a").await;
    for time in ["before", "after"] {
        let client = &running.1;
        for (verb, is_executed) in &executed {
            // Below, since they end the fault or the swarm.
            if ["reset", "delete"].contains(&verb.as_str()) {
                continue;
            }
            let before = status(client, "a").await;
            let mut args = args(verb);
            if verb == "fork" {
                args["name"] = json!(format!("copy-{time}"));
            }
            let reply = client
                .query(
                    &keys::cmd(PREFIX, "a", verb),
                    Some(args.to_string().as_bytes()),
                )
                .await;
            match reply {
                Ok(_) => assert!(is_executed, "{verb}"),
                Err(error) => {
                    assert!(!is_executed, "{verb}: {error:?}");
                    // No controller has joined, which is said first.
                    let code = match verb.as_str() {
                        "advance" => ErrorCode::NotFound,
                        _ => ErrorCode::IncorrectState,
                    };
                    assert_eq!(error.code, code, "{verb}: {error:?}");
                    assert_eq!(status(client, "a").await, before, "{verb}");
                }
            }
        }
        let before = status(client, "a").await;
        assert_eq!(before[0], "faulted");
        running = killed(folder.path(), running).await;
        assert_eq!(status(&running.1, "a").await, before, "{time}");
    }
    let client = &running.1;
    client.ok("a", "protect", json!({"on": false})).await;
    client.ok("a", "reset", json!({})).await;
    assert_eq!(status(client, "a").await[0], "paused");
    crate::commands::fault_soon(client, "a").await;
    client.ok("a", "delete", json!({})).await;
}
