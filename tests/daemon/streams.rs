//! What is published: states, orders, events and tokens.

use std::time::{Duration, Instant};

use jostle_proto::{Event, EventKind, OrderSample, Phase, State, keys};
use serde_json::json;
use zenoh::bytes::Encoding;
use zenoh::sample::SampleKind;

use crate::support::{Client, Daemon, NODE, PATIENCE, PREFIX, alone};

pub type Subscriber =
    zenoh::pubsub::Subscriber<zenoh::handlers::FifoChannelHandler<zenoh::sample::Sample>>;

pub async fn subscribe(client: &Client, key: String) -> Subscriber {
    client
        .session
        .declare_subscriber(key)
        .with(zenoh::handlers::FifoChannel::new(10_000))
        .await
        .unwrap()
}

async fn next_state(subscriber: &Subscriber) -> State {
    let sample = tokio::time::timeout(PATIENCE, subscriber.recv_async())
        .await
        .unwrap()
        .unwrap();
    assert_eq!(sample.encoding(), &Encoding::APPLICATION_CBOR);
    State::from_cbor(&sample.payload().to_bytes()).unwrap()
}

pub async fn next_event(subscriber: &Subscriber) -> Event {
    let sample = tokio::time::timeout(PATIENCE, subscriber.recv_async())
        .await
        .unwrap()
        .unwrap();
    assert_eq!(sample.encoding(), &Encoding::APPLICATION_JSON);
    serde_json::from_slice(&sample.payload().to_bytes()).unwrap()
}

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
    let order = tokio::time::timeout(PATIENCE, orders.recv_async())
        .await
        .unwrap()
        .unwrap();
    let order: OrderSample = serde_json::from_slice(&order.payload().to_bytes()).unwrap();
    assert!(order.order.order > 0.0 && order.n == 5);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_comes_just_before_a_command_is_shown_what_it_does() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for k in 0..300 {
        let name = format!("a{k}");
        client.create(&name, json!({"n": 5})).await;
        // zenoh tells a publisher of its readers a moment after they came.
        let states = subscribe(client, keys::state(PREFIX, &name)).await;
        let orders = subscribe(client, keys::order(PREFIX, &name)).await;
        client.ok(&name, "step", json!({})).await;
        assert_eq!(next_state(&states).await.step, 1, "{name}");
        let order = tokio::time::timeout(PATIENCE, orders.recv_async()).await;
        let order = order.unwrap().unwrap();
        let order: OrderSample = serde_json::from_slice(&order.payload().to_bytes()).unwrap();
        assert_eq!(order.step, 1, "{name}");
        client.ok(&name, "delete", json!({})).await;
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn as_many_states_a_second_are_published_as_asked_for_but_no_more_than_max_hz() {
    let _alone = alone().await;
    let daemon = Daemon::for_measuring().await;
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

#[tokio::test(flavor = "multi_thread")]
async fn every_command_to_a_standing_swarm_shows() {
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
async fn events_tell_what_happened_without_a_gap() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let events = subscribe(client, keys::event(PREFIX, "a")).await;
    client.create("a", json!({"n": 5, "rate": null})).await;
    let request = json!({"client": "me", "request_id": "r1",
        "args": {"select": {"ids": [1]}, "direction": 0.0, "for_time": 0.1}});
    client.ok("a", "inform", request).await;
    client.ok("a", "run", json!({"until_step": 10})).await;
    client.reach("a", 10).await;
    client.ok("a", "delete", json!({})).await;
    let mut told = Vec::new();
    while !matches!(
        told.last(),
        Some(Event {
            event: EventKind::Deleted {},
            ..
        })
    ) {
        told.push(next_event(&events).await);
    }
    let numbers: Vec<u64> = told.iter().map(|event| event.number).collect();
    assert_eq!(numbers, (1..=told.len() as u64).collect::<Vec<_>>());
    let kinds: Vec<&EventKind> = told.iter().map(|event| &event.event).collect();
    assert_eq!(kinds[0], &EventKind::Created {});
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
async fn swarms_and_the_node_are_alive_exactly_while_they_are() {
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
        let sample = tokio::time::timeout(PATIENCE, tokens.recv_async())
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
async fn nobody_can_forge_a_state_an_answer_or_a_daemon() {
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
    // The forger's own query comes back after all that it sent before.
    let own = Client { session: forger };
    own.get("a", "status").await;

    assert!(client.ask("jostle/ghost/get/status", None).await.is_empty());
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
    // A session answers about itself; about the daemon nobody does.
    let daemon_zid = daemon.server.zid();
    let admin = own.session.get(format!("@/{daemon_zid}/**")).await.unwrap();
    assert!(
        admin.recv_async().await.is_err(),
        "the admin space is closed"
    );
    daemon.stop().await;
}
