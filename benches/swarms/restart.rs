//! How long a killed daemon takes to start again and accept a client.

use std::time::{Duration, Instant};

use serde_json::json;

use crate::{Daemon, Limit, Row};

const SWARMS: usize = 100;

/// How long the swarms run before the kill.
const RUN: Duration = Duration::from_secs(11);

pub async fn measure() -> [Row; 2] {
    let began = Instant::now();
    let daemon = Daemon::start().await;
    let empty = began.elapsed();
    for k in 0..SWARMS {
        daemon
            .host(k, json!({"n": 100, "seed": k, "rate": 1}), 600)
            .await;
    }
    tokio::time::sleep(RUN).await;
    let folder = daemon.kill();
    let began = Instant::now();
    let daemon = Daemon::on(folder).await;
    let full = began.elapsed();
    assert_eq!(daemon.status(SWARMS - 1).await["phase"], "running");
    daemon.stop();
    let row = |key, what: &str, took: Duration, limit| Row {
        key,
        what: what.into(),
        value: took.as_secs_f64(),
        limit: Limit::AtMost(limit),
        unit: "s",
    };
    [
        row("start_seconds", "a start with nothing stored", empty, 1.0),
        row(
            "restart_seconds",
            "a start after a kill, with 100 running swarms of 100",
            full,
            3.0,
        ),
    ]
}
