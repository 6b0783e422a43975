//! Data folders and snapshots of an earlier version of the model: each swarm goes on from its newest
//! checkpoint under this version, and says so.

mod conditions;
mod downgrade;
mod experiments;
mod fixtures;
mod folders;
mod lab;
mod upgrade;

use std::sync::Arc;

use jostle_physics::model::MODEL_VERSION;
use jostle_proto::{ErrorCode, keys};
use jostled::store::{Settings, Store, Write};
use jostled::swarm::journal::Record;
use serde_json::{Value, json};

use crate::states::swarms;
use crate::support::daemon_process::{self, DaemonProcess};
use crate::support::{Client, Daemon, PREFIX, QueryResult, TIMEOUT, until};

pub use folders::{EARLIER, aged, earlier, killed};

/// The mark of a swarm.
fn mark(epoch: u64, step: u64) -> Value {
    json!([{"model_version": EARLIER, "epoch": epoch, "step": step}])
}

async fn get(client: &Client, swarm: &str, noun: &str) -> QueryResult {
    client.query(&keys::get(PREFIX, swarm, noun), None).await
}

/// Checks that a reply is a conflict with the earlier version.
fn assert_earlier(reply: QueryResult, context: &str) {
    let error = reply.unwrap_err();
    assert_eq!(error.code, ErrorCode::Conflict, "{context}: {error:?}");
    assert_eq!(
        error.details["model_version"], EARLIER,
        "{context}: {error:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_goes_on_from_its_newest_checkpoint_and_is_marked_until_a_reset() {
    let mut before = Value::Null;
    let folder = killed(async |client: &Client| {
        client.create("school", json!({"n": 12, "seed": 3})).await;
        client.ok("school", "step", json!({"steps": 700})).await;
        let inform = json!({"select": {"ids": [1, 3]}, "direction": 1.0});
        client.ok("school", "inform", inform).await;
        client.ok("school", "step", json!({"steps": 40})).await;
        client.ok("school", "set", json!({"pi3": 2.0})).await;
        before = client.get("school", "status").await;
    })
    .await;
    let aged = aged(folder.path(), |record| record);
    let mut marked = Value::Null;
    // The second start goes on from a checkpoint of this version.
    for epoch in 2..=3 {
        let mut process = DaemonProcess::start(&mut daemon_process::daemon(aged.path())).unwrap();
        let client = Client::open(&process.endpoint).await;
        until("the swarm is where it was", async || {
            client.get("school", "status").await["step"] == before["step"]
        })
        .await;
        let status = client.get("school", "status").await;
        for field in ["phase", "seq", "step"] {
            assert_eq!(status[field], before[field], "{field}: {status}");
        }
        assert_eq!(status["epoch"], epoch, "{status}");
        // Here both versions compute the same steps.
        let hash = |status: &Value| status["result"]["state_hash"].clone();
        assert_eq!(hash(&status), hash(&before), "{status}");
        let models = &status["result"]["earlier_models"];
        if epoch == 2 {
            marked = models.clone();
            assert_eq!(marked.as_array().unwrap().len(), 1, "{status}");
            assert_eq!(marked[0]["model_version"], EARLIER);
            let log = daemon_process::log(aged.path());
            assert!(
                log.contains("another version of the model goes on"),
                "{log}"
            );
            let events = client.get("school", "events?limit=1000").await;
            let events = events["result"]["events"].as_array().unwrap().clone();
            let event = json!({"kind": "model", "from": EARLIER, "to": MODEL_VERSION});
            assert!(events.iter().any(|it| it["event"] == event), "{events:?}");
        }
        assert_eq!(*models, marked, "{status}");
        let listed = client.node("swarms").await["swarms"][0].clone();
        assert_eq!(listed["earlier_models"], marked, "{listed}");
        assert_earlier(get(&client, "school", "verify").await, "verify");
        let fork = |name: &str, step: u64| json!({"name": name, "step": step});
        let early = client.cmd("school", "fork", fork("early", 10)).await;
        assert_earlier(early, "an early fork");
        if epoch == 3 {
            client.ok("school", "step", json!({"steps": 30})).await;
            let late = fork("late", before["step"].as_u64().unwrap() + 20);
            client.ok("school", "fork", late).await;
            let copy = client.get("late", "status").await;
            assert_eq!(copy["result"]["earlier_models"], marked, "{copy}");
            assert_earlier(get(&client, "school", "experiment").await, "export");
            client.ok("school", "reset", json!({})).await;
            let status = client.get("school", "status").await;
            assert_eq!(status["result"]["earlier_models"], Value::Null, "{status}");
        }
        process.kill();
    }
}

/// The record with `to` in place of `from` in the arguments, if it is of a command with this verb.
fn with_args(mut record: Record, verb: &str, from: &str, to: &str) -> Record {
    if let Record::Input { sender, .. } = &mut record
        && sender.verb == verb
    {
        let args = sender.args.replace(from, to);
        Arc::make_mut(sender).args = args;
    }
    record
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_after_a_step_in_which_only_this_version_faults_are_events() {
    let folder = killed(async |client: &Client| {
        let spec = json!({"n": 60, "dt": 0.2497, "seed": 2});
        client.create("school", spec).await;
        client.ok("school", "set", json!({"pi4": 5.0})).await;
        client.ok("school", "step", json!({"steps": 20})).await;
        client.ok("school", "set", json!({"pi3": 0.9})).await;
        let later = json!({"at_step": 500, "args": {"pi3": 1.0}});
        client.ok("school", "set", later).await;
        client
            .ok("school", "annotate", json!({"text": "here"}))
            .await;
    })
    .await;
    let aged = aged(folder.path(), |record| {
        with_args(record, "set", "5.0", "1e6")
    });
    let (process, client) = daemon_process::start(aged.path()).await;
    let status = client.get("school", "status").await;
    assert_eq!(
        (&status["phase"], &status["seq"]),
        (&json!("faulted"), &json!(4)),
        "{status}"
    );
    let step = &status["step"];
    assert!(step.as_u64() < Some(20), "{status}");
    assert_eq!(status["result"]["earlier_models"], mark(1, 0), "{status}");
    assert!(status["result"]["fault"].is_object(), "{status}");
    let events = client.get("school", "events?limit=1000").await;
    let events = events["result"]["events"].as_array().unwrap().clone();
    let refused = events.iter().filter(|it| it["event"]["kind"] == "refused");
    let refused: Vec<_> = refused
        .map(|it| (&it["step"], it["event"]["verb"].as_str().unwrap()))
        .collect();
    assert_eq!(refused, [(step, "set"), (step, "set")]);
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_that_this_version_rejects_is_an_event_and_the_swarm_goes_on() {
    let folder = killed(async |client: &Client| {
        client.create("school", json!({"n": 12, "seed": 3})).await;
        client.ok("school", "step", json!({"steps": 20})).await;
        let inform = json!({"select": {"ids": [1, 3]}, "direction": 1.0});
        client.ok("school", "inform", inform).await;
        client.ok("school", "step", json!({"steps": 20})).await;
        client.ok("school", "set", json!({"pi3": 2.0})).await;
    })
    .await;
    // As if only the earlier version knew such individuals.
    let aged = aged(folder.path(), |record| {
        with_args(record, "inform", "[1,3]", "[1,99]")
    });
    let mut process = DaemonProcess::start(&mut daemon_process::daemon(aged.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    until("the swarm is where it was", async || {
        client.get("school", "status").await["step"] == 40
    })
    .await;
    let status = client.get("school", "status").await;
    assert_eq!(
        (&status["phase"], &status["seq"]),
        (&json!("paused"), &json!(4)),
        "{status}"
    );
    let result = &status["result"];
    assert_eq!(result["earlier_models"], mark(1, 0), "{status}");
    assert_eq!(
        (&result["informed"], &result["parameters"]["pi3"]),
        (&json!(0), &json!(2.0))
    );
    let events = client.get("school", "events?limit=1000").await;
    let events = events["result"]["events"].as_array().unwrap().clone();
    let refused = events.iter().find(|it| it["event"]["kind"] == "refused");
    let refused = refused.unwrap_or_else(|| panic!("{events:?}"));
    assert_eq!(
        (&refused["step"], &refused["event"]["verb"]),
        (&json!(20), &json!("inform"))
    );
    let log = daemon_process::log(aged.path());
    assert!(
        log.contains("rejects a command that an earlier one applied"),
        "{log}"
    );
    client.ok("school", "step", json!({"steps": 5})).await;
    process.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_snapshot_of_an_earlier_version_is_restored_and_marked_and_one_of_a_later_is_not() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("school", json!({"n": 12, "seed": 3})).await;
    client.ok("school", "step", json!({"steps": 60})).await;
    let taken = swarms::snapshot(client, "school").await;
    let old = earlier(taken.clone()).sealed();
    swarms::restore(client, "old", &old).await.unwrap();
    let status = client.get("old", "status").await;
    assert_eq!(status["step"], 60);
    assert_eq!(status["result"]["earlier_models"], mark(1, 60), "{status}");
    // Here both versions compute the same steps.
    assert_eq!(status["result"]["state_hash"], taken.state_hash, "{status}");
    client.ok("old", "step", json!({"steps": 5})).await;
    // A swarm that is saved again keeps the mark.
    let again = swarms::snapshot(client, "old").await;
    assert_eq!(again.model_version, MODEL_VERSION);
    swarms::restore(client, "again", &again).await.unwrap();
    let status = client.get("again", "status").await;
    assert_eq!(status["result"]["earlier_models"], mark(1, 60), "{status}");
    // Its hash is that of its own version.
    let mut other = old.clone();
    other.state_hash = taken.state_hash.clone();
    let mut later = taken;
    later.model_version = MODEL_VERSION + 1;
    for (wrong, problem) in [(other, "hash"), (later, "of the model")] {
        let error = swarms::restore(client, "wrong", &wrong.sealed())
            .await
            .unwrap_err();
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{error:?}");
        assert!(error.message.contains(problem), "{error:?}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_whose_reply_an_earlier_version_lost_is_not_executed_again() {
    let named = |id: &str, args: Value| json!({"client": "me", "request_id": id, "args": args});
    let early = named("early", json!({"text": "early"}));
    let late = named("late", json!({"text": "late"}));
    let mut first = Value::Null;
    let folder = killed(async |client: &Client| {
        client.create("school", json!({"n": 5})).await;
        client.ok("school", "annotate", early.clone()).await;
        client
            .ok("school", "step", named("steps", json!({"steps": 20_000})))
            .await;
        first = client.ok("school", "annotate", late.clone()).await;
    })
    .await;
    // As if the daemon had been killed before the replies were durable: one to a command before the newest
    // checkpoint, one after it.
    let aged = aged(folder.path(), |record| record);
    let store = Store::open(aged.path(), Settings::default(), Box::new(|_| {})).unwrap();
    let newest = store.checkpoints("school").unwrap()[0];
    assert!(newest.step > 0);
    let lost = ["early", "late"].map(|id| Write::DeleteReply {
        client: Some("me".to_owned()),
        request_id: id.to_owned(),
    });
    store.commit(lost.into()).unwrap();
    assert!(store.stop(TIMEOUT));
    let (_process, client) = daemon_process::start(aged.path()).await;
    let seq = client.get("school", "status").await["seq"].clone();
    assert_eq!(seq, 3);
    for _ in 0..2 {
        assert_earlier(
            client.cmd("school", "annotate", early.clone()).await,
            "early",
        );
        assert_eq!(client.ok("school", "annotate", late.clone()).await, first);
    }
    assert_eq!(client.get("school", "status").await["seq"], seq);
}
