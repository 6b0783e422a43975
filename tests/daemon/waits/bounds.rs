//! The limits of waits, and what ends them.

use std::io::Write as _;
use std::net::TcpStream;

use jostle_proto::ErrorCode;
use serde_json::json;

use super::{GONE, MAX_WAITS, begin, code, hold, selector, spec, wait, waits};
use crate::support::{Daemon, http, until_within};

#[tokio::test(flavor = "multi_thread")]
async fn sixteen_wait_and_their_places_are_free_after_their_tokens() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    let mut tokens = Vec::new();
    for k in 0..MAX_WAITS {
        tokens.push(begin(client, "a", &format!("w{k}")).await.unwrap());
    }
    let full = begin(client, "a", "more").await.unwrap_err();
    assert_eq!(full.code, ErrorCode::ResourceExhausted, "{full:?}");
    assert!(full.message.contains("jostle status"), "{full:?}");
    assert_eq!(full.details["limit"], 16);
    // Repeating one takes no further place, and conditions have places of their own.
    assert!(begin(client, "a", "w3").await.is_ok());
    client
        .ok(
            "a",
            "when",
            json!({"condition": "order > 1", "pause": true}),
        )
        .await;
    // Those without a query and with one, whose clients are gone.
    let other = daemon.another_client().await;
    let key = selector("a", "order > 1", "w0", 30.0);
    let pending = tokio::spawn(async move { other.query_all(&key, None).await });
    drop(tokens);
    until_within(GONE, "all are gone", async || {
        waits(client, "a").await.is_empty()
    })
    .await;
    let ended = pending.await.unwrap().remove(0);
    assert_eq!(code(ended), Some(ErrorCode::IncorrectState));
    assert!(begin(client, "a", "more").await.is_ok());
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wait_whose_token_stays_ends_without_a_query() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    let _token = begin(client, "a", "w").await.unwrap();
    let gone = async || waits(client, "a").await.is_empty();
    assert!(!gone().await);
    until_within(3 * GONE, "it is gone", gone).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn over_http_the_connection_holds_a_wait() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    let address = http::of_daemon(&daemon);
    let request = |parameters: &str| {
        format!("GET /api/get/a/get/wait?{parameters} HTTP/1.1\r\nHost: {address}\r\n\r\n")
    };
    let open = |parameters: &str| {
        let mut stream = TcpStream::connect(&address).unwrap();
        stream.write_all(request(parameters).as_bytes()).unwrap();
        stream
    };
    // Without an id, too.
    let streams = [
        open("condition=order%3E1"),
        open("condition=order%3E1"),
        open("condition=order%3E1&id=mine"),
    ];
    let count = async |count: usize| waits(client, "a").await.len() == count;
    until_within(GONE, "they wait", async || count(3).await).await;
    drop(streams);
    until_within(GONE, "they are gone", async || count(0).await).await;
    // One that is repeated goes on.
    let path = "/api/get/a/get/wait?condition=order>=0+for+2&id=mine&timeout_secs=0.1";
    let path = path.replace('>', "%3E");
    let get = || {
        let (address, path) = (address.clone(), path.clone());
        tokio::task::spawn_blocking(move || http::get(&address, &path))
    };
    for _ in 0..3 {
        assert_eq!(get().await.unwrap().0, 504);
        client.ok("a", "step", json!({"steps": 30})).await;
    }
    assert_eq!(get().await.unwrap().0, 504);
    client.ok("a", "step", json!({"steps": 9})).await;
    assert!(count(1).await);
    client.ok("a", "step", json!({"steps": 1})).await;
    // It has held without a query, which the next one says.
    assert!(count(0).await);
    let (status, _, body) = get().await.unwrap();
    let reply: serde_json::Value = serde_json::from_str(&body).unwrap();
    assert_eq!((status, &reply["step"]), (200, &json!(100)), "{body}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn over_http_the_last_query_holds_a_wait() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    let address = http::of_daemon(&daemon);
    let path = |parameters: &str| format!("/api/get/a/get/wait?condition={parameters}");
    for parameters in ["order%3E1&id=mine", "milling%3E1&id=theirs"] {
        let (address, path) = (address.clone(), path(parameters) + "&timeout_secs=0.1");
        let replied = tokio::task::spawn_blocking(move || http::get(&address, &path));
        assert_eq!(replied.await.unwrap().0, 504);
    }
    let mut again = TcpStream::connect(&address).unwrap();
    let path = path("order%3E1&id=mine");
    let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n");
    again.write_all(request.as_bytes()).unwrap();
    let mine = json!({"condition": "order > 1", "user": null});
    until_within(GONE, "only the one with a query is left", async || {
        waits(client, "a").await == [mine.clone()]
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn conditions_that_cost_too_much_together_are_rejected() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(50)).await;
    let gap = |k: usize| format!("clusters.count(0.{k:02})");
    let mut tokens = Vec::new();
    let mut rejected = 0;
    for k in 1..=16 {
        let id = format!("w{k}");
        tokens.push(hold(client, "a", &id).await);
        let condition = format!("{} < 1", gap(k)).replace("< 1", "<= 1");
        let error = wait(client, "a", &condition, &id, 0.05).await.unwrap_err();
        match error.code {
            ErrorCode::DeadlineExceeded => {}
            ErrorCode::ResourceExhausted => {
                rejected += 1;
                assert!(error.message.contains("clusters.count(0.0"), "{error:?}");
                assert!(error.message.contains("every step"), "{error:?}");
            }
            _ => panic!("{error:?}"),
        }
    }
    assert!((1..=15).contains(&rejected), "{rejected}");
    // The same measure costs nothing more, and one of another kind is counted apart.
    for (id, condition) in [("x", format!("{} <= 2", gap(1))), ("y", "order > 1".into())] {
        tokens.push(hold(client, "a", id).await);
        let expired = wait(client, "a", &condition, id, 0.05).await;
        assert_eq!(
            code(expired),
            Some(ErrorCode::DeadlineExceeded),
            "{condition}"
        );
    }
    // Conditions have the same bound; a single one is always accepted.
    let many: Vec<String> = (1..=16).map(|k| format!("{} <= 1", gap(k))).collect();
    let pause = |condition: &str| json!({"condition": condition, "pause": true});
    client.ok("a", "when", pause(&many.join(" or "))).await;
    let one = |k: usize| pause(&format!("{} <= 1 for 9", gap(k)));
    client.ok("a", "when", one(1)).await;
    let (code, message) = client.err("a", "when", one(17)).await;
    assert_eq!(code, ErrorCode::ResourceExhausted, "{message}");
    client.ok("a", "step", json!({"steps": 20})).await;
    let verified = client.get("a", "verify").await["result"].take();
    assert_eq!(verified["differs_at"], json!(null), "{verified}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_group_that_grows_ends_the_waits_that_need_too_much() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    // 10,000 steps of n + 8 poses.
    let long = "msd(200) >= 0";
    let _tokens = [
        hold(client, "a", "long").await,
        begin(client, "a", "order").await.unwrap(),
    ];
    let other = daemon.another_client().await;
    let waiting = wait(&other, "a", long, "long", 20.0);
    let growing = async {
        until_within(GONE, "both wait", async || {
            waits(client, "a").await.len() == 2
        })
        .await;
        client.ok("a", "inject", json!({"count": 20})).await;
        client.ok("a", "step", json!({"steps": 2})).await;
    };
    let (ended, ()) = tokio::join!(waiting, growing);
    let ended = ended.unwrap_err();
    assert_eq!(ended.code, ErrorCode::InvalidArgument, "{ended:?}");
    assert!(ended.message.contains("400000 poses"), "{ended:?}");
    let left = waits(client, "a").await;
    assert_eq!(left, [json!({"condition": "order > 1", "user": null})]);
    let again = wait(client, "a", long, "long", 20.0).await;
    assert_eq!(code(again), Some(ErrorCode::InvalidArgument));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_past_of_waits_counts_as_memory_of_the_swarm() {
    let daemon = Daemon::with(&[("max_memory_mb", "8")]).await;
    let client = &daemon.client;
    client.create("a", spec(100)).await;
    let memory = async || {
        client.node("status").await["memory_bytes"]
            .as_u64()
            .unwrap()
    };
    let before = memory().await;
    let tokens = [
        hold(client, "a", "long").await,
        hold(client, "a", "short").await,
    ];
    // 2,000 steps of 108 poses, and 250 steps.
    let error = wait(client, "a", "msd(40) > 1e9", "long", 0.05)
        .await
        .unwrap_err();
    assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
    assert!(error.message.contains("max_memory_mb"), "{error:?}");
    assert_eq!(memory().await, before);
    let expired = wait(client, "a", "msd(5) > 1e9", "short", 0.05).await;
    assert_eq!(code(expired), Some(ErrorCode::DeadlineExceeded));
    assert_eq!(memory().await - before, 251 * 108 * 28);
    // Those of all swarms take at most a quarter, so that others can create swarms.
    client.create("c", spec(100)).await;
    let _more = hold(client, "c", "more").await;
    let expired = wait(client, "c", "msd(5) > 1e9", "more", 0.05).await;
    assert_eq!(code(expired), Some(ErrorCode::DeadlineExceeded));
    client.create("d", spec(100)).await;
    let _last = hold(client, "d", "last").await;
    let error = wait(client, "d", "msd(5) > 1e9", "last", 20.0)
        .await
        .unwrap_err();
    assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
    client.ok("c", "delete", json!({})).await;
    client.ok("d", "delete", json!({})).await;
    // It is part of no checkpoint.
    client.ok("a", "step", json!({"steps": 300})).await;
    let snapshot = crate::when::snapshot_of(client, "a").await;
    client.create("b", spec(100)).await;
    client.ok("b", "step", json!({"steps": 300})).await;
    let other = crate::when::snapshot_of(client, "b").await;
    assert!(
        snapshot.len().abs_diff(other.len()) < 64,
        "{}",
        snapshot.len()
    );
    let with_past = memory().await;
    drop(tokens);
    until_within(GONE, "the memory is free", async || {
        memory().await == with_past - 251 * 108 * 28
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_condition_is_removed_by_its_id_and_shows_its_owner() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec(12)).await;
    for (k, name) in ["ada", "bob"].into_iter().enumerate() {
        let args = json!({"condition": format!("order > 0.99{k}"), "pause": true});
        client
            .ok("a", "when", json!({"client": name, "args": args}))
            .await;
    }
    let args = json!({"condition": "order > 1", "event": "mine"});
    client.ok("a", "when", args).await;
    let conditions = async || client.get("a", "status").await["result"]["conditions"].take();
    let before = conditions().await;
    let owners: Vec<_> = (0..3).map(|k| before[k]["client"].clone()).collect();
    assert_eq!(owners, [json!("ada"), json!("bob"), json!(null)]);
    assert_eq!(before[2]["event"], "mine");
    assert_eq!(
        [&before[0]["action"], &before[2]["action"]],
        ["pause", "event"]
    );
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    let conditions = async || client.get("a", "status").await["result"]["conditions"].take();
    assert_eq!(conditions().await, before, "after a restart");
    let cancel = json!({"cancel": true, "id": before[1]["id"]});
    client.ok("a", "when", cancel.clone()).await;
    assert_eq!(conditions().await, json!([before[0], before[2]]));
    let (code, message) = client.err("a", "when", cancel).await;
    assert_eq!(code, ErrorCode::NotFound, "{message}");
    for args in [
        json!({"id": "a"}),
        json!({"cancel": true, "id": "A"}),
        json!({"cancel": true, "id": "a", "event": "b"}),
        json!({"condition": "order > 0", "pause": true, "id": "a"}),
    ] {
        let (code, message) = client.err("a", "when", args.clone()).await;
        assert_eq!(code, ErrorCode::InvalidArgument, "{args}: {message}");
    }
    let verified = client.get("a", "verify").await["result"].take();
    assert_eq!(verified["differs_at"], json!(null), "{verified}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_error_of_a_wait_has_the_range_of_its_time_and_what_it_can_be_for() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 4})).await;
    let error = async |noun: &str| {
        let key = jostle_proto::keys::get(super::PREFIX, "a", noun);
        client.query(&key, None).await.unwrap_err()
    };
    for secs in ["0", "-1", "31", "NaN", "soon"] {
        let error = error(&format!("wait?step=9;timeout_secs={secs}")).await;
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{error:?}");
        assert_eq!(error.details["field"], "timeout_secs", "{error:?}");
        let range = "a number above 0, at most 30";
        assert_eq!(error.details["range"], range, "{error:?}");
        let message = "timeout_secs of a wait is not a number above 0 and at most 30: repeat";
        assert!(error.message.starts_with(message), "{error:?}");
    }
    for noun in ["wait", "wait?step=3;event=a"] {
        let error = error(noun).await;
        let message = "step or one of phase, condition and event is required, and only one of them";
        assert!(error.message.starts_with(message), "{error:?}");
    }
    daemon.stop().await;
}
