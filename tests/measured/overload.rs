//! More swarms than the cores can step, and clocks that jump: swarms are slower, their states equal.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use jostle_proto::{Event, EventKind, keys};
use serde_json::{Value, json};
use zenoh_ext::{AdvancedSubscriberBuilderExt, HistoryConfig};

use crate::stolen::Stolen;
use crate::support::needs;
use crate::support::process::{Process, jostled};
use crate::support::reference_model::ReferenceModel;
use crate::support::{Client, NODE, PREFIX, TIMEOUT};

const SWARMS: u64 = 40;

/// Time units a second, of which two cores do a part for so many swarms.
const RATE: f64 = 60.0;

/// The time step that a spec has without `dt`.
const DT: f64 = 0.02;

#[tokio::test(flavor = "multi_thread")]
async fn overloaded_cores_are_shared_and_no_hash_changes() {
    let (_daemon, endpoint) = Process::serve();
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
    let steps = async || -> Vec<u64> {
        let mut steps = Vec::new();
        for k in 0..SWARMS {
            let status = client.get(&format!("s{k}"), "status").await;
            steps.push(status["step"].as_u64().unwrap());
        }
        steps
    };
    let (before, began) = (steps().await, Instant::now());
    tokio::time::sleep(Duration::from_secs(5)).await;
    let (after, elapsed) = (steps().await, began.elapsed().as_secs_f64());
    let taken = before
        .iter()
        .zip(&after)
        .map(|(before, after)| after - before);
    let mut taken: Vec<u64> = taken.collect();
    taken.sort_unstable();
    let mean = taken.iter().sum::<u64>() as f64 / SWARMS as f64;
    println!(
        "{SWARMS} swarms took {} to {} steps",
        taken[0],
        taken[taken.len() - 1]
    );
    let asked = RATE / DT * elapsed;
    assert!(mean < 0.8 * asked, "no overload: {mean} steps of {asked}");
    // Their processor time is the same (`cargo bench --bench swarms`), their steps differ in cost.
    assert!(taken[0] as f64 > 0.5 * mean, "{taken:?}");
    for k in [0, SWARMS - 1] {
        let name = format!("s{k}");
        client.ok(&name, "pause", json!({})).await;
        let status = client.get(&name, "status").await;
        let mut alone = ReferenceModel::new(&name, &spec(k));
        alone.run_to(status["step"].as_u64().unwrap());
        assert_eq!(status["result"]["state_hash"], alone.hash());
    }
}

/// The steps of a swarm of 500 in ten seconds at rate 5, as a share of those that are due while the
/// machine has its processors.
#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_keeps_its_rate_beside_ten_without_one_and_an_experiment() {
    const RATE: f64 = 5.0;
    let (_daemon, endpoint) = Process::serve();
    let client = Client::open(&endpoint).await;
    client
        .create("paced", json!({"n": 500, "rate": RATE}))
        .await;
    client.ok("paced", "run", json!({})).await;
    let share = async || {
        let step = async || {
            client.get("paced", "status").await["step"]
                .as_u64()
                .unwrap()
        };
        let (before, began, stolen) = (step().await, Instant::now(), Stolen::begin());
        tokio::time::sleep(Duration::from_secs(10)).await;
        let due = RATE / DT * began.elapsed().as_secs_f64();
        (step().await - before) as f64 / (due * (1.0 - stolen.share()))
    };
    let alone = share().await;
    for k in 0..10 {
        let name = format!("max{k}");
        client.create(&name, json!({"n": 100, "rate": null})).await;
        client.ok(&name, "run", json!({})).await;
    }
    let key = keys::node_cmd(PREFIX, NODE, "experiment");
    let toml = "name = 'beside'\nreplicates = 4\nduration = 1e6\n[spec]\nn = 100\n";
    let submit = json!({"submit": {"toml": toml}}).to_string();
    client.query(&key, Some(submit.as_bytes())).await.unwrap();
    let beside = share().await;
    println!("{alone:.3} of the steps alone, {beside:.3} beside the others");
    assert!(alone > 0.98, "it does not fit on the cores: {alone}");
    assert!(beside >= 0.98, "{beside}");
    for k in 0..10 {
        let status = client.get(&format!("max{k}"), "status").await;
        assert!(status["step"].as_u64().unwrap() > 100, "{status}");
    }

    // One that cannot reach its rate says so.
    client.ok("paced", "run", json!({"rate": 1000})).await;
    let mut status = client.get("paced", "status").await;
    let deadline = Instant::now() + TIMEOUT;
    while status["result"]["behind_rate"] != true {
        assert!(Instant::now() < deadline, "{status}");
        tokio::time::sleep(Duration::from_millis(100)).await;
        status = client.get("paced", "status").await;
    }
    assert_eq!(status["result"]["rate"], 1000.0);
}

/// The path of libfaketime, of the Debian package faketime.
fn libfaketime() -> Option<PathBuf> {
    let places = fs::read_dir("/usr/lib").ok()?;
    let places = places
        .filter_map(Result::ok)
        .map(|it| it.path().join("faketime/libfaketime.so.1"));
    places.into_iter().find(|it| it.exists())
}

/// A daemon whose wall clock is offset by the content of the file `clock`.
fn on_a_clock(library: &Path, clock: &Path) -> Command {
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    command
        .env("LD_PRELOAD", library)
        .env("FAKETIME_TIMESTAMP_FILE", clock)
        .env("FAKETIME_NO_CACHE", "1")
        .env("FAKETIME_DONT_FAKE_MONOTONIC", "1");
    command
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clock_that_is_set_back_does_not_flood_the_log() {
    // As many as are published in 10 s.
    const STATES: usize = 400;
    let Some(library) = libfaketime() else {
        needs::FAKETIME.is_missing();
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let [clock, log] = ["clock", "log"].map(|name| folder.path().join(name));
    fs::write(&clock, "+0").unwrap();
    let mut command = on_a_clock(&library, &clock);
    command.stderr(File::create(&log).unwrap());
    let (_daemon, endpoint) = Process::start(&mut command, tempfile::tempdir().unwrap());
    let client = Client::open(&endpoint).await;
    client
        .create("a", json!({"n": 20, "seed": 5, "rate": 4}))
        .await;
    let states = client.session.declare_subscriber(keys::state(PREFIX, "a"));
    let states = states.await.unwrap();
    let events = client
        .session
        .declare_subscriber(keys::event(PREFIX, "a"))
        .history(HistoryConfig::default().detect_late_publishers())
        .await
        .unwrap();
    client.ok("a", "run", json!({})).await;
    states.recv_async().await.unwrap();
    let clock_of = async || client.node("hello").await["unix_secs"].as_f64().unwrap();
    let before = (clock_of().await, fs::metadata(&log).unwrap().len());
    fs::write(&clock, "-3600").unwrap();
    let began = Instant::now();
    for _ in 0..STATES {
        let state = tokio::time::timeout(TIMEOUT, states.recv_async()).await;
        let state = state
            .expect("a state after the clock was set back")
            .unwrap();
        assert_eq!(state.timestamp(), None);
    }
    assert!(
        clock_of().await < before.0 - 3500.0,
        "the clock was set back"
    );
    client.ok("a", "pause", json!({})).await;
    let last =
        |event: &Event| matches!(&event.event, EventKind::Command { verb, .. } if verb == "pause");
    loop {
        let event = tokio::time::timeout(TIMEOUT, events.recv_async()).await;
        let sample = event.expect("the event of the pause").unwrap();
        let event: Event = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
        assert_eq!(sample.timestamp(), None);
        if last(&event) {
            assert!(event.unix_secs.unwrap() < before.0 - 3500.0);
            break;
        }
    }
    let logged = fs::metadata(&log).unwrap().len() - before.1;
    println!(
        "{STATES} states and {logged} bytes of log in {:?} after the clock was set back",
        began.elapsed()
    );
    assert!(logged < 1024, "{}", fs::read_to_string(&log).unwrap());
}

#[tokio::test(flavor = "multi_thread")]
async fn when_the_clock_jumps_swarms_neither_stall_nor_burst() {
    const RATE: f64 = 4.0;
    let Some(library) = libfaketime() else {
        needs::FAKETIME.is_missing();
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let clock = folder.path().join("clock");
    fs::write(&clock, "+0").unwrap();
    let (daemon, endpoint) = Process::start(
        &mut on_a_clock(&library, &clock),
        tempfile::tempdir().unwrap(),
    );
    let client = Client::open(&endpoint).await;
    // A daemon whose clock is not changed shows how fast the swarm can step on this machine.
    let (_steady, steady) = Process::serve();
    let steady = Client::open(&steady).await;
    let spec = json!({"n": 20, "seed": 5, "rate": RATE});
    for client in [&client, &steady] {
        client.create("a", spec.clone()).await;
        client.ok("a", "run", json!({})).await;
    }
    let clock_of = async || client.node("hello").await["unix_secs"].as_f64().unwrap();
    let time = async |client: &Client| client.get("a", "status").await["time"].as_f64().unwrap();
    let hello = clock_of().await;
    for jump in ["+400d", "-400d", "+3600", "-3600", "+0"] {
        fs::write(&clock, jump).unwrap();
        for _ in 0..2 {
            let before = (time(&client).await, time(&steady).await);
            let inform = json!({"select": {"ids": [1]}, "direction": 1});
            client.ok("a", "inform", inform).await;
            tokio::time::sleep(Duration::from_secs(1)).await;
            let passed = (time(&client).await - before.0) / (time(&steady).await - before.1);
            assert!(
                (0.8..1.25).contains(&passed),
                "after {jump}: {passed} of the time of the one on the true clock"
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
