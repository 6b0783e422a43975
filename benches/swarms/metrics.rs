//! The time that a swarm steps while a client reads the daemon's metrics a hundred times.

use jostle_proto::keys;
use serde_json::{Value, json};

use crate::{Daemon, Limit, NODE, Row, ask, create_and_step, name};

/// Runs with and without the client; of each kind the quickest counts.
const ROUNDS: usize = 8;

pub async fn measure() -> Row {
    let daemon = Daemon::start().await;
    create_and_step(
        &daemon.session,
        (NODE, &name(0)),
        json!({"n": 20, "seed": 1}),
        1000,
    )
    .await;
    let secs = async || {
        let all = metrics(&daemon).await;
        all["result"]["swarms"][0]["step_secs"].as_f64().unwrap()
    };
    let step = async || {
        let before = secs().await;
        let step = keys::cmd("jostle", &name(0), "step");
        ask(&daemon.session, step, &json!({"steps": 5000})).await;
        secs().await - before
    };
    let (mut quiet, mut read) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..ROUNDS {
        quiet = quiet.min(step().await);
        let reading = async {
            for _ in 0..100 {
                metrics(&daemon).await;
            }
        };
        let (took, ()) = tokio::join!(step(), reading);
        read = read.min(took);
    }
    daemon.stop();
    Row {
        key: "metrics_slow_down",
        what: "time of 5,000 steps beside 100 queries of metrics, to without".into(),
        value: read / quiet,
        limit: Limit::AtMost(1.25),
        unit: "",
    }
}

async fn metrics(daemon: &Daemon) -> Value {
    let key = keys::node_get("jostle", NODE, "metrics");
    let replies = daemon.session.get(key).await.unwrap();
    let sample = replies.recv_async().await.unwrap().into_result().unwrap();
    serde_json::from_slice(&sample.payload().to_bytes()).unwrap()
}
