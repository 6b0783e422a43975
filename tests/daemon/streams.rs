//! What is published: states, orders, events and tokens.

use std::collections::BTreeMap;

use jostle_proto::{Event, EventKind, OrderSample, Phase, keys};
use serde_json::json;
use zenoh::sample::{Locality, SampleKind};

use crate::support::playback;
use crate::support::recording::start_daemon;
use crate::support::streams::{next_event, next_state, subscribe};
use crate::support::{Daemon, NODE, PREFIX, TIMEOUT};

#[tokio::test(flavor = "multi_thread")]
async fn a_running_swarm_is_published_every_so_many_steps_and_frames_count_up() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client
        .create("a", json!({"n": 5, "rate": 4, "publish_every": 10}))
        .await;
    let states = subscribe(client, keys::state(PREFIX, "a")).await;
    let orders = subscribe(client, keys::order(PREFIX, "a")).await;
    client.ok("a", "run", json!({"until_step": 100})).await;
    let (mut frames, mut steps) = (Vec::new(), Vec::new());
    while steps.last() != Some(&100) {
        let state = next_state(&states).await;
        assert!(state.certificate.residual <= 1e-9);
        frames.push(state.frame);
        steps.push(state.step);
    }
    // 200 steps a second, one in ten published: far below the cap of 50 a second.
    assert_eq!(steps, [0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100]);
    assert!(
        frames.windows(2).all(|pair| pair[1] == pair[0] + 1),
        "{frames:?}"
    );
    let order = tokio::time::timeout(TIMEOUT, orders.recv_async())
        .await
        .unwrap()
        .unwrap();
    let order: OrderSample = serde_json::from_slice(&order.payload().to_bytes()).unwrap();
    assert!(order.order.order > 0.0 && order.n == 5);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn states_published_after_a_queried_one_have_greater_numbers() {
    let folder = tempfile::tempdir().unwrap();
    // More than the 20 ms between two publications.
    let (mut daemon, client) = start_daemon(folder.path(), "reply=sleep(30)").await;
    let spec = json!({"n": 5, "rate": 4, "publish_every": 1});
    client.create("a", spec).await;
    let states = subscribe(&client, keys::state(PREFIX, "a")).await;
    client.ok("a", "run", json!({})).await;
    let mut queried = Vec::new();
    for _ in 0..30 {
        let state = playback::state(&client, "a").await;
        queried.push((state.frame, state.step));
    }
    client.ok("a", "pause", json!({})).await;
    let (last, _) = queried[queried.len() - 1];
    let mut published = BTreeMap::new();
    while published.last_key_value().is_none_or(|(it, _)| *it < last) {
        let state = next_state(&states).await;
        published.insert(state.frame, state.step);
    }
    assert!(published.len() > 10, "{}", published.len());
    for (frame, step) in queried {
        let newest = published.range(..=frame).next_back();
        let newest = newest.map_or(0, |(_, step)| *step);
        assert!(
            newest <= step,
            "step {step} has the number {frame} of step {newest}"
        );
    }
    daemon.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_subscriber_from_just_before_a_command_receives_its_effect() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for k in 0..300 {
        let name = format!("a{k}");
        client.create(&name, json!({"n": 5})).await;
        // zenoh notifies a publisher of a new subscriber a moment later.
        let states = subscribe(client, keys::state(PREFIX, &name)).await;
        let orders = subscribe(client, keys::order(PREFIX, &name)).await;
        client.ok(&name, "step", json!({})).await;
        assert_eq!(next_state(&states).await.step, 1, "{name}");
        let order = tokio::time::timeout(TIMEOUT, orders.recv_async()).await;
        let order = order.unwrap().unwrap();
        let order: OrderSample = serde_json::from_slice(&order.payload().to_bytes()).unwrap();
        assert_eq!(order.step, 1, "{name}");
        client.ok(&name, "delete", json!({})).await;
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_effect_of_every_command_to_a_paused_swarm_is_published() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 5})).await;
    let states = subscribe(client, keys::state(PREFIX, "a")).await;
    client
        .ok(
            "a",
            "inform",
            json!({"select": {"ids": [2]}, "direction": 1}),
        )
        .await;
    assert_eq!(next_state(&states).await.weight[2], 0.5);
    client.ok("a", "inject", json!({"count": 1})).await;
    assert_eq!(next_state(&states).await.id, [0, 1, 2, 3, 4, 5]);
    client.ok("a", "step", json!({"steps": 3})).await;
    assert_eq!(next_state(&states).await.step, 3);
    client.ok("a", "reset", json!({})).await;
    let state = next_state(&states).await;
    assert_eq!(
        (state.epoch, state.step, state.phase),
        (2, 0, Phase::Paused)
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn events_report_what_happened_without_a_gap() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let events = subscribe(client, keys::event(PREFIX, "a")).await;
    client.create("a", json!({"n": 5, "rate": null})).await;
    let request = json!({"client": "me", "request_id": "r1",
        "args": {"select": {"ids": [1]}, "direction": 0.0, "for_time": 0.1}});
    client.ok("a", "inform", request).await;
    client.ok("a", "run", json!({"until_step": 10})).await;
    client.wait_for_step("a", 10).await;
    client.ok("a", "delete", json!({})).await;
    let mut received = Vec::new();
    while !matches!(
        received.last(),
        Some(Event {
            event: EventKind::Deleted { .. },
            ..
        })
    ) {
        received.push(next_event(&events).await);
    }
    let numbers: Vec<u64> = received.iter().map(|event| event.number).collect();
    assert_eq!(numbers, (1..=received.len() as u64).collect::<Vec<_>>());
    let kinds: Vec<&EventKind> = received.iter().map(|event| &event.event).collect();
    assert!(matches!(kinds[0], EventKind::Created { .. }));
    let EventKind::Command {
        seq: 1,
        verb,
        args,
        client: Some(sender),
        request_id: Some(id),
    } = kinds[1]
    else {
        panic!("{:?}", kinds[1]);
    };
    assert_eq!(
        (verb.as_str(), sender.as_str(), id.as_str()),
        ("inform", "me", "r1")
    );
    assert_eq!(args["for_time"], 0.1);
    assert!(kinds.contains(&&EventKind::Lapsed { ids: vec![1] }));
    assert!(kinds.contains(&&EventKind::Phase {
        reason: Some("finished".into())
    }));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn swarms_and_the_node_have_tokens_exactly_while_they_exist() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let watcher = daemon.another_client().await;
    let tokens = watcher
        .session
        .liveliness()
        .declare_subscriber(keys::alive(PREFIX, "*", "*"))
        .history(true)
        .with(zenoh::handlers::FifoChannel::new(100))
        .await
        .unwrap();
    let nodes = watcher
        .session
        .liveliness()
        .get(keys::node_alive(PREFIX, "*"))
        .await
        .unwrap();
    let node = nodes.recv_async().await.unwrap().into_result().unwrap();
    assert_eq!(node.key_expr().as_str(), keys::node_alive(PREFIX, NODE));

    let next = async || {
        let sample = tokio::time::timeout(TIMEOUT, tokens.recv_async())
            .await
            .unwrap()
            .unwrap();
        (sample.key_expr().as_str().to_owned(), sample.kind())
    };
    client.create("a", json!({"n": 1})).await;
    let key = keys::alive(PREFIX, "a", NODE);
    assert_eq!(next().await, (key.clone(), SampleKind::Put));
    client.ok("a", "delete", json!({})).await;
    assert_eq!(next().await, (key, SampleKind::Delete));
    client.create("b", json!({"n": 1})).await;
    assert_eq!(next().await.1, SampleKind::Put);
    daemon.stop().await;
    assert_eq!(
        next().await,
        (keys::alive(PREFIX, "b", NODE), SampleKind::Delete)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn no_client_can_forge_a_state_a_reply_or_a_daemon() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    let states = subscribe(client, keys::state(PREFIX, "a")).await;
    let forger = daemon.another_client().await.session;
    forger
        .put(keys::state(PREFIX, "a"), "forged")
        .await
        .unwrap();
    forger.delete(keys::state(PREFIX, "a")).await.unwrap();
    let _token = forger
        .liveliness()
        .declare_token(keys::alive(PREFIX, "ghost", "x"))
        .await
        .unwrap();
    let answer = "forged";
    let _queryable = forger
        .declare_queryable("jostle/**")
        .callback(move |query| {
            let _ = zenoh::Wait::wait(query.reply(query.key_expr(), answer));
        })
        .await
        .unwrap();
    // The forger's own query comes back after all that it sent before. Its own queryable, which it can hear before
    // that of the daemon, is not asked.
    let own = forger
        .get(keys::get(PREFIX, "a", "status"))
        .allowed_destination(Locality::Remote)
        .await
        .unwrap();
    assert!(own.recv_async().await.unwrap().result().is_ok());

    assert!(
        client
            .query_all("jostle/ghost/get/status", None)
            .await
            .is_empty()
    );
    client.get("a", "status").await;
    let alive = client
        .session
        .liveliness()
        .get(keys::alive(PREFIX, "*", "*"))
        .await
        .unwrap();
    let mut tokens = Vec::new();
    while let Ok(reply) = alive.recv_async().await {
        tokens.push(reply.into_result().unwrap().key_expr().as_str().to_owned());
    }
    assert_eq!(tokens, [keys::alive(PREFIX, "a", NODE)]);
    client.ok("a", "step", json!({})).await;
    assert_eq!(
        next_state(&states).await.step,
        1,
        "the first thing to arrive is genuine"
    );
    // A session replies about itself; none replies about the daemon.
    let daemon_zid = daemon.server.zid();
    let admin = forger.get(format!("@/{daemon_zid}/**")).await.unwrap();
    assert!(
        admin.recv_async().await.is_err(),
        "the admin space is closed"
    );
    daemon.stop().await;
}
