//! Memory, descriptors and threads do not grow with deleted swarms and closed clients.

use std::time::{Duration, Instant};

use serde_json::json;

use crate::support::process::Process;
use crate::support::{Client, until};

/// Cycles of one test; with `JOSTLE_LONG=1`, over at least ten minutes.
const CYCLES: [(usize, Duration); 2] = [(150, Duration::ZERO), (1000, Duration::from_secs(600))];

/// Cycles before the first measurement: buffers and pools have grown to their size.
const WARMING: usize = 150;

/// The limit of the growth of memory.
const GROWTH: u64 = 8 << 20;

/// The limit of the growth during replays that were executed before.
const RETELLING_GROWTH: u64 = 3 << 20;

impl Process {
    /// The numbers of descriptors and of threads.
    fn handles(&self) -> [usize; 2] {
        let count = |what: &str| {
            let path = format!("/proc/{}/{what}", self.0.id());
            std::fs::read_dir(path).unwrap().count()
        };
        [count("fd"), count("task")]
    }
}

/// Opens a client, creates a swarm, sends it commands, deletes it and closes the client.
async fn cycle(endpoint: &str, number: usize) {
    let client = Client::open(endpoint).await;
    // Every name is used again, while others exist.
    let name = format!("s{}", number % 7);
    client
        .create(&name, json!({"n": 20, "seed": number, "rate": null}))
        .await;
    client.ok(&name, "step", json!({"steps": 50})).await;
    let informed = json!({"client": "soak", "request_id": format!("i{number}"),
        "args": {"select": {"count": 3}, "direction": 1.0}});
    client.ok(&name, "inform", informed).await;
    client.ok(&name, "run", json!({"until_step": 300})).await;
    client.wait_for_step(&name, 300).await;
    client.ok(&name, "inject", json!({"count": 2})).await;
    client.ok(&name, "reset", json!({})).await;
    let copy = format!("{name}-copy");
    client.ok(&name, "fork", json!({"name": copy})).await;
    for name in [name, copy] {
        client.ok(&name, "delete", json!({})).await;
    }
    client.session.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn deleted_swarms_and_closed_clients_leave_nothing_behind() {
    let (cycles, at_least) = CYCLES[usize::from(std::env::var_os("JOSTLE_LONG").is_some())];
    let (daemon, endpoint) = Process::serve();
    for number in 0..WARMING {
        cycle(&endpoint, number).await;
    }
    let before = (daemon.resident_bytes(), daemon.handles());
    let began = Instant::now();
    for number in 0..cycles {
        cycle(&endpoint, WARMING + number).await;
        let due = at_least.mul_f64(number as f64 / cycles as f64);
        tokio::time::sleep(due.saturating_sub(began.elapsed())).await;
    }
    let after = daemon.resident_bytes();
    println!(
        "{cycles} cycles in {:.0?}: memory {} kB, then {} kB",
        began.elapsed(),
        before.0 / 1024,
        after / 1024
    );
    assert!(after < before.0 + GROWTH, "{before:?} {after}");
    until("descriptors and threads return", async || {
        let now = daemon.handles();
        now[0] <= before.1[0] + 2 && now[1] <= before.1[1] + 2
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn repeated_replays_leave_nothing_behind() {
    let (daemon, endpoint) = Process::serve();
    let client = Client::open(&endpoint).await;
    let names = ["a", "b", "c", "d"];
    for name in names {
        client.create(name, json!({"n": 30})).await;
        for number in 0..1500 {
            let noise = json!({"noise": f64::from(number % 50) / 50.0});
            client.ok(name, "set", noise).await;
            if number % 10 == 0 {
                client.ok(name, "step", json!({"steps": 5})).await;
            }
        }
    }
    let verify = async || {
        for pair in names.chunks(2) {
            tokio::join!(client.get(pair[0], "verify"), client.get(pair[1], "verify"));
        }
    };
    verify().await;
    let before = daemon.resident_bytes();
    for _ in 0..15 {
        verify().await;
    }
    let after = daemon.resident_bytes();
    println!("memory {} kB, then {} kB", before / 1024, after / 1024);
    assert!(after < before + RETELLING_GROWTH, "{before} {after}");
}
