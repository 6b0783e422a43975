//! How long a killed daemon takes to start again and accept a client.

use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde_json::json;

use crate::{Daemon, Limit, Row};

const SWARMS: usize = 100;

/// How long the swarms run before the kill.
const RUN: Duration = Duration::from_secs(11);

/// Invalid requests, sent one by one.
const INVALID: u32 = 100;

pub async fn measure() -> [Row; 4] {
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
    let mut slowest = Duration::ZERO;
    for k in 0..INVALID {
        let request = json!({"args": {"pi3": -1, "unknown": k}}).to_string();
        let began = Instant::now();
        let query = daemon.session.get(keys::cmd("jostle", "s0", "set"));
        let replies = query.payload(request).encoding("application/json").await;
        let reply = replies.unwrap().recv_async().await.unwrap();
        slowest = slowest.max(began.elapsed());
        assert!(reply.result().is_err(), "an invalid request was accepted");
    }
    let ending = daemon.end();
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
            "reject_seconds",
            "the slowest of 100 rejections",
            slowest,
            0.1,
        ),
        row(
            "end_seconds",
            "from SIGTERM to the end, with these swarms",
            ending,
            2.0,
        ),
        row(
            "restart_seconds",
            "a start after a kill, with 100 running swarms of 100",
            full,
            3.0,
        ),
    ]
}
