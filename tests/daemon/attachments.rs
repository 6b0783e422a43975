//! What is attached to published states and recorded with them: times, and the newest set-points.

use std::collections::BTreeMap;
use std::time::{Duration, SystemTime};

use jostle_proto::{Attachment, State, keys, unix_nanos};
use jostle_results::recording::{self, Message};
use serde_json::{Value, json};
use zenoh::sample::Sample;

use crate::support::playback::{recorded_file, state_bytes, upload_and_open};
use crate::support::recording::{begin, folder_of, has, start_daemon, stop};
use crate::support::streams::{Subscriber, subscribe};
use crate::support::{Client, Daemon, PREFIX, TIMEOUT, until};

async fn next_sample(states: &Subscriber) -> Sample {
    let sample = tokio::time::timeout(TIMEOUT, states.recv_async()).await;
    sample.expect("a state is published").unwrap()
}

/// The next state, with what is attached to it.
async fn next(states: &Subscriber) -> (State, Attachment) {
    let sample = next_sample(states).await;
    let attachment = sample.attachment().expect("a state has an attachment");
    let state = State::from_cbor(&sample.payload().to_bytes()).unwrap();
    (
        state,
        Attachment::from_cbor(&attachment.to_bytes()).unwrap(),
    )
}

fn now() -> u64 {
    unix_nanos(SystemTime::now()).unwrap()
}

async fn join_freely(client: &Client, controller: &str, ids: &[u32]) {
    let join = json!({"controller": controller, "select": {"ids": ids}, "mode": "free_running",
        "deadline_secs": 60.0, "on_timeout": "free"});
    client.ok("a", "join", join).await;
}

async fn put(client: &Client, controller: &str, sequence: u64, id: u32, weight: f64) {
    let control = json!({"sequence": sequence,
        "set": {"ids": [id], "direction": [1.0], "weight": [weight]}});
    let key = keys::ctl(PREFIX, "a", controller);
    let put = client.session.put(key, control.to_string());
    put.encoding("application/json").await.unwrap();
}

fn numbers(of: &[(&str, u64)]) -> BTreeMap<String, u64> {
    of.iter()
        .map(|(name, number)| ((*name).to_owned(), *number))
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_state_has_the_times_of_its_step_and_of_its_publication() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let spec = json!({"n": 6, "rate": 1, "publish_every": 1});
    client.create("a", spec).await;
    let states = subscribe(client, keys::state(PREFIX, "a")).await;
    let began = now();
    // Before the first step.
    let inform = json!({"select": {"ids": [0]}, "direction": 0.5});
    client.ok("a", "inform", inform.clone()).await;
    let (state, attachment) = next(&states).await;
    assert_eq!((state.step, attachment.stepped_unix_nanos), (0, None));
    assert!(
        attachment
            .published_unix_nanos
            .is_some_and(|it| began <= it && it <= now())
    );
    assert_eq!(attachment.sequences, numbers(&[]));

    client.ok("a", "run", json!({"until_step": 30})).await;
    let (mut stepped_before, mut published_before, mut step_before) = (began, began, 0);
    loop {
        let (state, attachment) = next(&states).await;
        if state.step == 0 {
            continue;
        }
        let stepped = attachment.stepped_unix_nanos.unwrap();
        let published = attachment.published_unix_nanos.unwrap();
        assert!(stepped_before < stepped, "step {}", state.step);
        assert!(stepped <= published && published <= now(), "{attachment:?}");
        assert!(published_before < published);
        // Fifty steps a second: the time is that of the step and not of something around it.
        let least =
            Duration::from_millis(10) * u32::try_from(state.step - step_before - 1).unwrap();
        assert!(u128::from(stepped - stepped_before) >= least.as_nanos());
        (stepped_before, published_before, step_before) = (stepped, published, state.step);
        if state.step == 30 {
            break;
        }
    }
    // What a command changes in a paused swarm was published now and stepped before.
    until("it is paused", async || {
        client.get("a", "status").await["phase"] == "paused"
    })
    .await;
    let commanded = now();
    client.ok("a", "inform", inform).await;
    let published = async |is_expected: &dyn Fn(&Attachment) -> bool| loop {
        let (state, attachment) = next(&states).await;
        if is_expected(&attachment) {
            return (state, attachment);
        }
    };
    let is_later = |it: &Attachment| it.published_unix_nanos >= Some(commanded);
    let (state, attachment) = published(&is_later).await;
    assert_eq!(state.step, 30);
    assert_eq!(attachment.stepped_unix_nanos, Some(stepped_before));

    // After a reset no step has led to the state.
    client.ok("a", "reset", json!({})).await;
    let (state, _) = published(&|it| it.stepped_unix_nanos.is_none()).await;
    assert_eq!((state.step, state.epoch), (0, 2));

    // Nor does a restarted daemon know when it was.
    client.ok("a", "step", json!({"steps": 3})).await;
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    let states = subscribe(client, keys::state(PREFIX, "a")).await;
    let inform = json!({"select": {"ids": [1]}, "direction": 0.5});
    client.ok("a", "inform", inform).await;
    let (state, attachment) = next(&states).await;
    assert_eq!((state.step, attachment.stepped_unix_nanos), (3, None));
    client.ok("a", "step", json!({})).await;
    while next(&states).await.1.stepped_unix_nanos.is_none() {}
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_state_has_the_numbers_of_the_set_points_in_it() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let spec = json!({"n": 8, "rate": 2, "publish_every": 1});
    client.create("a", spec).await;
    let states = subscribe(client, keys::state(PREFIX, "a")).await;
    client.ok("a", "run", json!({})).await;
    join_freely(client, "ada", &[3, 4]).await;
    join_freely(client, "bob", &[5]).await;
    let mut seen: Vec<BTreeMap<String, u64>> = Vec::new();
    // Receives states until one has these numbers. In each, the weights are those of the numbers.
    let mut follow = async |until: &[(&str, u64)]| loop {
        let (state, attachment) = next(&states).await;
        let of = |name: &str| attachment.sequences.get(name).copied().unwrap_or(0) as f64;
        assert_eq!(
            (state.weight[3], state.weight[5]),
            (of("ada"), of("bob")),
            "{state:?}"
        );
        if seen.last() != Some(&attachment.sequences) {
            seen.push(attachment.sequences.clone());
        }
        if attachment.sequences == numbers(until) {
            break;
        }
    };
    follow(&[]).await;
    let began = SystemTime::now();
    put(client, "ada", 7, 3, 7.0).await;
    follow(&[("ada", 7)]).await;
    // The latency from a set-point to a state that used it.
    assert!(began.elapsed().unwrap() < TIMEOUT);
    put(client, "bob", 2, 5, 2.0).await;
    follow(&[("ada", 7), ("bob", 2)]).await;
    // Those that are rejected or stale are in no state.
    put(client, "ada", 8, 5, 8.0).await;
    put(client, "bob", 1, 5, 1.0).await;
    until("both are counted", async || {
        let all = client.get("a", "controllers").await["result"]["controllers"].clone();
        all[0]["puts"]["refused"] == 1 && all[1]["puts"]["stale"] == 1
    })
    .await;
    put(client, "ada", 9, 3, 9.0).await;
    follow(&[("ada", 9), ("bob", 2)]).await;
    // Nor are those of a controller that has left.
    client.ok("a", "leave", json!({"controller": "ada"})).await;
    follow(&[("bob", 2)]).await;
    let expected = [
        numbers(&[]),
        numbers(&[("ada", 7)]),
        numbers(&[("ada", 7), ("bob", 2)]),
        numbers(&[("ada", 9), ("bob", 2)]),
        numbers(&[("bob", 2)]),
    ];
    assert_eq!(seen, expected);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_payload_has_a_time_and_a_reply_has_no_attachment() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for name in ["a", "b"] {
        let spec = json!({"n": 6, "seed": 5, "publish_every": 1, "rate": null});
        client.create(name, spec).await;
    }
    let states = subscribe(client, keys::state(PREFIX, "a")).await;
    client.ok("a", "step", json!({"steps": 20})).await;
    let sample = loop {
        let sample = next_sample(&states).await;
        let state = State::from_cbor(&sample.payload().to_bytes()).unwrap();
        if state.step == 20 {
            break sample;
        }
    };
    assert!(sample.attachment().is_some());
    // zenoh's own timestamp is a switch of the whole session.
    assert!(sample.timestamp().is_none());
    let published = sample.payload().to_bytes().into_owned();
    assert_eq!(
        published,
        state_bytes(client, "a").await,
        "as a query replies"
    );
    let replies = client.session.get(keys::state(PREFIX, "a")).await.unwrap();
    let reply = replies.recv_async().await.unwrap();
    assert!(reply.result().unwrap().attachment().is_none());
    // The type, whose fixture is tested, has no other field.
    let state = State::from_cbor(&published).unwrap();
    assert_eq!(state.to_cbor(), published);
    // Whether it is watched changes no state.
    client.ok("b", "step", json!({"steps": 20})).await;
    assert_eq!(client.hash("a").await, client.hash("b").await);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_playback_publishes_now_and_takes_no_steps() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let file = recorded_file(client).await;
    upload_and_open(client, "a", &file).await.unwrap();
    let states = subscribe(client, keys::state(PREFIX, "a")).await;
    let began = now();
    client.ok("a", "step", json!({})).await;
    let (_, attachment) = next(&states).await;
    assert!(
        attachment
            .published_unix_nanos
            .is_some_and(|it| began <= it && it <= now())
    );
    assert_eq!(
        (attachment.stepped_unix_nanos, attachment.sequences),
        (None, numbers(&[]))
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_by_the_daemon_has_the_times_of_the_steps() {
    let data = tempfile::tempdir().unwrap();
    let (mut process, client) = start_daemon(data.path(), "").await;
    client
        .create("a", json!({"n": 5, "publish_every": 1, "rate": 1}))
        .await;
    let began = now();
    client.ok("a", "run", json!({})).await;
    join_freely(&client, "ada", &[3]).await;
    begin(&client, "a", "take").await;
    has(&client, "take", "frames", 3).await;
    put(&client, "ada", 4, 3, 4.0).await;
    let controllers =
        async || client.get("a", "controllers").await["result"]["controllers"][0].clone();
    until("it is applied", async || {
        controllers().await["puts"]["applied"] == 1
    })
    .await;
    let frames = has(&client, "take", "frames", 1).await["frames"]
        .as_u64()
        .unwrap();
    has(&client, "take", "frames", frames + 3).await;
    stop(&client, "take").await;
    let mut recorded = 0;
    let mut check = |message: &Message<'_>| {
        if message.topic != "state" {
            assert_eq!(message.attachment, None, "{}", message.topic);
            return;
        }
        recorded += 1;
        let state = State::from_cbor(message.bytes).unwrap();
        let attachment = Attachment::from_cbor(message.attachment.unwrap()).unwrap();
        assert_eq!(
            attachment.published_unix_nanos, None,
            "it may not be published"
        );
        // The log time is that of the simulation, by which players order and draw messages.
        assert_eq!(message.header.log_time as f64, (state.time * 1e9).round());
        if state.step > 0 {
            let stepped = attachment.stepped_unix_nanos.unwrap();
            assert!(began <= stepped && stepped <= message.header.publish_time);
            assert!(message.header.publish_time <= now());
        }
        let is_steered = state.weight[3] == 4.0;
        assert_eq!(attachment.sequences.get("ada"), is_steered.then_some(&4));
    };
    for part in recording::parts(&folder_of(data.path(), "take")).unwrap() {
        recording::read(&part, |message| {
            check(&message);
            Ok(())
        })
        .unwrap();
    }
    assert!(recorded >= 6, "{recorded}");
    let status: Value = client.get("a", "status").await;
    assert_eq!(status["phase"], "running");
    process.kill();
}
