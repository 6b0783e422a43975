//! A hundred swarms are recovered.

use std::time::Duration;

use serde_json::json;

use crate::support::Client;
use crate::support::daemon_process::{self, DaemonProcess};

/// How long a hundred swarms run before the kill; with `JOSTLE_LONG=1` the second.
const RUN_SECS: [u64; 2] = [11, 30];

#[tokio::test(flavor = "multi_thread")]
async fn a_hundred_swarms_of_a_hundred_are_recovered() {
    const SWARMS: u64 = 100;
    let folder = tempfile::tempdir().unwrap();
    let mut empty = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&empty.endpoint).await;
    for k in 0..SWARMS {
        let name = format!("s{k}");
        client
            .create(&name, json!({"n": 100, "seed": k, "rate": 1}))
            .await;
        client
            .ok(&name, "step", json!({"steps": 600, "return": "none"}))
            .await;
    }
    for k in 0..SWARMS {
        client.ok(&format!("s{k}"), "run", json!({})).await;
    }
    let run = RUN_SECS[usize::from(std::env::var_os("JOSTLE_LONG").is_some())];
    tokio::time::sleep(Duration::from_secs(run)).await;
    let mut steps = Vec::new();
    for k in 0..SWARMS {
        let inform = json!({"select": {"count": 3}, "direction": 1});
        let reply = client.ok(&format!("s{k}"), "inform", inform).await;
        steps.push(reply["step"].as_u64().unwrap());
    }
    empty.kill();

    let process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    println!(
        "back with {SWARMS} swarms after {run} s in {:?}",
        process.took
    );
    let client = Client::open(&process.endpoint).await;
    for (k, step) in steps.iter().enumerate() {
        let status = client.get(&format!("s{k}"), "status").await;
        assert!(status["step"].as_u64().unwrap() >= *step, "{status}");
        assert_eq!(status["phase"], "running");
        assert_eq!(status["result"]["informed"], 3);
    }
}
