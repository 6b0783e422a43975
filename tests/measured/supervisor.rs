//! The intervals of the watchdog's messages.

use std::time::{Duration, Instant};

use serde_json::json;

use crate::support::Client;
use crate::support::supervisor::Supervisor;

#[tokio::test(flavor = "multi_thread")]
async fn ready_watchdog_and_stopping_are_sent_in_time() {
    let supervisor = Supervisor::listen();
    let watchdog = Duration::from_secs(1);
    let (mut daemon, endpoint) = supervisor.start(Some(watchdog), "");
    assert_eq!(supervisor.receive(), "READY=1\n");
    assert_eq!(supervisor.receive(), "WATCHDOG=1\n");
    assert_eq!(supervisor.receive(), "STATUS=0 swarms, healthy\n");
    let began = Instant::now();
    for _ in 0..4 {
        let asked = Instant::now();
        assert_eq!(supervisor.receive(), "WATCHDOG=1\n");
        assert!(asked.elapsed() < watchdog, "{:?}", asked.elapsed());
    }
    let took = began.elapsed();
    println!("fed four times in {took:?}");
    assert!(took > Duration::from_millis(1900), "{took:?}");
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 5})).await;
    supervisor.receive_until("STATUS=1 swarm, healthy\n");
    daemon.signal("-TERM");
    let before = supervisor.receive_until("STOPPING=1\n");
    assert!(before.iter().all(|it| it == "WATCHDOG=1\n"), "{before:?}");
    assert_eq!(daemon.end().0, Some(0));
    supervisor.socket.set_nonblocking(true).unwrap();
    assert!(supervisor.socket.recv(&mut [0; 1]).is_err(), "the end");
}
