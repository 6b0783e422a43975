//! The rate at which states are published.

use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde_json::json;

use crate::support::streams::{next_state, subscribe};
use crate::support::{Daemon, PREFIX};

#[tokio::test(flavor = "multi_thread")]
async fn as_many_states_a_second_are_published_as_requested_but_no_more_than_max_hz() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client
        .create("a", json!({"n": 5, "publish_every": 5}))
        .await;
    let states = subscribe(client, keys::state(PREFIX, "a")).await;
    // Of 50 steps in a time unit ten are published: at rate 4 forty a second, at 20 two hundred.
    for (rate, least, most) in [(4.0, 37.0, 42.0), (5.0, 45.0, 53.0), (20.0, 45.0, 53.0)] {
        client.ok("a", "run", json!({"rate": rate})).await;
        let first = next_state(&states).await.frame;
        let (began, mut last) = (Instant::now(), first);
        while began.elapsed() < Duration::from_secs(2) {
            last = next_state(&states).await.frame;
        }
        let hz = (last - first) as f64 / began.elapsed().as_secs_f64();
        println!("rate {rate}: {hz:.1} states a second");
        assert!(least < hz && hz < most, "rate {rate}: {hz}");
    }
    daemon.stop().await;
}
