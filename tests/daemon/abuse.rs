//! Whatever a client sends: an error that names the field, and nothing else happens.

use std::time::{Duration, Instant};

use jostle_proto::ErrorCode::{self, InvalidArgument, NotFound, ResourceExhausted};
use serde_json::json;

use crate::support::{Answer, Daemon, NODE};

/// A request, the code it gets, and what the error must name.
type Bad = (&'static str, &'static str, ErrorCode, &'static str);

const TO_A_SWARM: [Bad; 62] = [
    // No request at all.
    ("step", "[1]", InvalidArgument, "object"),
    ("step", "3", InvalidArgument, "object"),
    ("step", "null", InvalidArgument, "object"),
    ("step", "{", InvalidArgument, "object"),
    ("step", "{} {}", InvalidArgument, "object"),
    ("step", "\u{0}", InvalidArgument, "object"),
    ("step", "{\"steps\": NaN}", InvalidArgument, "object"),
    ("step", "{'steps': 1}", InvalidArgument, "object"),
    // Envelopes.
    ("step", "{\"args\": []}", InvalidArgument, "args"),
    (
        "step",
        "{\"args\": {}, \"steps\": 1}",
        InvalidArgument,
        "steps",
    ),
    ("step", "{\"client\": 7}", InvalidArgument, "client"),
    (
        "step",
        "{\"client\": \"a\\u0000b\"}",
        InvalidArgument,
        "client",
    ),
    (
        "step",
        "{\"expect_step\": -1}",
        InvalidArgument,
        "expect_step",
    ),
    (
        "step",
        "{\"expect_step\": 1.5}",
        InvalidArgument,
        "expect_step",
    ),
    ("step", "{\"expect_step\": 99}", ErrorCode::Conflict, "step"),
    (
        "step",
        "{\"expect_epoch\": 7}",
        ErrorCode::Conflict,
        "epoch",
    ),
    (
        "step",
        "{\"timeout_secs\": 0}",
        InvalidArgument,
        "timeout_secs",
    ),
    (
        "step",
        "{\"timeout_secs\": -1}",
        InvalidArgument,
        "timeout_secs",
    ),
    (
        "step",
        "{\"timeout_secs\": 1e9}",
        InvalidArgument,
        "timeout_secs",
    ),
    (
        "step",
        "{\"timeout_secs\": 1e400}",
        InvalidArgument,
        "timeout_secs",
    ),
    // Steps and runs.
    ("step", "{\"steps\": 0}", InvalidArgument, "steps"),
    ("step", "{\"steps\": -1}", InvalidArgument, "steps"),
    ("step", "{\"steps\": 1.5}", InvalidArgument, "steps"),
    ("step", "{\"steps\": \"1\"}", InvalidArgument, "steps"),
    ("step", "{\"steps\": 1000000001}", InvalidArgument, "steps"),
    (
        "step",
        "{\"steps\": 99999999999999999999}",
        InvalidArgument,
        "steps",
    ),
    (
        "step",
        "{\"steps\": 1, \"steps\": 2}",
        InvalidArgument,
        "steps",
    ),
    (
        "step",
        "{\"return\": \"everything\"}",
        InvalidArgument,
        "return",
    ),
    ("step", "{\"stepps\": 1}", InvalidArgument, "stepps"),
    ("run", "{\"rate\": 0}", InvalidArgument, "rate"),
    ("run", "{\"rate\": -1}", InvalidArgument, "rate"),
    ("run", "{\"rate\": 1e7}", InvalidArgument, "rate"),
    ("run", "{\"rate\": \"fast\"}", InvalidArgument, "rate"),
    ("run", "{\"until_time\": -1}", InvalidArgument, "until_time"),
    (
        "run",
        "{\"until_time\": 1e300}",
        InvalidArgument,
        "until_time",
    ),
    (
        "run",
        "{\"until_step\": 18446744073709551615}",
        InvalidArgument,
        "until_step",
    ),
    (
        "run",
        "{\"until_step\": 1, \"until_time\": 1}",
        InvalidArgument,
        "until_",
    ),
    ("pause", "{\"now\": true}", InvalidArgument, "now"),
    ("reset", "{\"seed\": -1}", InvalidArgument, "seed"),
    (
        "reset",
        "{\"seed\": 9007199254740992}",
        InvalidArgument,
        "seed",
    ),
    // Parameters.
    ("set", "{}", InvalidArgument, "nothing to set"),
    ("set", "{\"pi1\": 0.5}", InvalidArgument, "pi1"),
    ("set", "{\"pi1\": 33}", InvalidArgument, "pi1"),
    ("set", "{\"pi3\": 0}", InvalidArgument, "pi3"),
    ("set", "{\"pi3\": 1e5}", InvalidArgument, "dt"),
    ("set", "{\"pi4\": -1e-300}", InvalidArgument, "pi4"),
    ("set", "{\"pi2\": \"0.5\"}", InvalidArgument, "pi2"),
    ("set", "{\"dt\": 0.01}", InvalidArgument, "dt"),
    (
        "set",
        "{\"publish_every\": 0}",
        InvalidArgument,
        "publish_every",
    ),
    (
        "set",
        "{\"pi3\": 1, \"make_room\": true}",
        InvalidArgument,
        "make_room",
    ),
    // The group.
    ("inform", "{\"direction\": 0}", InvalidArgument, "select"),
    (
        "inform",
        "{\"select\": {\"ids\": [99]}, \"direction\": 0}",
        InvalidArgument,
        "ids",
    ),
    (
        "inform",
        "{\"select\": {\"ids\": [1, 1]}, \"direction\": 0}",
        InvalidArgument,
        "ids",
    ),
    (
        "inform",
        "{\"select\": {\"count\": 1000000000}, \"direction\": 0}",
        InvalidArgument,
        "count",
    ),
    (
        "inform",
        "{\"select\": {\"fraction\": 1.5}, \"direction\": 0}",
        InvalidArgument,
        "fraction",
    ),
    (
        "inform",
        "{\"select\": {\"count\": 1}, \"direction\": 1e9}",
        InvalidArgument,
        "direction",
    ),
    (
        "inform",
        "{\"select\": {\"count\": 1}, \"direction\": 0, \"weight\": 0}",
        InvalidArgument,
        "weight",
    ),
    (
        "inform",
        "{\"select\": {\"count\": 1}, \"direction\": 0, \"weight\": 1e5}",
        InvalidArgument,
        "dt",
    ),
    ("inject", "{}", InvalidArgument, "count"),
    (
        "inject",
        "{\"count\": 1000000000}",
        ResourceExhausted,
        "max_individuals",
    ),
    (
        "inject",
        "{\"at\": [{\"x\": 1e9, \"y\": 0, \"alpha\": 0}]}",
        InvalidArgument,
        "x",
    ),
    (
        "remove",
        "{\"select\": {\"fraction\": 1}}",
        InvalidArgument,
        "leave one",
    ),
];

const TO_THE_NODE: [Bad; 26] = [
    (
        "create",
        "{\"name\": \"new\", \"spec\": [5]}",
        InvalidArgument,
        "spec",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 5, \"start\": [\"disc\"]}}",
        InvalidArgument,
        "start",
    ),
    ("create", "{}", InvalidArgument, "name"),
    ("create", "{\"name\": \"new\"}", InvalidArgument, "spec"),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {}}",
        InvalidArgument,
        "n",
    ),
    (
        "create",
        "{\"name\": \"*\", \"spec\": {\"n\": 1}}",
        InvalidArgument,
        "name",
    ),
    (
        "create",
        "{\"name\": \"@node\", \"spec\": {\"n\": 1}}",
        InvalidArgument,
        "name",
    ),
    (
        "create",
        "{\"name\": \"A\", \"spec\": {\"n\": 1}}",
        InvalidArgument,
        "name",
    ),
    (
        "create",
        "{\"name\": \"a/b\", \"spec\": {\"n\": 1}}",
        InvalidArgument,
        "name",
    ),
    (
        "create",
        "{\"name\": \"\\u202e\", \"spec\": {\"n\": 1}}",
        InvalidArgument,
        "name",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 0}}",
        InvalidArgument,
        "n =",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 1000000000}}",
        InvalidArgument,
        "n =",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": -5}}",
        InvalidArgument,
        "n:",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 2000, \"start\": {\"kind\": \"disc\", \"radius\": 1}}}",
        ResourceExhausted,
        "radius",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 5, \"start\": {\"kind\": \"disc\", \"radius\": -1}}}",
        InvalidArgument,
        "radius",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 5, \"start\": {\"kind\": \"square\"}}}",
        InvalidArgument,
        "square",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 2, \"start\": {\"kind\": \"given\", \"x\": [0], \"y\": [0, 1], \"alpha\": [0, 0]}}}",
        InvalidArgument,
        "start.x",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 2, \"start\": {\"kind\": \"given\", \"x\": [0, 0], \"y\": [0, 0], \"alpha\": [0, 1]}}}",
        InvalidArgument,
        "cross",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 1, \"start\": {\"kind\": \"given\", \"x\": [null], \"y\": [0], \"alpha\": [0]}}}",
        InvalidArgument,
        "start",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 5, \"dt\": 0.5}}",
        InvalidArgument,
        "dt",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 5, \"dt\": 0}}",
        InvalidArgument,
        "dt",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 5, \"noise\": 0.1}}",
        InvalidArgument,
        "noise",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 5, \"contacts\": \"closest\"}}",
        InvalidArgument,
        "contacts",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 5, \"attraction\": {\"kind\": \"none\"}}}",
        InvalidArgument,
        "attraction",
    ),
    (
        "create",
        "{\"name\": \"new\", \"spec\": {\"n\": 5, \"seed\": 1e30}}",
        InvalidArgument,
        "seed",
    ),
    ("destroy", "{}", NotFound, "create"),
];

fn check(told: &str, answer: Answer, code: ErrorCode, named: &str) {
    match answer {
        Ok(reply) => panic!("{told}: was accepted: {reply}"),
        Err(error) => {
            assert_eq!(error.code, code, "{told}: {error:?}");
            assert!(
                error.message.contains(named),
                "{told}: {:?} does not name {named}",
                error.message
            );
            assert!(error.message.len() < 1000, "{told}: {}", error.message);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_requests_are_refused_by_name_and_change_nothing() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let spec = json!({"n": 10, "seed": 4});
    client.create("victim", spec.clone()).await;
    client.create("twin", spec).await;
    for name in ["victim", "twin"] {
        client.ok(name, "step", json!({"steps": 20})).await;
    }
    let twin = client.hash("twin").await;
    for (verb, request, code, named) in TO_A_SWARM {
        let began = Instant::now();
        let answer = client
            .one(
                &format!("jostle/victim/cmd/{verb}"),
                Some(request.as_bytes()),
            )
            .await;
        check(&format!("{verb} {request}"), answer, code, named);
        assert!(began.elapsed() < Duration::from_secs(2), "{verb} {request}");
        assert_eq!(client.hash("victim").await, twin, "{verb} {request}");
    }
    for (verb, request, code, named) in TO_THE_NODE {
        let key = format!("jostle/@node/{NODE}/cmd/{verb}");
        let answer = client.one(&key, Some(request.as_bytes())).await;
        check(&format!("{verb} {request}"), answer, code, named);
    }

    // Made up where it is too long to write down.
    let long = format!("{{\"client\": \"{}\"}}", "x".repeat(5000));
    let deep = format!(
        "{{\"args\": {}1{}}}",
        "[".repeat(200_000),
        "]".repeat(200_000)
    );
    let many = format!(
        "{{\"select\": {{\"ids\": [{}0]}}, \"direction\": 0}}",
        "0,".repeat(200_000)
    );
    let binary = [0xff, 0xfe, 0x00];
    let bodies: [(&str, &[u8]); 4] = [
        ("step", long.as_bytes()),
        ("step", deep.as_bytes()),
        ("inform", many.as_bytes()),
        ("step", &binary),
    ];
    for (verb, body) in bodies {
        let answer = client
            .one(&format!("jostle/victim/cmd/{verb}"), Some(body))
            .await;
        check(verb, answer, InvalidArgument, "");
    }
    // What is larger than a message may be vanishes on the way, and the link stays.
    let huge = vec![b' '; 2 << 20];
    let key = "jostle/victim/cmd/step";
    let query = client.session.get(key).payload(huge);
    let replies = query.timeout(Duration::from_millis(300)).await.unwrap();
    while let Ok(reply) = replies.recv_async().await {
        assert!(reply.into_result().is_err());
    }

    let summary = client.node("swarms").await;
    assert_eq!(
        summary["swarms"].as_array().unwrap().len(),
        2,
        "nothing was created"
    );
    for name in ["victim", "twin"] {
        client.ok(name, "step", json!({"steps": 20})).await;
    }
    assert_eq!(client.hash("victim").await, client.hash("twin").await);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn wrong_keys_parameters_and_encodings_are_refused() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    for (selector, code, named) in [
        ("jostle/a/cmd/jump", NotFound, "inform"),
        ("jostle/a/cmd/step/twice", NotFound, "step"),
        ("jostle/a/cmd", NotFound, "inform"),
        ("jostle/a/get/everything", NotFound, "status"),
        ("jostle/@node/test/get/everything", NotFound, "hello"),
        ("jostle/a/state?format=xml", InvalidArgument, "format"),
        ("jostle/a/state?formt=json", InvalidArgument, "formt"),
        ("jostle/a/get/status?verbose=1", InvalidArgument, "verbose"),
        ("jostle/a/cmd/step?steps=3", InvalidArgument, "steps"),
    ] {
        check(selector, client.one(selector, None).await, code, named);
    }
    let replies = client
        .session
        .get("jostle/a/cmd/step")
        .payload([0xa0].as_slice())
        .encoding(zenoh::bytes::Encoding::APPLICATION_CBOR)
        .await
        .unwrap();
    let error = replies
        .recv_async()
        .await
        .unwrap()
        .into_result()
        .unwrap_err();
    let error: jostle_proto::Error = serde_json::from_slice(&error.payload().to_bytes()).unwrap();
    check("cbor", Err(error), InvalidArgument, "application/json");
    assert_eq!(client.get("a", "status").await["step"], 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wildcard_reads_everything_and_executes_nothing() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for name in ["a", "b", "c"] {
        client.create(name, json!({"n": 3})).await;
    }
    let hash = client.hash("a").await;
    for selector in [
        "jostle/**",
        "**",
        "jostle/*/cmd/*",
        "jostle/*/cmd/delete",
        "jostle/a/cmd/*",
        "jostle/a/cmd/**",
        "jostle/a/cmd/del$*",
        "jostle/a$*/cmd/step",
        "jostle/@node/*/cmd/create",
    ] {
        for answer in client.ask(selector, Some(b"{}")).await {
            if let Err(error) = answer {
                check(selector, Err(error), InvalidArgument, "wildcard");
            }
        }
        let swarms = client.node("swarms").await;
        assert_eq!(swarms["swarms"].as_array().unwrap().len(), 3, "{selector}");
        assert_eq!(client.get("a", "status").await["step"], 0, "{selector}");
        assert_eq!(client.get("a", "status").await["seq"], 0, "{selector}");
    }
    assert_eq!(client.hash("a").await, hash);
    let statuses = client.ask("jostle/*/get/status", None).await;
    assert_eq!(statuses.len(), 3);
    assert!(statuses.iter().all(Result::is_ok));
    assert_eq!(
        client.ask("jostle/a/get/*", None).await.len(),
        2,
        "status and spec"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn memory_is_admitted_before_it_is_taken() {
    let daemon = Daemon::with(&[
        ("max_swarms", "4"),
        ("max_memory_mb", "4"),
        ("max_individuals", "1000000"),
    ])
    .await;
    let client = &daemon.client;
    let key = format!("jostle/@node/{NODE}/cmd/create");
    let create = async |name: &str, n: u64| {
        let request = json!({"name": name, "spec": {"n": n}}).to_string();
        client.one(&key, Some(request.as_bytes())).await
    };
    check(
        "n = 1e6",
        create("big", 1_000_000).await,
        ResourceExhausted,
        "max_memory_mb",
    );
    check(
        "n = 1e9",
        create("big", 1_000_000_000).await,
        InvalidArgument,
        "n =",
    );
    for name in ["a", "b", "c", "d"] {
        create(name, 10).await.unwrap();
    }
    check(
        "five",
        create("e", 10).await,
        ResourceExhausted,
        "max_swarms",
    );
    client.ok("d", "delete", json!({})).await;
    create("e", 10).await.unwrap();
    client.ok("e", "delete", json!({})).await;
    // What was taken out may be taken by others, and is then not there for a reset.
    client.ok("c", "delete", json!({})).await;
    create("c", 200).await.unwrap();
    client
        .ok("c", "remove", json!({"select": {"count": 199}}))
        .await;
    client.ok("b", "delete", json!({})).await;
    create("b", 200).await.unwrap();
    let answer = client.cmd("c", "reset", json!({})).await;
    check("reset", answer, ResourceExhausted, "max_memory_mb");
    client.ok("b", "delete", json!({})).await;
    client.ok("c", "reset", json!({})).await;
    // Growing is admitted like creating.
    let answer = client.cmd("a", "inject", json!({"count": 5000})).await;
    check("inject", answer, ResourceExhausted, "max_memory_mb");
    daemon.stop().await;
}
