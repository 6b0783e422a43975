#![expect(clippy::unwrap_used, reason = "tests")]

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

/// A client that does not wait for a daemon.
async fn connected(endpoint: String) -> Client {
    let client = Client::connect(ConnectOptions {
        wait: Duration::ZERO,
        ..ConnectOptions::to(endpoint)
    });
    client.await.unwrap()
}

/// What a daemon replies while it recovers.
const RECOVERING: &str =
    r#"{"code": "busy", "message": "recovering", "details": {"reason": "recovering"}}"#;

#[tokio::test(flavor = "multi_thread")]
async fn without_time_to_ask_again_only_a_connection_that_holds_tells_what_is_missing() {
    let (session, endpoint) = listening().await;
    let client = connected(endpoint).await;
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
    let client = connected(endpoint).await;
    // It is recovering when it is asked for the first time, and not any more when that is answered.
    let hello = keys::node_get(&client.0.prefix, "lab", "hello");
    let queries = session.declare_queryable(hello).await.unwrap();
    let token = keys::node_alive(&client.0.prefix, "lab");
    let recover = async {
        let query = queries.recv_async().await.unwrap();
        let token = session.liveliness().declare_token(token).await.unwrap();
        query.reply_err(RECOVERING).await.unwrap();
        drop(query);
        token
    };
    let explain = client.explain_silence(Target::Swarm("demo"), "jostle/demo/get/status");
    let (token, error) = tokio::join!(recover, explain);
    assert!(matches!(error, Error::NoSwarm { .. }), "{error}");
    token.undeclare().await.unwrap();
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
