//! What is left after a restart of what counts steps or requests.

use std::path::Path;

use jostle_proto::ErrorCode;
use serde_json::{Value, json};

use crate::support::daemon_process::{DaemonProcess, daemon, killed, start};
use crate::support::{Client, until};

/// Ends a daemon with the swarm `a` as an operator does, or kills it, and starts one on the same folder.
async fn restarted(
    folder: &Path,
    (mut process, client): (DaemonProcess, Client),
    is_killed: bool,
) -> (DaemonProcess, Client) {
    // Its steps are durable then.
    client.ok("a", "annotate", json!({"text": "here"})).await;
    if is_killed {
        return killed(folder, (process, client)).await;
    }
    process.stop();
    assert_eq!(process.end(), Some(0));
    drop(client);
    start(folder).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_ends_at_its_step_however_often_the_daemon_is_restarted() {
    const END: u64 = 2000;
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    // 250 steps a second.
    daemon.1.create("a", json!({"n": 3, "rate": 5})).await;
    let run = json!({"until_step": END});
    daemon.1.ok("a", "run", run).await;
    let mut before = 0;
    for is_killed in [false, true, false, true] {
        daemon.1.wait_for_step("a", before + 100).await;
        daemon = restarted(folder.path(), daemon, is_killed).await;
        let status = daemon.1.get("a", "status").await;
        let (phase, until_step) = (&status["phase"], &status["result"]["until_step"]);
        assert_eq!((phase, until_step), (&json!("running"), &json!(END)));
        before = status["step"].as_u64().unwrap();
    }
    let client = &daemon.1;
    client.wait_for_step("a", END).await;
    until("it is paused", async || {
        client.get("a", "status").await["phase"] == "paused"
    })
    .await;
    let status = client.get("a", "status").await;
    assert_eq!(status["step"], END, "{status}");
    let verified = client.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_informed_for_a_time_is_so_until_the_same_step_after_a_restart() {
    for is_killed in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let mut daemon = start(folder.path()).await;
        let spec = json!({"n": 5, "seed": 4, "rate": null});
        daemon.1.create("a", spec).await;
        daemon.1.ok("a", "step", json!({"steps": 7})).await;
        // 50 steps of 0.02.
        let inform = json!({"select": {"count": 2}, "direction": 0.5, "for_time": 1.0});
        daemon.1.ok("a", "inform", inform).await;
        for (steps, informed) in [(30, 2), (19, 2), (1, 0)] {
            daemon.1.ok("a", "step", json!({"steps": steps})).await;
            daemon = restarted(folder.path(), daemon, is_killed).await;
            let status = daemon.1.get("a", "status").await;
            assert_eq!(status["result"]["informed"], informed, "{status}");
        }
        let status = daemon.1.get("a", "status").await;
        assert_eq!(status["step"], 57);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_scheduled_before_a_restart_counts_in_the_limit_after_it() {
    const MOST: u64 = 1024;
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    daemon.1.create("a", json!({"n": 3, "rate": null})).await;
    let at = |step: u64| json!({"at_step": step, "args": {"pi3": 2}});
    for number in 0..MOST - 2 {
        daemon.1.ok("a", "set", at(1000 + number)).await;
    }
    for is_killed in [false, true] {
        daemon = restarted(folder.path(), daemon, is_killed).await;
        daemon.1.ok("a", "set", at(5000)).await;
    }
    let (code, _) = daemon.1.err("a", "set", at(5000)).await;
    assert_eq!(code, ErrorCode::ResourceExhausted);
    daemon = restarted(folder.path(), daemon, true).await;
    let (code, _) = daemon.1.err("a", "set", at(5000)).await;
    assert_eq!(code, ErrorCode::ResourceExhausted);
    // The first 10 are executed, which makes room for as many.
    daemon.1.ok("a", "step", json!({"steps": 1010})).await;
    daemon = restarted(folder.path(), daemon, false).await;
    let status = daemon.1.get("a", "status").await;
    let left = status["result"]["scheduled"].as_u64().unwrap();
    assert!((MOST - 11..=MOST - 10).contains(&left), "{left}");
    for _ in left..MOST {
        daemon.1.ok("a", "set", at(5000)).await;
    }
    let (code, _) = daemon.1.err("a", "set", at(5000)).await;
    assert_eq!(code, ErrorCode::ResourceExhausted);
}

/// A daemon on the folder whose swarms keep 1 MiB of history each.
async fn with_a_small_quota(folder: &Path) -> (DaemonProcess, Client) {
    let mut command = daemon(folder);
    command.args(["--quota-mb", "1"]);
    let process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    (process, client)
}

#[tokio::test(flavor = "multi_thread")]
async fn history_is_kept_up_to_the_quota_over_restarts_and_what_is_gone_stays_gone() {
    /// A checkpoint is kept at least this often.
    const STEPS: u64 = 10_000;
    let folder = tempfile::tempdir().unwrap();
    let (mut process, mut client) = with_a_small_quota(folder.path()).await;
    client.create("a", json!({"n": 2, "rate": null})).await;
    let noise = json!({"verb": "set", "args": {"noise": 0.125}});
    let batch = json!({"args": {"commands": vec![noise; 64]}});
    let quarter = (1 << 18) / batch.to_string().len();
    let from = async |client: &Client| {
        let status = client.get("a", "status").await;
        status["result"]["history_from"]["step"].as_u64().unwrap()
    };
    let (mut before, mut moved) = (0, 0);
    for part in 1..=12 {
        for _ in 0..quarter {
            client.ok("a", "batch", batch.clone()).await;
        }
        client.ok("a", "step", json!({"steps": STEPS})).await;
        // The steps are durable then.
        client.ok("a", "annotate", json!({"text": "here"})).await;
        let hash = client.hash("a").await;
        if part % 2 == 0 {
            // Alternately stopped and killed.
            if part % 4 == 0 {
                process.kill();
            } else {
                process.stop();
                assert_eq!(process.end(), Some(0));
            }
            drop(client);
            (process, client) = with_a_small_quota(folder.path()).await;
            assert_eq!(client.hash("a").await, hash);
        }
        let now = from(&client).await;
        assert!(
            now >= before,
            "the history goes back from {before} to {now}"
        );
        moved += u32::from(now > before);
        before = now;
    }
    assert!(moved >= 4, "{moved}");
    // Most of 3 MiB is gone, and 1 MiB is there.
    assert!((8 * STEPS..=10 * STEPS).contains(&before), "{before}");
    let fork = |name: &str, step: u64| json!({"name": name, "step": step});
    client.err("a", "fork", fork("b", before - 1)).await;
    assert_eq!(
        client.ok("a", "fork", fork("c", before)).await["step"],
        before
    );
    let verified = client.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null, "{verified}");
}
