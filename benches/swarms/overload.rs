//! More swarms than the cores can step: their shares of the cores, the rate that they report, and how
//! soon a get is answered.

use std::time::{Duration, Instant};

use serde_json::json;

use crate::{Daemon, Limit, Row};

const SWARMS: usize = 40;

/// Time units a second, of which two cores do less than half for so many swarms of 100.
const RATE: f64 = 60.0;

/// What a swarm reports, and when that was.
struct Seen {
    time: f64,
    real_time_factor: f64,
    at: Instant,
}

pub async fn measure() -> Vec<Row> {
    let daemon = Daemon::start().await;
    for k in 0..SWARMS {
        let spec = json!({"n": 100, "seed": k, "rate": RATE});
        daemon.host(k, spec, 400).await;
    }
    tokio::time::sleep(Duration::from_secs(2)).await;
    let computed = daemon.computed("swarm-");
    let began = Instant::now();
    let mut waits = Vec::new();
    let mut before = None;
    while began.elapsed() < Duration::from_secs(10) {
        let asked = Instant::now();
        daemon.status(waits.len() % SWARMS).await;
        waits.push(1e3 * asked.elapsed().as_secs_f64());
        // The reported rate is that of the last second: compare it with the rate of that second.
        if began.elapsed() > Duration::from_secs(9) && before.is_none() {
            before = Some(seen(&daemon).await);
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let computed_after = daemon.computed("swarm-");
    let (before, after) = (before.unwrap(), seen(&daemon).await);
    daemon.stop();

    let rates = before.iter().zip(&after);
    let rates = rates.map(|(a, b)| (b.time - a.time) / (b.at - a.at).as_secs_f64());
    let rate = rates.sum::<f64>() / SWARMS as f64;
    assert!(rate < 0.8 * RATE, "no overload on this machine: {rate}");
    let reported = after.iter().map(|it| it.real_time_factor).sum::<f64>() / SWARMS as f64;
    let shares: Vec<f64> = computed
        .iter()
        .map(|(thread, before)| computed_after[thread] - before)
        .collect();
    assert_eq!(shares.len(), SWARMS);
    let mean = shares.iter().sum::<f64>() / SWARMS as f64;
    let furthest = shares.iter().map(|it| (it / mean - 1.0).abs());
    waits.sort_by(f64::total_cmp);
    let row = |key, what: &str, value, limit, unit| Row {
        key,
        what: format!("{SWARMS} swarms at {rate:.0} of {RATE} time units a second: {what}"),
        value,
        limit: Limit::AtMost(limit),
        unit,
    };
    let share_off = 100.0 * furthest.fold(0.0, f64::max);
    let report_off = 100.0 * (reported / rate - 1.0).abs();
    let get = waits[waits.len() * 99 / 100];
    vec![
        row(
            "share_off_percent",
            "share off the mean",
            share_off,
            5.0,
            "%",
        ),
        row(
            "reported_rate_off_percent",
            "reported rate off",
            report_off,
            10.0,
            "%",
        ),
        row("overloaded_get_p99_ms", "a get, p99", get, 50.0, "ms"),
    ]
}

async fn seen(daemon: &Daemon) -> Vec<Seen> {
    let mut seen = Vec::new();
    for k in 0..SWARMS {
        let status = daemon.status(k).await;
        seen.push(Seen {
            time: status["time"].as_f64().unwrap(),
            real_time_factor: status["result"]["real_time_factor"].as_f64().unwrap(),
            at: Instant::now(),
        });
    }
    seen
}
