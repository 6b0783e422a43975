//! The order in which two controllers advance has no effect; the order in which they join has.

use serde_json::{Value, json};

use super::{advance, join};
use crate::support::{Client, Daemon, until};

/// Exchanges of a run.
const STEPS: u64 = 40;

/// The set-points of an exchange: an individual and a direction of each controller.
type Targets = [(&'static str, u32, f64); 2];

const ADA: (&str, u32, f64) = ("ada", 0, 0.0);
const BOB: (&str, u32, f64) = ("bob", 3, 2.0);

/// Sends an advance of the first controller, and that of the second once the swarm waits for the
/// second alone.
async fn exchange(client: &Client, step: u64, targets: Targets) {
    let [first, second] = targets.map(|(controller, id, direction)| {
        let direction = direction + 0.1 * step as f64;
        let set = json!({"set": {"ids": [id], "direction": [direction]}});
        (controller, advance(client, controller, step, set))
    });
    let (one, other) = tokio::join!(first.1, async {
        until("the swarm waits for the second", async || {
            let status = client.get("a", "status").await;
            let waiting = status["result"]["waiting_for"].as_array().unwrap();
            waiting.len() == 1 && waiting[0]["controller"] == second.0
        })
        .await;
        second.1.await
    });
    for reply in [one, other] {
        assert_eq!(reply.unwrap()["step"], step + 1);
    }
}

/// Runs a swarm that two controllers steer. Returns its hash, and who advanced first in each
/// exchange by the swarm's journal.
async fn run(client: &Client, targets: Targets) -> (String, Vec<String>) {
    client.create("a", json!({"n": 20, "seed": 3})).await;
    join(client, "ada", &[0, 1], json!({})).await;
    join(client, "bob", &[2, 3], json!({})).await;
    for step in 0..STEPS {
        exchange(client, step, targets).await;
    }
    let hash = client.hash("a").await;
    let verified = client.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null, "{verified}");
    let entries = client.get("a", "journal?limit=1000").await["result"]["entries"].take();
    let mut advances: Vec<(u64, u64, String)> = entries
        .as_array()
        .unwrap()
        .iter()
        .filter(|entry| entry["verb"] == "advance")
        .map(|entry| {
            let [step, seq] = ["step", "seq"].map(|field| entry[field].as_u64().unwrap());
            let controller = entry["args"]["controller"].as_str().unwrap();
            (step, seq, controller.to_owned())
        })
        .collect();
    advances.sort();
    assert_eq!(advances.len() as u64, 2 * STEPS);
    let first = advances.chunks(2).map(|both| both[0].2.clone()).collect();
    client.ok("a", "delete", json!({})).await;
    (hash, first)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_order_in_which_controllers_advance_changes_no_bit() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let (hash, first) = run(client, [ADA, BOB]).await;
    assert!(first.iter().all(|it| it == "ada"), "{first:?}");
    let (reversed, first) = run(client, [BOB, ADA]).await;
    assert!(first.iter().all(|it| it == "bob"), "{first:?}");
    assert_eq!(reversed, hash);
    // The hash depends on what each of the two sets, whether it advances first or second.
    for targets in [
        [("ada", 0, 0.5), BOB],
        [ADA, ("bob", 3, 2.5)],
        [("bob", 3, 2.5), ADA],
        [("bob", 3, 0.0), ("ada", 0, 2.0)],
    ] {
        assert_ne!(run(client, targets).await.0, hash, "{targets:?}");
    }
    daemon.stop().await;
}

/// Joins two controllers in this order, each with three individuals that are drawn, and lets them
/// steer apart. Returns the ids of each and the hash.
async fn join_and_steer(daemon: Daemon, controllers: [&str; 2]) -> ([Value; 2], String) {
    let client = &daemon.client;
    client.create("a", json!({"n": 20, "seed": 3})).await;
    let mut ids = Vec::new();
    for controller in controllers {
        let drawn = json!({"controller": controller, "select": {"count": 3}});
        ids.push(client.ok("a", "join", drawn).await["result"]["ids"].take());
    }
    for step in 0..STEPS {
        let towards = |controller: usize| {
            let direction = match controllers[controller] {
                "ada" => [0.0; 3],
                _ => [3.0; 3],
            };
            json!({"set": {"ids": ids[controller], "direction": direction}})
        };
        let (one, other) = tokio::join!(
            advance(client, controllers[0], step, towards(0)),
            advance(client, controllers[1], step, towards(1))
        );
        assert_eq!(
            [one.unwrap()["step"].take(), other.unwrap()["step"].take()],
            [step + 1; 2]
        );
    }
    let hash = client.hash("a").await;
    // A replay takes them in the order in which they joined.
    let verified = client.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null, "{verified}");
    assert_eq!(verified["result"]["hashes"], 1, "the present one");
    daemon.stop().await;
    (ids.try_into().unwrap(), hash)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_first_to_join_draws_first_in_a_replay_too() {
    let (ids, hash) = join_and_steer(Daemon::start().await, ["ada", "bob"]).await;
    let (reversed_ids, reversed) = join_and_steer(Daemon::start().await, ["bob", "ada"]).await;
    assert_ne!(ids[0], ids[1]);
    // The same draws in the same order, for the other controller.
    assert_eq!(ids, reversed_ids);
    assert_ne!(hash, reversed);
}
