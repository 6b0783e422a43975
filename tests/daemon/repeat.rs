//! The hash depends on spec, seed and commands, not on other swarms, pacing or subscribers.

use jostle_proto::keys;
use serde_json::json;
use zenoh::handlers::RingChannel;

use crate::support::{Daemon, PREFIX};

#[tokio::test(flavor = "multi_thread")]
async fn the_hash_depends_on_nothing_but_spec_seed_and_commands() {
    const STEPS: u64 = 1500;
    let spec = json!({"n": 30, "seed": 11});
    let inform = json!({"select": {"ids": [3, 14, 15]}, "direction": 0.5});
    let daemon = Daemon::start().await;
    let client = &daemon.client;

    client.create("alone", spec.clone()).await;
    client.ok("alone", "inform", inform.clone()).await;
    let expected = client.hash_at("alone", STEPS).await;

    // Beside other swarms, with subscribers, publishing every step.
    let watcher = daemon.another_client().await;
    let subscriber = watcher
        .session
        .declare_subscriber(keys::state(PREFIX, "*"))
        .with(RingChannel::new(4))
        .await
        .unwrap();
    for other in 0..8 {
        let name = format!("other-{other}");
        client
            .create(&name, json!({"n": 30, "seed": other, "rate": null}))
            .await;
        client.ok(&name, "run", json!({})).await;
    }
    let mut every_step = spec.clone();
    every_step["publish_every"] = json!(1);
    client.create("beside", every_step).await;
    client.ok("beside", "inform", inform.clone()).await;
    assert_eq!(client.hash_at("beside", STEPS).await, expected);
    assert!(subscriber.try_recv().unwrap().is_some(), "it was watched");

    // Step by step, in larger steps, and at a rate.
    client.create("by-one", spec.clone()).await;
    client.ok("by-one", "inform", inform.clone()).await;
    for _ in 0..100 {
        client.ok("by-one", "step", json!({})).await;
    }
    client
        .ok("by-one", "run", json!({"rate": 100, "until_step": 600}))
        .await;
    client.wait_for_step("by-one", 600).await;
    let reply = client
        .ok(
            "by-one",
            "step",
            json!({"timeout_secs": 60, "args": {"steps": STEPS - 600}}),
        )
        .await;
    assert_eq!(reply["result"]["state_hash"], expected);

    // After a reset; another seed gives another hash.
    client.ok("by-one", "reset", json!({})).await;
    client.ok("by-one", "inform", inform.clone()).await;
    assert_eq!(client.hash_at("by-one", STEPS).await, expected);
    client.ok("by-one", "reset", json!({"seed": 12})).await;
    client.ok("by-one", "inform", inform).await;
    assert_ne!(client.hash_at("by-one", STEPS).await, expected);
    daemon.stop().await;
}
