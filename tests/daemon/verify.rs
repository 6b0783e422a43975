//! A journal that was altered in the store and sealed again: `verify` names the first hash that
//! differs, and a daemon that replays it faults the swarm there.

use std::path::Path;
use std::sync::Arc;

use jostle_proto::ErrorCode;
use jostled::persistence::writer;
use jostled::store::{Row, Settings, Store, Write};
use jostled::swarm::journal::Record;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::support::daemon_process::{self, DaemonProcess};
use crate::support::{Client, TIMEOUT, until};

/// What is altered in the journal of swarm `a`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alteration {
    Nothing,
    /// The hash that is journaled for this epoch and step.
    Hash(u64, u64),
    /// The direction of the `inform` that was executed at this epoch and step.
    Direction(u64, u64),
}

/// The last step of the swarm, in the second epoch.
const LAST: u64 = 1150;

/// Runs `a` and `b` to the step [`LAST`] of epoch 2 and stops the daemon. Hashes are journaled at
/// the steps 500 and 1000 of both epochs; commands are executed at the steps 600 and 1100.
pub async fn fill(folder: &Path) -> [String; 2] {
    let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder)).unwrap();
    let client = Client::open(&process.endpoint).await;
    let mut hashes = Vec::new();
    for swarm in ["a", "b"] {
        client.create(swarm, json!({"n": 5, "seed": 7})).await;
        for epoch in 1..=2 {
            for steps in [600, 500, LAST - 1100] {
                client.ok(swarm, "step", json!({"steps": steps})).await;
                if steps != LAST - 1100 {
                    let inform = json!({"select": {"ids": [1, 3]}, "direction": 1.0});
                    client.ok(swarm, "inform", inform).await;
                }
            }
            if epoch == 1 {
                client.ok(swarm, "reset", json!({})).await;
            }
        }
        hashes.push(client.hash(swarm).await);
    }
    client.session.close().await.unwrap();
    process.stop();
    assert_eq!(process.end(), Some(0));
    hashes.try_into().unwrap()
}

/// Copies the database of a stopped daemon and writes swarm `a` again with the alteration, by the
/// store, which seals every row. Without `keeps_checkpoints` only the first checkpoint is kept, with
/// it also those of the reset and of the stop.
pub fn altered(folder: &Path, alteration: Alteration, keeps_checkpoints: bool) -> TempDir {
    let copy = tempfile::tempdir().unwrap();
    daemon_process::copy(folder, copy.path());
    let settings = Settings::default();
    let store = Store::open(copy.path(), settings, Box::new(|_| {})).unwrap();
    let swarm = "a".to_owned();
    let mut swarms = store.swarms().unwrap().into_iter();
    let (_, about) = swarms.find(|(name, _)| *name == swarm).unwrap();
    let mut marks = store.checkpoints(&swarm).unwrap();
    let checkpoint = |number| store.checkpoint(&swarm, number).unwrap();
    let first = checkpoint(marks.pop().unwrap().number);
    // A slow machine keeps others, from which a replay would begin too late to meet the alteration.
    marks.retain(|mark| keeps_checkpoints && [0, LAST].contains(&mark.step));
    assert_eq!(first.number, 0, "the whole history is kept");
    let rows = store.rows(&swarm, 0, usize::MAX >> 1).unwrap();
    assert_eq!(rows.damaged_at, None);
    let mut writes = vec![
        Write::Delete {
            swarm: swarm.clone(),
        },
        Write::Create {
            swarm: swarm.clone(),
            about,
            first,
        },
    ];
    let mut count = 0;
    for mut row in rows.rows {
        count += usize::from(alter(&mut row, alteration));
        let number = row.number;
        writes.push(Write::Append {
            swarm: swarm.clone(),
            row,
        });
        if marks.iter().any(|mark| mark.number == number) {
            writes.push(Write::SaveCheckpoint {
                swarm: swarm.clone(),
                checkpoint: checkpoint(number),
            });
        }
    }
    assert_eq!(count, usize::from(alteration != Alteration::Nothing));
    store.commit(writes).unwrap();
    assert!(store.stop(TIMEOUT));
    copy
}

/// Alters a row if the alteration is about it. Returns whether it is.
fn alter(row: &mut Row, alteration: Alteration) -> bool {
    let place = (row.epoch, row.step);
    let record = match (writer::read_record(&row.body).unwrap(), alteration) {
        (Record::Hash(mut hash), Alteration::Hash(epoch, step)) if place == (epoch, step) => {
            hash[31] ^= 1;
            Record::Hash(hash)
        }
        (
            Record::Input {
                at_step,
                sender,
                seq,
                unix_secs,
            },
            Alteration::Direction(epoch, step),
        ) if place == (epoch, step) && sender.verb == "inform" => {
            let mut sender = (*sender).clone();
            let mut args: Value = serde_json::from_str(&sender.args).unwrap();
            assert_eq!(args["direction"], 1.0);
            args["direction"] = json!(1.5);
            sender.args = args.to_string();
            Record::Input {
                at_step,
                sender: Arc::new(sender),
                seq,
                unix_secs,
            }
        }
        _ => return false,
    };
    row.body = writer::record(&record).1;
    true
}

async fn verified(client: &Client, swarm: &str) -> Value {
    client.get(swarm, "verify").await["result"].take()
}

/// What `verify` replied: the epoch and step of the first difference.
fn difference(verified: &Value) -> Option<(u64, u64)> {
    let [epoch, step] = ["differs_in_epoch", "differs_at"].map(|field| verified[field].as_u64());
    assert_eq!(epoch.is_some(), step.is_some(), "{verified}");
    epoch.zip(step)
}

#[tokio::test(flavor = "multi_thread")]
async fn verify_names_the_epoch_and_step_of_the_first_hash_that_differs() {
    let folder = tempfile::tempdir().unwrap();
    let [hash, other_hash] = fill(folder.path()).await;
    // The restart begins epoch 3, and the present state is compared there.
    for (alteration, expected, compared) in [
        (Alteration::Nothing, None, 5),
        (Alteration::Hash(1, 500), Some((1, 500)), 3),
        (Alteration::Hash(1, 1000), Some((1, 1000)), 4),
        (Alteration::Hash(2, 500), Some((2, 500)), 3),
        (Alteration::Hash(2, 1000), Some((2, 1000)), 4),
        // An altered command is detected at the first hash after it in its epoch.
        (Alteration::Direction(1, 600), Some((1, 1000)), 4),
        (Alteration::Direction(2, 600), Some((2, 1000)), 4),
        (Alteration::Direction(2, 1100), Some((3, LAST)), 5),
        // No hash follows it before the reset, which starts over from the seed.
        (Alteration::Direction(1, 1100), None, 5),
    ] {
        let altered = altered(folder.path(), alteration, true);
        let mut process =
            DaemonProcess::start(&mut daemon_process::daemon(altered.path())).unwrap();
        let client = Client::open(&process.endpoint).await;
        let status = client.get("a", "status").await;
        // The last checkpoint has the state of the stop: nothing is replayed.
        assert_eq!(status["phase"], "paused", "{alteration:?}: {status}");
        assert_eq!(status["result"]["state_hash"], hash, "{alteration:?}");
        let replied = verified(&client, "a").await;
        let context = format!("{alteration:?}: {replied}");
        assert_eq!(difference(&replied), expected, "{context}");
        assert_eq!(replied["hashes"], compared, "{context}");
        // A state whose hash differs is not forked.
        let fork = json!({"name": "c", "step": 1000});
        let forked = client.cmd("a", "fork", fork).await;
        match expected {
            Some((2, step)) => {
                let error = forked.unwrap_err();
                assert_eq!(error.code, ErrorCode::Conflict, "{error:?}");
                let named = format!("step {step} has another hash");
                assert!(error.message.contains(&named), "{error:?}");
            }
            _ => assert_eq!(forked.unwrap()["step"], 1000),
        }
        assert_eq!(difference(&verified(&client, "b").await), None);
        assert_eq!(client.hash("b").await, other_hash);
        process.kill();
    }
}

/// The status of a swarm once it does not run.
async fn status_once_paused(client: &Client, swarm: &str) -> Value {
    let mut status = Value::Null;
    until("the swarm does not run", async || {
        status = client.get(swarm, "status").await;
        status["phase"] != "running"
    })
    .await;
    status
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_faults_the_swarm_at_the_first_hash_that_differs() {
    let folder = tempfile::tempdir().unwrap();
    let [hash, other_hash] = fill(folder.path()).await;
    for (alteration, expected) in [
        (Alteration::Nothing, None),
        (Alteration::Hash(2, 500), Some(500)),
        (Alteration::Hash(2, 1000), Some(1000)),
        (Alteration::Direction(2, 600), Some(1000)),
        // No hash follows it: the swarm is restored to another state, unnoticed.
        (Alteration::Direction(2, 1100), None),
    ] {
        let altered = altered(folder.path(), alteration, false);
        // A second restart has the same result.
        for epoch in 3..=4 {
            let mut process =
                DaemonProcess::start(&mut daemon_process::daemon(altered.path())).unwrap();
            let client = Client::open(&process.endpoint).await;
            // The last `step` of the journal may still be executed.
            let status = status_once_paused(&client, "a").await;
            let context = format!("{alteration:?}: {status}");
            assert_eq!(status["epoch"], epoch, "{context}");
            let same = alteration == Alteration::Nothing;
            match expected {
                Some(step) => {
                    assert_eq!(status["phase"], "faulted", "{context}");
                    assert_eq!(status["step"], step, "{context}");
                    let reason = status["result"]["reason"].as_str().unwrap();
                    let named = format!("step {step} has another hash");
                    assert!(reason.contains(&named), "{context}");
                }
                None => {
                    assert_eq!(status["phase"], "paused", "{context}");
                    assert_eq!(status["step"], LAST, "{context}");
                    let is_same = status["result"]["state_hash"] == hash;
                    assert_eq!(is_same, same, "{context}");
                }
            }
            let replied = verified(&client, "a").await;
            let named = expected.map(|step| (2, step));
            assert_eq!(difference(&replied), named, "{alteration:?}: {replied}");
            let other = status_once_paused(&client, "b").await;
            assert_eq!(other["phase"], "paused", "{other}");
            assert_eq!(other["result"]["state_hash"], other_hash, "{other}");
            if epoch == 4 && expected.is_some() {
                let (code, _) = client.err("a", "step", json!({})).await;
                assert_eq!(code, ErrorCode::IncorrectState);
                client.ok("a", "reset", json!({})).await;
                let stepped = client.ok("a", "step", json!({"steps": 2})).await;
                assert_eq!(stepped["step"], 2);
            }
            process.kill();
        }
    }
}
