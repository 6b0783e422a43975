//! Messages to a supervisor such as systemd, over its socket.

use std::fs;
use std::path::Path;
use std::time::Duration;

use serde_json::json;

use crate::support::Client;
use crate::support::programs::ROOT;
use crate::support::supervisor::Supervisor;

#[tokio::test(flavor = "multi_thread")]
async fn the_watchdog_starves_while_a_swarm_is_stuck() {
    let supervisor = Supervisor::listen();
    let stuck = "step=3*off->1*sleep(9000)->off";
    let (_daemon, endpoint) = supervisor.start(Some(Duration::from_millis(400)), stuck);
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 5})).await;
    client.ok("a", "run", json!({"rate": null})).await;
    let before = supervisor.receive_until("STATUS=1 swarm, unhealthy: swarm a");
    assert!(before.iter().any(|it| it == "WATCHDOG=1\n"), "{before:?}");
    let meanwhile = supervisor.receive_until("STATUS=1 swarm, healthy");
    let fed = meanwhile.iter().filter(|it| *it == "WATCHDOG=1\n").count();
    // The watchdog message is sent before the status.
    assert!(fed <= 1, "{meanwhile:?}");
    supervisor.receive_until("WATCHDOG=1\n");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_watchdog_only_ready_status_and_stopping_are_sent() {
    let supervisor = Supervisor::listen();
    let (mut daemon, _) = supervisor.start(None, "");
    assert_eq!(supervisor.receive(), "READY=1\n");
    assert_eq!(supervisor.receive(), "STATUS=0 swarms, healthy\n");
    daemon.signal("-TERM");
    assert_eq!(supervisor.receive(), "STOPPING=1\n");
    assert_eq!(daemon.end().0, Some(0));
}

/// The unit starts a daemon again until a port that another process uses for a minute is free.
#[test]
fn the_unit_retries_for_longer_than_a_minute_and_waits_for_the_network() {
    let unit = Path::new(ROOT).join("packaging/jostled.service");
    let unit = fs::read_to_string(unit).unwrap();
    let value = |name: &str| {
        let mut lines = unit.lines().filter_map(|line| line.split_once('='));
        lines.find(|(key, _)| *key == name).map(|(_, value)| value)
    };
    let number = |name: &str| value(name).unwrap().trim_end_matches('s').parse::<u32>();
    let restarts = number("StartLimitBurst").unwrap();
    assert!(number("RestartSec").unwrap() * (restarts - 1) > 60);
    for name in ["Wants", "After"] {
        assert_eq!(value(name), Some("network-online.target"), "{name}");
    }
}
