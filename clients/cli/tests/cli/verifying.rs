//! Replayed histories.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::support::{Daemon, Impostor, object};

#[tokio::test(flavor = "multi_thread")]
async fn a_history_with_the_same_hashes_is_verified() {
    let daemon = Daemon::start().await;
    daemon.said("create a --n 10 --seed 2").await;
    // A paused swarm has the hash of its current state.
    let fresh = daemon.said("verify a").await;
    assert!(fresh.contains("1 hash compared"), "{fresh}");
    daemon.said("step a 20000 --timeout 60").await;
    daemon.said("set a pi3=1.5").await;
    let verified = object(&daemon.jostle("--json verify a").await);
    let result = &verified["result"];
    assert_eq!(result["from_step"], 0);
    assert_eq!(result["differs_at"], Value::Null);
    assert!(result["hashes"].as_u64().unwrap() > 1, "{verified}");
    let said = daemon.said("verify a").await;
    assert!(
        said.starts_with("a is the same: replayed from step 0 to step "),
        "{said}"
    );
    let status = daemon.said("status a").await;
    assert!(status.contains("kept from step 0 of epoch 1"), "{status}");
    assert_eq!(daemon.refusal("verify b").await["code"], "not_found");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_history_with_another_hash_ends_with_code_9() {
    let impostor = Impostor::start(&["jostle/demo/alive/a"], "jostle/x", "jostle/y").await;
    let reply = json!({
        "swarm": "demo", "epoch": 1, "step": 900, "time": 18.0, "phase": "paused", "seq": 1,
        "result": {"from_step": 0, "to_step": 900, "hashes": 3, "differs_at": 700, "differs_in_epoch": 1},
    });
    let _received = impostor
        .answer("jostle/demo/get/verify", vec![Ok(reply.clone()), Ok(reply)])
        .await;
    let ended = impostor.jostle("verify demo").await;
    assert_eq!(ended.code, Some(9), "{ended:?}");
    assert!(
        ended
            .stdout
            .contains("demo differs first at step 700 of epoch 1"),
        "{ended:?}"
    );
    assert!(ended.stderr.contains("step 700"), "{ended:?}");
    let ended = impostor.jostle("--json verify demo").await;
    assert_eq!(ended.code, Some(9), "{ended:?}");
    let error: Value = serde_json::from_str(&ended.stderr).unwrap();
    assert_eq!(
        (&error["code"], &error["step"]),
        (&json!("mismatch"), &json!(700))
    );
    impostor.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn verify_ends_at_its_timeout_also_in_the_daemon() {
    let daemon = Daemon::start().await;
    daemon.said("create a --n 50 --seed 2").await;
    daemon.said("step a 150000 --timeout 60").await;
    let began = Instant::now();
    let ended = daemon.jostle("verify a --timeout 1").await;
    assert!(began.elapsed() < Duration::from_secs(10), "{began:?}");
    assert_eq!(ended.code, Some(6), "{ended:?}");
    let expected = "not done within 1 s: the replay has ended; a longer --timeout waits longer";
    assert!(ended.stderr.contains(expected), "{ended:?}");
    // The replay ends at its next step.
    let is_over = async || {
        let status = object(&daemon.jostle("--json status a").await);
        status["result"]["verifying"] == Value::Null
    };
    while !is_over().await {
        assert!(began.elapsed() < Duration::from_secs(10), "{began:?}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_knows_no_timeout_of_a_verify_is_asked_without_it() {
    let impostor = Impostor::start(&["jostle/demo/alive/a"], "jostle/x", "jostle/y").await;
    let unknown = json!({
        "code": "invalid_argument",
        "message": "unknown parameter \"timeout_secs\": there are none",
        "details": {"field": "timeout_secs", "known": []},
        "step": null,
    });
    let reply = json!({
        "swarm": "demo", "epoch": 1, "step": 900, "time": 18.0, "phase": "paused", "seq": 1,
        "result": {"from_step": 0, "to_step": 900, "hashes": 3, "differs_at": null, "differs_in_epoch": null},
    });
    let received = impostor
        .answer("jostle/demo/get/verify", vec![Err(unknown), Ok(reply)])
        .await;
    let ended = impostor.jostle("verify demo").await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stdout.contains("demo is the same"), "{ended:?}");
    assert_eq!(received.lock().unwrap().len(), 2);
    impostor.stop().await;
}
