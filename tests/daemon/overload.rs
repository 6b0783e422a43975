//! More swarms than the cores can step, and clocks that jump: slower, never otherwise.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::apart::{Process, busy_time, jostled};
use crate::crash::twin::Twin;
use crate::support::{Client, alone};

const SWARMS: u64 = 40;

/// How soon a get is answered at the 99th percentile: the swarm's own thread answers, which sleeps
/// while others have their turns.
const SOON: Duration = Duration::from_millis(50);

/// Time units a second, of which two cores do a part for so many swarms.
const RATE: f64 = 60.0;

/// How long each swarm's thread of a process has computed, in seconds.
fn computed(process: u32) -> BTreeMap<PathBuf, f64> {
    let threads = std::fs::read_dir(format!("/proc/{process}/task")).unwrap();
    let threads = threads.map(|thread| thread.unwrap().path());
    let times = threads.filter_map(|thread| {
        let name = std::fs::read_to_string(thread.join("comm")).ok()?;
        let times = std::fs::read_to_string(thread.join("schedstat")).ok()?;
        let nanoseconds: f64 = times.split(' ').next()?.parse().ok()?;
        name.starts_with("swarm-")
            .then_some((thread, nanoseconds * 1e-9))
    });
    times.collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn overloaded_cores_are_shared_fairly_and_no_hash_changes() {
    let _alone = alone().await;
    let (daemon, endpoint) = Process::serve();
    let client = Client::open(&endpoint).await;
    let spec = |k: u64| json!({"n": 100, "seed": k, "rate": RATE});
    for k in 0..SWARMS {
        client.create(&format!("s{k}"), spec(k)).await;
        client
            .ok(&format!("s{k}"), "step", json!({"steps": 400}))
            .await;
    }
    for k in 0..SWARMS {
        client.ok(&format!("s{k}"), "run", json!({})).await;
    }
    // Each swarm's time and when it was, and the factor it then tells: a list would be of the last
    // tenth of a second.
    let look = async || -> Vec<(f64, Instant, f64)> {
        let mut seen = Vec::new();
        for k in 0..SWARMS {
            let status = client.get(&format!("s{k}"), "status").await;
            let factor = &status["result"]["real_time_factor"];
            let time = status["time"].as_f64().unwrap();
            seen.push((time, Instant::now(), factor.as_f64().unwrap_or(0.0)));
        }
        seen
    };
    tokio::time::sleep(Duration::from_secs(2)).await;
    let (mut before, began) = (None, Instant::now());
    let computed_before = computed(daemon.0.id());
    let (spent, busy) = (daemon.cpu_time(), busy_time());
    let (mut waits, mut lately) = (Vec::new(), None);
    while began.elapsed() < Duration::from_secs(10) {
        let asked = Instant::now();
        client
            .get(&format!("s{}", waits.len() as u64 % SWARMS), "status")
            .await;
        waits.push(asked.elapsed());
        if began.elapsed() > Duration::from_secs(7) && lately.is_none() {
            lately = Some((daemon.cpu_time(), busy_time(), Instant::now()));
        }
        // What they are told is of the last second, and so is what it is held against: their
        // steps cost less as they settle.
        if began.elapsed() > Duration::from_secs(9) && before.is_none() {
            before = Some(look().await);
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let computed_after = computed(daemon.0.id());
    let (before, after) = (before.unwrap(), look().await);
    let elapsed = began.elapsed().as_secs_f64();
    let spent = (daemon.cpu_time() - spent).as_secs_f64() / elapsed;
    let others = (busy_time() - busy).as_secs_f64() / elapsed - spent;
    let (lately_spent, lately_busy, since) = lately.unwrap();
    let of_others = busy_time() - lately_busy;
    let of_daemon = daemon.cpu_time() - lately_spent;
    let of_others =
        (of_others.as_secs_f64() - of_daemon.as_secs_f64()) / since.elapsed().as_secs_f64();
    let others = others.max(of_others);
    let passed = before.iter().zip(&after);
    let passed = passed.map(|(a, b)| (b.0 - a.0) / (b.1 - a.1).as_secs_f64());
    let mean = passed.sum::<f64>() / SWARMS as f64;
    let shares: Vec<f64> = computed_before
        .iter()
        .map(|(thread, before)| computed_after[thread] - before)
        .collect();
    assert_eq!(shares.len() as u64, SWARMS);
    let share = shares.iter().sum::<f64>() / shares.len() as f64;
    let widest = shares
        .iter()
        .map(|it| (it / share - 1.0).abs())
        .fold(0.0, f64::max);
    let told = after.iter().map(|(_, _, factor)| factor).sum::<f64>() / SWARMS as f64;
    waits.sort();
    let p99 = waits[waits.len() * 99 / 100];
    println!(
        "{SWARMS} swarms at {mean:.1} of {RATE} time units a second, shares within {:.1} %; \
         told {told:.1}; get p99 {p99:?} of {}",
        100.0 * widest,
        waits.len()
    );
    assert!(mean < 0.8 * RATE, "it is no overload: {mean}");
    // Shares of cores that something else takes too say nothing.
    if others < 0.2 {
        assert!(widest < 0.05, "{shares:?}");
        assert!((told / mean - 1.0).abs() < 0.10, "told {told}, were {mean}");
        assert!(p99 < SOON, "{p99:?}");
    } else {
        println!("not judged: other work took {others:.1} cores meanwhile, the daemon {spent:.1}");
    }
    for k in [0, SWARMS - 1] {
        let name = format!("s{k}");
        client.ok(&name, "pause", json!({})).await;
        let status = client.get(&name, "status").await;
        let mut alone = Twin::new(&name, &spec(k));
        alone.run_to(status["step"].as_u64().unwrap());
        assert_eq!(status["result"]["state_hash"], alone.hash());
    }
}

/// Where libfaketime is, of the Debian package faketime.
fn libfaketime() -> Option<PathBuf> {
    let places = std::fs::read_dir("/usr/lib").ok()?;
    let places = places
        .filter_map(Result::ok)
        .map(|it| it.path().join("faketime/libfaketime.so.1"));
    places.into_iter().find(|it| it.exists())
}

#[tokio::test(flavor = "multi_thread")]
async fn when_the_clock_jumps_swarms_neither_stall_nor_burst() {
    const RATE: f64 = 4.0;
    let _alone = alone().await;
    let Some(library) = libfaketime() else {
        println!("skipped: needs libfaketime, `apt-get install faketime`");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let clock = folder.path().join("clock");
    std::fs::write(&clock, "+0").unwrap();
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    command
        .env("LD_PRELOAD", library)
        .env("FAKETIME_TIMESTAMP_FILE", &clock)
        .env("FAKETIME_NO_CACHE", "1")
        .env("FAKETIME_DONT_FAKE_MONOTONIC", "1");
    let (daemon, endpoint) = Process::start(&mut command, tempfile::tempdir().unwrap());
    let client = Client::open(&endpoint).await;
    let spec = json!({"n": 20, "seed": 5, "rate": RATE});
    client.create("a", spec.clone()).await;
    client.ok("a", "run", json!({})).await;
    let clock_of = async || client.node("hello").await["unix_secs"].as_f64().unwrap();
    let time = async || -> f64 { client.get("a", "status").await["time"].as_f64().unwrap() };
    let hello = clock_of().await;
    for jump in ["+400d", "-400d", "+3600", "-3600", "+0"] {
        std::fs::write(&clock, jump).unwrap();
        for _ in 0..4 {
            let (before, began) = (time().await, Instant::now());
            let inform = json!({"select": {"ids": [1]}, "direction": 1});
            client.ok("a", "inform", inform).await;
            tokio::time::sleep(Duration::from_millis(250)).await;
            let passed = (time().await - before) / began.elapsed().as_secs_f64() / RATE;
            assert!(
                (0.8..1.25).contains(&passed),
                "after {jump}: {passed} of its rate"
            );
        }
        if jump == "+400d" {
            let jumped = clock_of().await - hello;
            assert!(
                jumped > 399.0 * 86_400.0,
                "the clock has not jumped: {jumped}"
            );
        }
    }
    client.ok("a", "pause", json!({})).await;
    let status = client.get("a", "status").await;
    assert_eq!(status["phase"], Value::from("paused"));
    drop(daemon);
}
