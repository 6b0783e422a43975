//! Processes of `jostle wait` that are killed, and one that outlives its daemon.

use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::json;

use super::{MAX_WAITS, begin, spec, waits};
use crate::support::daemon_process::{killed, start};
use crate::support::programs::program;
use crate::support::{Client, TIMEOUT, until, until_within};

/// `jostle` with these arguments, whose output is not read before its end.
fn jostle(endpoint: &str, arguments: &[&str]) -> Child {
    let mut command = Command::new(program("jostle"));
    command.args(["-e", endpoint]).args(arguments);
    command.stdin(Stdio::null()).stdout(Stdio::piped());
    command.stderr(Stdio::null()).spawn().unwrap()
}

async fn count(client: &Client, swarm: &str, count: usize) {
    until("the waits", async || {
        waits(client, swarm).await.len() == count
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn sixteen_killed_processes_leave_nothing_after_fifteen_seconds() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    daemon.1.create("a", spec(12)).await;
    daemon.1.ok("a", "run", json!({"rate": 1})).await;
    let endpoint = daemon.0.endpoint.clone();
    let waiting = || jostle(&endpoint, &["wait", "a", "order > 1"]);
    let mut processes: Vec<Child> = (0..MAX_WAITS).map(|_| waiting()).collect();
    count(&daemon.1, "a", MAX_WAITS).await;
    let full = begin(&daemon.1, "a", "mine").await.unwrap_err();
    assert!(full.message.contains("16 requests wait"), "{full:?}");
    for process in &mut processes {
        process.kill().unwrap();
        process.wait().unwrap();
    }
    daemon.1.ok("a", "fork", json!({"name": "forked"})).await;
    let snapshot = crate::when::snapshot_of(&daemon.1, "a").await;
    crate::when::restore(&daemon.1, &snapshot, "restored").await;
    let is_free = async || waits(&daemon.1, "a").await.is_empty();
    until_within(Duration::from_secs(15), "nothing is left", is_free).await;
    // A colleague waits, by a query and by a condition.
    let token = begin(&daemon.1, "a", "mine").await.unwrap();
    let pause = json!({"condition": "order > 1", "pause": true});
    daemon.1.ok("a", "when", pause).await;
    drop(token);
    daemon = killed(folder.path(), daemon).await;
    for (name, when) in [
        ("a", json!(["order > 1"])),
        ("forked", json!(null)),
        ("restored", json!(null)),
    ] {
        let status = daemon.1.get(name, "status").await["result"].take();
        assert_eq!((&status["waits"], &status["when"]), (&json!(null), &when));
    }
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wait_is_asked_again_after_a_restart_and_ends() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    daemon.1.create("a", spec(12)).await;
    let endpoint = daemon.0.endpoint.clone();
    let process = jostle(&endpoint, &["--json", "wait", "a", "order >= 0 for 2"]);
    count(&daemon.1, "a", 1).await;
    // It would hold after ten steps more.
    daemon.1.ok("a", "step", json!({"steps": 90})).await;
    daemon.1.ok("a", "annotate", json!({"text": "here"})).await;
    daemon.0.kill();
    drop(daemon);
    let mut command = crate::support::process::jostled(&["serve", "--listen", &endpoint]);
    command
        .args(["--node", "test", "--data-dir"])
        .arg(folder.path());
    let again = crate::support::daemon_process::DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&again.endpoint).await;
    count(&client, "a", 1).await;
    let step = client.get("a", "status").await["step"].as_u64().unwrap();
    client.ok("a", "step", json!({"steps": 99})).await;
    assert_eq!(waits(&client, "a").await.len(), 1, "it begins anew");
    client.ok("a", "step", json!({"steps": 10})).await;
    let ended = tokio::task::spawn_blocking(|| process.wait_with_output().unwrap());
    let ended = tokio::time::timeout(TIMEOUT, ended).await.unwrap().unwrap();
    assert!(ended.status.success(), "{ended:?}");
    let reply: serde_json::Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert_eq!(reply["step"], step + 100, "{reply}");
}
