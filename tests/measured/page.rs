//! Tabs of the page that stop reading delay no swarm and use no memory.

use std::time::Duration;

use serde_json::json;
use tokio::time::sleep;

use crate::support::http::of_daemon;
use crate::support::process::Process;
use crate::support::websocket::{next_matching, step_of, tab};
use crate::support::{Client, Daemon};

#[tokio::test(flavor = "multi_thread")]
async fn tabs_that_do_not_read_delay_no_swarm_and_use_no_memory() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let address = of_daemon(&daemon);
    let spec = json!({"n": 200, "seed": 1, "publish_every": 1, "rate": 10.0});
    client.create("a", spec.clone()).await;
    client.ok("a", "run", json!({})).await;
    // A daemon with no page open shows how fast the swarm can step on this machine.
    let (_other, other) = Process::serve();
    let free = Client::open(&other).await;
    free.create("a", spec).await;
    free.ok("a", "run", json!({})).await;
    let bytes = || {
        let statm = std::fs::read_to_string("/proc/self/statm").unwrap();
        let pages: u64 = statm.split(' ').nth(1).unwrap().parse().unwrap();
        pages * 4096
    };
    // None of these reads further; the buffers of their sockets are the system's and bounded.
    let mut stopped = Vec::new();
    for _ in 0..49 {
        let mut tab = tab(&address, "/api/ws?swarm=a").await;
        next_matching(&mut tab, step_of).await;
        stopped.push(tab);
    }
    let mut reading = tab(&address, "/api/ws?swarm=a").await;
    sleep(Duration::from_secs(2)).await;
    let step = async |client: &Client| client.get("a", "status").await["step"].as_u64().unwrap();
    let (before, first) = (bytes(), [step(client).await, step(&free).await]);
    // As many as are shown in 6 s.
    for _ in 0..180 {
        next_matching(&mut reading, step_of).await;
    }
    let steps = [step(client).await - first[0], step(&free).await - first[1]];
    let grown = bytes().saturating_sub(before);
    println!("beside 49 that do not read: {steps:?} steps with and without, {grown} bytes more");
    assert!(steps[0] * 20 > steps[1] * 19, "{steps:?}");
    // 180 frames at 30 a second are 6 s, in which the other swarm takes 3,000 steps.
    assert!(steps[1] < 6000, "{steps:?} in 180 frames");
    assert!(grown < 16 << 20, "{grown}");
    // A tab that reads again receives the newest state after the content of its socket's buffer.
    let newest = next_matching(&mut reading, step_of).await;
    let late = &mut stopped[7];
    next_matching(late, |message| {
        step_of(message).filter(|step| *step >= newest)
    })
    .await;
    drop(stopped);
    daemon.stop().await;
}
