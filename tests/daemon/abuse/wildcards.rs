//! Wildcard keys, other encodings and payloads on gets: wildcards execute nothing.

use jostle_proto::ErrorCode::InvalidArgument;
use jostle_proto::keys;
use serde_json::{Value, json};
use zenoh::bytes::Encoding;

use crate::support::{Daemon, PREFIX};

#[tokio::test(flavor = "multi_thread")]
async fn other_encodings_than_json_are_rejected() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    for encoding in [
        Encoding::APPLICATION_CBOR,
        Encoding::APPLICATION_XML,
        Encoding::APPLICATION_PROTOBUF,
        Encoding::IMAGE_PNG,
        Encoding::TEXT_HTML,
        Encoding::ZENOH_SERIALIZED,
        Encoding::APPLICATION_JSON.with_schema("charset=utf-16"),
        Encoding::from("of my own"),
        Encoding::from("x".repeat(200)),
    ] {
        let context = encoding.to_string();
        let query = client.session.get("jostle/a/cmd/step").payload("{}");
        let replies = query.encoding(encoding).await.unwrap();
        let reply = replies.recv_async().await.unwrap().into_result();
        let bytes = reply.unwrap_err().payload().to_bytes().into_owned();
        let error: jostle_proto::Error = serde_json::from_slice(&bytes).unwrap();
        assert_eq!(error.code, InvalidArgument, "{context}");
        assert!(error.message.contains("application/json"), "{context}");
        assert!(error.message.len() < 1000, "{context}");
    }
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
        "*/**",
        "**/cmd/**",
        "**/delete",
        "jostle/*/cmd/*",
        "jostle/*/cmd/**",
        "jostle/*/cmd/delete",
        "jostle/**/delete",
        "jostle/a/**",
        "jostle/a/*/delete",
        "jostle/a/cmd/*",
        "jostle/a/cmd/**",
        "jostle/a/cmd/**/delete",
        "jostle/a/cmd/del$*",
        "jostle/a/cmd/$*te",
        "jostle/a$*/cmd/step",
        "*/a/cmd/delete",
        "jostle/@node/*/cmd/create",
        "jostle/@node/*/cmd/*",
        "jostle/@node/test/cmd/*",
        "jostle/@node/test/cmd/c$*",
        "jostle/@node/**",
    ] {
        for answer in client.query_all(selector, Some(b"{}")).await {
            if let Err(error) = answer {
                // A wildcard that also matches gets: they reject the payload.
                let field = error.details.get("field").and_then(Value::as_str);
                let named = error.message.contains("wildcard") || field == Some("payload");
                assert_eq!(error.code, InvalidArgument, "{selector}: {error:?}");
                assert!(named, "{selector}: {error:?}");
            }
        }
        let swarms = client.node("swarms").await;
        assert_eq!(swarms["swarms"].as_array().unwrap().len(), 3, "{selector}");
        for name in ["a", "b", "c"] {
            let status = client.get(name, "status").await;
            assert_eq!(status["step"], 0, "{selector}");
            assert_eq!(status["seq"], 0, "{selector}");
            assert_eq!(status["result"]["scheduled"], 0, "{selector}");
        }
    }
    assert_eq!(client.hash("a").await, hash);
    let statuses = client.query_all("jostle/*/get/status", None).await;
    assert_eq!(statuses.len(), 3);
    assert!(statuses.iter().all(Result::is_ok));
    let nouns = keys::SWARM_GETS.len() - 4;
    assert_eq!(
        client.query_all("jostle/a/get/*", None).await.len(),
        nouns,
        "all but wait, which needs a condition, and those that are expensive"
    );
    for noun in ["wait", "snapshot", "verify", "experiment"] {
        let answers = client
            .query_all(&format!("jostle/*/get/{noun}"), None)
            .await;
        assert!(!answers.is_empty(), "{noun}: silence");
        for answer in answers {
            let error = answer.unwrap_err();
            assert!(error.message.contains("of one swarm"), "{noun}: {error:?}");
        }
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_payload_on_a_get_is_rejected() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    let before = client.get("a", "status").await;
    let huge = vec![b'['; 900_000];
    let payloads: [&[u8]; 4] = [b"{\"steps\": 3}", b"{", &[0xff], &huge];
    for payload in payloads {
        for noun in ["status", "spec", "parameters", "events", "journal"] {
            let key = keys::get(PREFIX, "a", noun);
            let error = client.query(&key, Some(payload)).await.unwrap_err();
            assert_eq!(error.code, InvalidArgument, "{noun}: {error:?}");
            assert_eq!(error.details["field"], "payload", "{noun}: {error:?}");
        }
        assert_eq!(client.get("a", "status").await, before);
    }
    daemon.stop().await;
}
