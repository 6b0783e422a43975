//! As many swarms of 20 as take 80 % of the cores: how many, the rate of the slowest and a get.

use std::time::{Duration, Instant};

use serde_json::json;

use crate::{Daemon, Limit, Row};

const MAX_SWARMS: usize = 1000;
/// So many are run to measure the share of a core of one.
const FIRST: usize = 150;
const SHARE: f64 = 0.8;

pub async fn measure() -> Vec<Row> {
    let cores = std::thread::available_parallelism().unwrap().get() as f64;
    let daemon = Daemon::start().await;
    let host = async |numbers: std::ops::Range<usize>| {
        for k in numbers {
            // A group in contact takes more time a step.
            daemon
                .host(k, json!({"n": 20, "seed": k, "rate": 1}), 500)
                .await;
        }
    };
    let computed = || daemon.computed("").values().sum::<f64>();
    host(0..FIRST).await;
    let (before, began) = (computed(), Instant::now());
    tokio::time::sleep(Duration::from_secs(4)).await;
    let each = (computed() - before) / began.elapsed().as_secs_f64() / FIRST as f64;
    let fits = |&swarms: &usize| swarms as f64 * each <= SHARE * cores;
    let swarms = (FIRST..=MAX_SWARMS).rev().find(fits).unwrap_or(FIRST);
    host(FIRST..swarms).await;
    let times = async || {
        let mut times = Vec::new();
        for k in 0..swarms {
            let time = daemon.status(k).await["time"].as_f64().unwrap();
            times.push((time, Instant::now()));
        }
        times
    };
    let before = times().await;
    tokio::time::sleep(Duration::from_secs(10)).await;
    let after = times().await;
    let asked = Instant::now();
    daemon.status(0).await;
    let get = 1e3 * asked.elapsed().as_secs_f64();
    daemon.stop();
    let rates = before.iter().zip(&after);
    let rates = rates.map(|(a, b)| (b.0 - a.0) / (b.1 - a.1).as_secs_f64());
    let what = format!(
        "{swarms} swarms at rate 1, each {:.2} % of a core",
        100.0 * each
    );
    vec![
        Row {
            key: "swarms_that_fit",
            what: what.clone(),
            value: swarms as f64,
            limit: Limit::AtLeast(300.0),
            unit: "swarms",
        },
        Row {
            key: "slowest_rate",
            what: format!("{what}: the slowest"),
            value: rates.fold(f64::INFINITY, f64::min),
            limit: Limit::AtLeast(0.95),
            unit: "of 1",
        },
        Row {
            key: "fitting_get_ms",
            what: format!("{what}: a get"),
            value: get,
            limit: Limit::AtMost(500.0),
            unit: "ms",
        },
    ]
}
