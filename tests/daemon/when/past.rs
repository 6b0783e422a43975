//! Conditions on measures that need earlier states.

use jostle_proto::ErrorCode;
use serde_json::json;

use super::{
    N, create_informed, first_step, inform, pause, pauses_at, restore, run, snapshot_of, verifies,
    waiting,
};
use crate::support::Daemon;
use crate::support::daemon_process::{killed, start};

/// Holds after the group has moved fast for a while, and turned little in the last step.
const MOVING: &str = "msd(1) > 0.92 for 4 and turning_rate < 0.35 and speed.others > 0.6";

/// The first step after which `MOVING` holds.
fn expected_moving_step() -> u64 {
    const DT: f64 = 0.02;
    let mut in_a_row = 0;
    first_step(|states| {
        let moved = |lag: usize, k: usize| {
            let [then, now] = [
                states[states.len() - 1 - lag][k],
                states[states.len() - 1][k],
            ];
            (now[0] - then[0]).hypot(now[1] - then[1])
        };
        let is_fast = states.len() > 50
            && (0..N).map(|k| moved(50, k).powi(2)).sum::<f64>() / N as f64 > 0.92;
        in_a_row = if is_fast { in_a_row + 1 } else { 0 };
        let turned =
            |k: usize| (states[states.len() - 1][k][2] - states[states.len() - 2][k][2]) / DT;
        let mean = (0..N).map(turned).sum::<f64>() / N as f64;
        let variance = (0..N).map(|k| (turned(k) - mean).powi(2)).sum::<f64>() / N as f64;
        let speed = (5..N).map(|k| moved(1, k) / DT).sum::<f64>() / (N - 5) as f64;
        in_a_row > 200 && variance.sqrt() < 0.35 && speed > 0.6
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn measures_of_earlier_states_survive_kills_and_copies() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let step = expected_moving_step();
    assert!(step > 260, "it holds from the start: {step}");
    for name in ["twin", "a", "early"] {
        create_informed(&daemon.1, name).await;
        daemon.1.ok(name, "when", pause(MOVING)).await;
    }
    pauses_at(&daemon.1, "twin", step).await;
    // Within the lag and within the duration, with a durable command there or without one.
    for (to, is_durable) in [(30, true), (step - 150, false), (step - 20, true)] {
        let until = json!({"until_step": to, "rate": null});
        daemon.1.ok("a", "run", until).await;
        daemon.1.wait_for_step("a", to).await;
        if is_durable {
            daemon.1.ok("a", "pause", json!({})).await;
            let name = format!("forked-{to}");
            daemon.1.ok("a", "fork", json!({"name": name})).await;
            let snapshot = snapshot_of(&daemon.1, "a").await;
            restore(&daemon.1, &snapshot, &format!("restored-{to}")).await;
        }
        daemon = killed(folder.path(), daemon).await;
        assert_eq!(waiting(&daemon.1, "a").await, json!([MOVING]));
    }
    for (to, name) in [(40, "at-40"), (step - 100, "at-100")] {
        daemon
            .1
            .ok("a", "fork", json!({"name": name, "step": to}))
            .await;
    }
    let (forked, restored) = (
        format!("forked-{}", step - 20),
        format!("restored-{}", step - 20),
    );
    let copies = [
        "forked-30",
        "restored-30",
        "at-40",
        "at-100",
        &forked,
        &restored,
        "a",
    ];
    for name in copies {
        pauses_at(&daemon.1, name, step).await;
        verifies(&daemon.1, name).await;
    }
    let hash = daemon.1.hash("twin").await;
    for name in copies {
        assert_eq!(daemon.1.hash(name).await, hash, "{name}");
    }
    // A reset removes the past too: the same condition holds at the same step again.
    daemon.1.ok("early", "step", json!({"steps": 70})).await;
    daemon.1.ok("early", "reset", json!({})).await;
    daemon.1.ok("early", "inform", inform()).await;
    daemon.1.ok("early", "when", pause(MOVING)).await;
    pauses_at(&daemon.1, "early", step).await;
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_group_that_grows_beyond_the_limit_of_a_past_fulfils_no_condition_on_it() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client
        .create("a", json!({"n": 4, "seed": 1, "dt": 0.001, "rate": null}))
        .await;
    // 20,000 steps of 4 individuals, and 8 for each step, are within the limit, of 5 beyond it.
    client.ok("a", "when", pause("msd(20) >= 0")).await;
    client.ok("a", "when", pause("msd(0.01) > 1e-9")).await;
    client.ok("a", "inject", json!({"count": 1})).await;
    let (code, message) = client.err("a", "when", pause("msd(20) >= 0")).await;
    assert_eq!(code, ErrorCode::InvalidArgument, "{message}");
    let status = run(client, "a").await;
    assert_eq!(status["step"], 10, "{status}");
    assert_eq!(waiting(client, "a").await, json!(["msd(20) >= 0"]));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_condition_does_not_use_the_states_that_others_need() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let (begin, lag) = (200, 50);
    for name in ["alone", "beside"] {
        create_informed(&daemon.1, name).await;
        if name == "beside" {
            let other = json!({"condition": "msd(3) > 1e6", "event": "never"});
            daemon.1.ok(name, "when", other).await;
        }
        daemon.1.ok(name, "step", json!({"steps": begin})).await;
        daemon.1.ok(name, "when", pause("msd(1) > 1e-9")).await;
    }
    daemon = killed(folder.path(), daemon).await;
    for name in ["alone", "beside"] {
        let status = run(&daemon.1, name).await;
        assert_eq!(status["step"], begin + lag, "{name}");
    }
    drop(daemon);
}
