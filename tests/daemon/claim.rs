//! The paper's result: ten informed individuals lead fifty through contact alone.

use serde_json::{Value, json};

use crate::support::{Client, Daemon};

const SEEDS: u64 = 24;
const INFORMED_AT: u64 = 50 * 50;
const FROM: u64 = 200 * 50;
const TO: u64 = 400 * 50;

/// The sum over all steps so far of the velocity towards +x.
async fn distance_travelled(client: &Client, name: &str, step: u64) -> f64 {
    client.ok(name, "run", json!({"until_step": step})).await;
    let status = client.wait_for_step(name, step).await;
    assert_eq!(status["step"], step);
    assert_eq!(status["result"]["certificate"]["degraded"], 0, "{status}");
    status["result"]["order"]["mean_velocity"][0]
        .as_f64()
        .unwrap()
        * step as f64
}

/// The mean drift towards +x over t = 200 to 400.
async fn drift(client: &Client, seed: u64, informed: bool) -> f64 {
    let name = format!("seed-{seed}-{informed}");
    let spec = json!({"n": 50, "pi1": 4, "seed": seed, "rate": Value::Null});
    client.create(&name, spec).await;
    distance_travelled(client, &name, INFORMED_AT).await;
    if informed {
        client
            .ok(
                &name,
                "inform",
                json!({"select": {"count": 10}, "direction": 0}),
            )
            .await;
    }
    let before = distance_travelled(client, &name, FROM).await;
    let after = distance_travelled(client, &name, TO).await;
    client.ok(&name, "delete", json!({})).await;
    (after - before) / (TO - FROM) as f64
}

/// The drifts of every seed, two swarms at a time.
async fn drift_of_each_seed(informed: bool) -> Vec<f64> {
    let daemon = Daemon::start().await;
    let mut halves = Vec::new();
    for half in 0..2 {
        let client = daemon.another_client().await;
        halves.push(tokio::spawn(async move {
            let mut drifts = Vec::new();
            for seed in (1..=SEEDS).filter(|seed| seed % 2 == half) {
                drifts.push((seed, drift(&client, seed, informed).await));
            }
            drifts
        }));
    }
    let mut drifts = Vec::new();
    for half in halves {
        drifts.extend(half.await.unwrap());
    }
    daemon.stop().await;
    drifts.sort_by_key(|(seed, _)| *seed);
    for (seed, drift) in &drifts {
        println!("seed {seed}: drift {drift:+.3} with informed = {informed}");
    }
    drifts.into_iter().map(|(_, drift)| drift).collect()
}

fn mean(drifts: &[f64]) -> f64 {
    drifts.iter().sum::<f64>() / drifts.len() as f64
}

/// Paper, section 3.2: a minority leads the group by contact alone.
#[tokio::test(flavor = "multi_thread")]
async fn ten_informed_lead_fifty_in_at_least_twenty_of_twenty_four_seeds() {
    let drifts = drift_of_each_seed(true).await;
    let led = drifts.iter().filter(|drift| **drift > 0.3).count();
    println!("{led} of {SEEDS} above 0.3, mean {:.3}", mean(&drifts));
    assert!(led >= 20, "{led} of {SEEDS}: {drifts:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_informed_individuals_fifty_drift_nowhere() {
    let drifts = drift_of_each_seed(false).await;
    println!("mean {:+.3}", mean(&drifts));
    assert!(mean(&drifts).abs() < 0.15, "{drifts:?}");
}
