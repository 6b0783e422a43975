#![expect(clippy::unwrap_used, reason = "tests")]

use serde_json::json;

use super::*;
use crate::connect::ConnectOptions;

/// A zenoh node that listens, without a daemon.
async fn listening() -> (zenoh::Session, String) {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"router\""),
        ("listen/endpoints", "[\"tcp/127.0.0.1:0\"]"),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
    ] {
        config.insert_json5(key, value).unwrap();
    }
    let session = zenoh::open(config).await.unwrap();
    let endpoint = session.info().locators().await[0].to_string();
    (session, endpoint)
}

#[tokio::test(flavor = "multi_thread")]
async fn without_time_to_ask_again_only_a_connection_that_holds_tells_what_is_missing() {
    let (session, endpoint) = listening().await;
    let client = Client::connect(ConnectOptions {
        wait: Duration::ZERO,
        ..ConnectOptions::to(endpoint)
    });
    let client = client.await.unwrap();
    let silent = || Error::Silent {
        target: "demo".into(),
    };
    let error = client.explain_unsettled(silent()).await;
    assert!(matches!(error, Error::Silent { .. }), "{error}");
    session.close().await.unwrap();
    while client.is_connected().await {
        tokio::time::sleep(POLL_INTERVAL).await;
    }
    let error = client.explain_unsettled(silent()).await;
    assert!(matches!(error, Error::NoDaemon { .. }), "{error}");
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_recovers_while_the_cause_is_looked_for_is_there() {
    let (session, endpoint) = listening().await;
    let client = Client::connect(ConnectOptions {
        wait: Duration::ZERO,
        ..ConnectOptions::to(endpoint)
    });
    let client = client.await.unwrap();
    // It is recovering when it is asked for the first time, and not any more when that is answered.
    let hello = keys::node_get(&client.0.prefix, "lab", "hello");
    let queries = session.declare_queryable(hello).await.unwrap();
    let recovering =
        json!({"code": "busy", "message": "recovering", "details": {"reason": "recovering"}});
    let token = keys::node_alive(&client.0.prefix, "lab");
    let recover = async {
        let query = queries.recv_async().await.unwrap();
        let token = session.liveliness().declare_token(token).await.unwrap();
        query.reply_err(recovering.to_string()).await.unwrap();
        drop(query);
        token
    };
    let explain = client.explain_silence(Target::Swarm("demo"), "jostle/demo/get/status");
    let (token, error) = tokio::join!(recover, explain);
    assert!(matches!(error, Error::NoSwarm { .. }), "{error}");
    token.undeclare().await.unwrap();
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_cause_is_found_although_a_daemon_comes_and_goes() {
    let (session, endpoint) = listening().await;
    let client = Client::connect(ConnectOptions {
        wait: Duration::ZERO,
        ..ConnectOptions::to(endpoint)
    });
    let client = client.await.unwrap();
    let hello = keys::node_get(&client.0.prefix, "lab", "hello");
    let queries = session.declare_queryable(hello).await.unwrap();
    let recovering =
        json!({"code": "busy", "message": "recovering", "details": {"reason": "recovering"}});
    let token = keys::node_alive(&client.0.prefix, "lab");
    // Its token is there only from the end of a query for `hello` on until it is seen.
    let come_and_go = async {
        loop {
            let query = queries.recv_async().await.unwrap();
            let token = session.liveliness().declare_token(&token).await.unwrap();
            query.reply_err(recovering.to_string()).await.unwrap();
            drop(query);
            while client.nodes().await.unwrap().is_empty() {}
            tokio::time::sleep(Duration::from_millis(20)).await;
            token.undeclare().await.unwrap();
        }
    };
    let explain = client.explain_silence(Target::Swarm("demo"), "jostle/demo/get/status");
    let explain = tokio::time::timeout(Duration::from_secs(20), explain);
    let error = tokio::select! {
        error = explain => error.unwrap(),
        () = come_and_go => unreachable!(),
    };
    assert!(
        matches!(error, Error::NoNode { .. } | Error::NoSwarm { .. }),
        "{error}"
    );
    client.close().await;
}

#[test]
fn keys_of_tokens_contain_the_node() {
    let node = |key: &str| node_of("a/jostle", key);
    assert_eq!(node("a/jostle/demo/alive/here").as_deref(), Some("here"));
    assert_eq!(node("a/jostle/@node/here/alive").as_deref(), Some("here"));
    assert_eq!(node("a/jostle/demo/state"), None);
    assert_eq!(node("b/jostle/demo/alive/here"), None);
}
