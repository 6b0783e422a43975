//! `doctor`.

use serde_json::{Value, json};

use crate::support::{Daemon, Impostor};

fn check<'a>(report: &'a Value, name: &str) -> &'a Value {
    let checks = report["checks"].as_array().unwrap();
    let found = checks.iter().find(|check| check["check"] == name);
    found.unwrap_or_else(|| panic!("no {name} in {report}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_healthy_daemon_passes_every_check() {
    let daemon = Daemon::start().await;
    let report = daemon.reply("doctor").await;
    assert_eq!(report["ok"], true, "{report}");
    assert_eq!(
        check(&report, "commands")["ok"],
        Value::Null,
        "there is no swarm to try"
    );

    daemon.said("create demo --n 10").await;
    let seq = &daemon.reply("status demo").await["seq"];
    let report = daemon.reply("doctor").await;
    for check in report["checks"].as_array().unwrap() {
        assert_eq!(check["ok"], true, "{check}");
    }
    let latency = &check(&report, "latency")["figures"];
    assert!(latency["min_secs"].as_f64() <= latency["max_secs"].as_f64());
    assert_eq!(check(&report, "versions")["figures"]["wire_version"], 1);
    assert_eq!(
        &daemon.reply("status demo").await["seq"],
        seq,
        "it changed nothing"
    );

    let said = daemon.said("doctor").await;
    assert!(said.lines().all(|line| line.starts_with('✓')), "{said}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failed_check_has_a_remedy() {
    let daemon = Daemon::start().await;
    let ended = daemon.jostle("doctor -e tcp/127.0.0.1:1").await;
    assert_eq!(ended.code, Some(6), "{ended:?}");
    let lines: Vec<&str> = ended.stdout.lines().collect();
    assert!(lines[0].starts_with("✗ connection"), "{ended:?}");
    assert!(lines[1].contains("`jostled serve`"), "{ended:?}");
    let ended = daemon.jostle("doctor --node nobody").await;
    assert_eq!(ended.code, Some(3), "{ended:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failed_recording_is_found_and_named() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 3").await;
    daemon.said("record demo --at-daemon --as take").await;
    let report = daemon.reply("doctor").await;
    let recordings = check(&report, "recordings");
    assert_eq!(recordings["ok"], true, "{report}");
    assert_eq!(recordings["figures"]["recording"], 1, "{report}");
    std::fs::remove_dir_all(daemon.folder().join("recordings/take")).unwrap();
    let stopped = daemon.said("record --stop take").await;
    assert!(stopped.contains("take is failed"), "{stopped}");

    let ended = daemon.jostle("--json doctor").await;
    assert_ne!(ended.code, Some(0), "{ended:?}");
    let report = &ended.json_lines()[0];
    let recordings = check(report, "recordings");
    assert_eq!(recordings["ok"], false, "{report}");
    assert_eq!(recordings["figures"]["failed"], 1, "{report}");
    let message = recordings["message"].as_str().unwrap();
    assert!(message.contains("take ("), "{message}");
    assert_eq!(check(report, "health")["ok"], true, "{report}");
    let ended = daemon.jostle("doctor").await;
    assert!(ended.stdout.contains("✗ recordings"), "{ended:?}");
    let events = daemon.said("events demo --limit 1").await;
    assert!(events.contains("recording take failed: "), "{events}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn missing_permissions_are_detected() {
    let impostor = Impostor::start(&[], "jostle/x", "jostle/y").await;
    let node = |result: Value| vec![Ok(json!({"node": "a", "result": result}))];
    let limits = json!({
        "max_individuals": 1, "max_swarms": 1, "max_memory_bytes": 1, "max_message_bytes": 1,
        "max_clients": 1, "max_hz": 1,
    });
    let hello = json!({"version": "9.9.9", "wire_version": 999, "unix_secs": 0, "limits": limits});
    let status = json!({
        "uptime_secs": 1, "swarms": 0, "running": 0, "faulted": 0, "individuals": 0,
        "memory_bytes": 0, "clients": 1,
    });
    for (noun, result) in [
        ("hello", hello),
        ("status", status),
        ("swarms", json!({"swarms": []})),
    ] {
        impostor
            .answer(&format!("jostle/@node/a/get/{noun}"), node(result))
            .await;
    }
    let ended = impostor.jostle("--json doctor").await;
    assert_eq!(ended.code, Some(1), "the first that failed: {ended:?}");
    let report = &ended.json_lines()[0];
    assert_eq!(report["ok"], false);
    for (name, ok) in [
        ("daemon", json!(true)),
        ("versions", json!(false)),
        ("clock", json!(false)),
        ("latency", json!(true)),
        ("swarms", json!(true)),
        ("creating", json!(false)),
        ("subscriptions", Value::Null),
        ("liveliness", json!(false)),
    ] {
        let check = check(report, name);
        assert_eq!(check["ok"], ok, "{check}");
        assert_eq!(check["remedy"].is_string(), ok == json!(false), "{check}");
    }
    impostor.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_above_the_limit_gets_an_error() {
    let daemon = Daemon::with(&[("max_clients", "1")]).await;
    daemon.said("create demo --n 3").await;
    let mut watching = daemon.begin("watch demo");
    watching.lines(1);
    let ended = daemon.jostle("doctor").await;
    assert_ne!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stdout.contains("raise max_clients"), "{ended:?}");
    let ended = daemon.jostle("nodes").await;
    assert!(ended.stderr.contains("raise max_clients"), "{ended:?}");
    assert!(ended.stderr.contains("1 client is connected"), "{ended:?}");
    watching.interrupt();
    watching.end().await;
    daemon.stop().await;
}
