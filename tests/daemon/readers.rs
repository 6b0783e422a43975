//! A client that sends as many `wait` and `verify` as it can does not keep other clients out.

use jostle_proto::ErrorCode;
use serde_json::json;
use tokio::net::TcpStream;
use zenoh::handlers::FifoChannelHandler;
use zenoh::query::Reply;

use crate::support::{Client, Daemon, QueryResult, TIMEOUT, result_of};

type Pending = FifoChannelHandler<Reply>;

/// Sends a query and does not wait for its answer.
async fn send(client: &Client, selector: &str) -> Pending {
    let query = client.session.get(selector).timeout(3 * TIMEOUT);
    query.await.unwrap()
}

/// The reply to a query that was sent; `None` without one.
async fn answer(pending: &Pending) -> Option<QueryResult> {
    let reply = tokio::time::timeout(3 * TIMEOUT, pending.recv_async()).await;
    Some(result_of(reply.ok()?.unwrap()))
}

#[tokio::test(flavor = "multi_thread")]
async fn of_too_many_waits_the_longest_gives_way_to_the_newest() {
    const IN_PLACE: usize = 1100;
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    client.ok("a", "step", json!({"steps": 20})).await;
    let mut in_place = Vec::new();
    for sent in 0..IN_PLACE {
        if sent % 100 == 0 {
            // A query sent after the others arrives after them: no queue on the way is full.
            client.get("a", "status").await;
        }
        in_place.push(send(client, "jostle/a/get/wait?phase=running").await);
    }
    client.get("a", "status").await;

    let other = daemon.another_client().await;
    let waited = other
        .query("jostle/a/get/wait?step=20", None)
        .await
        .unwrap();
    assert_eq!(waited["step"], 20);
    let verified = other.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], json!(null), "{verified}");
    assert!(verified["result"]["hashes"].as_u64().unwrap() > 0);
    let waiting = send(&other, "jostle/a/get/wait?phase=running").await;
    other.get("a", "status").await;

    // 1,024 may wait. The 77 that have waited longest get a reply while the swarm is paused.
    let served = in_place.split_off(IN_PLACE + 1 - 1024);
    for displaced in &in_place {
        let error = answer(displaced).await.unwrap().unwrap_err();
        assert_eq!(error.code, ErrorCode::DeadlineExceeded, "{error:?}");
        assert_eq!(error.details["limit"], 1024, "{error:?}");
        assert!(error.details["after_secs"].as_f64().unwrap() > 0.0);
        assert_eq!(error.step, Some(20));
    }
    assert!(waiting.is_empty(), "nothing has come about");
    other.ok("a", "run", json!({})).await;
    assert_eq!(answer(&waiting).await.unwrap().unwrap()["phase"], "running");
    assert_eq!(served.len(), 1023);
    for pending in &served {
        assert_eq!(answer(pending).await.unwrap().unwrap()["phase"], "running");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_verify_beyond_four_at_once_is_queued() {
    const IN_PLACE: usize = 12;
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for name in ["a", "b"] {
        client.create(name, json!({"n": 50, "rate": null})).await;
    }
    // Long enough that none of them is done when the last one is sent.
    let long = json!({"timeout_secs": 60, "args": {"steps": 20_000}});
    client.ok("a", "step", long).await;
    client.ok("b", "step", json!({"steps": 20})).await;
    let mut in_place = Vec::new();
    for _ in 0..IN_PLACE {
        in_place.push(send(client, "jostle/a/get/verify").await);
    }
    client.get("a", "status").await;

    let other = daemon.another_client().await;
    let verifying = send(&other, "jostle/b/get/verify").await;
    let status = other.get("b", "status").await;
    assert_eq!(status["result"]["verifying"], 0.0, "it is queued");
    let under_way = in_place.iter().filter(|it| it.is_empty()).count();
    assert!(under_way > 4, "nothing was measured: {under_way} under way");
    let verified = answer(&verifying).await.unwrap().unwrap();
    assert_eq!(verified["result"]["to_step"], 20);
    assert_eq!(verified["result"]["differs_at"], json!(null));
    for pending in &in_place {
        let verified = answer(pending).await.unwrap().unwrap();
        assert_eq!(verified["result"]["to_step"], 20_000);
        assert_eq!(verified["result"]["differs_at"], json!(null));
    }
    daemon.stop().await;
}

/// Of the 1,000 connections that may have sent nothing yet; zenoh's default is 100.
#[tokio::test(flavor = "multi_thread")]
async fn silent_connections_keep_no_client_out() {
    let daemon = Daemon::start().await;
    let endpoint = &daemon.server.endpoints[0];
    let address = endpoint.strip_prefix("tcp/").unwrap();
    let mut silent = Vec::new();
    for _ in 0..900 {
        silent.push(TcpStream::connect(address).await.unwrap());
    }
    let client = Client::open(endpoint).await;
    assert!(client.node("hello").await["version"].is_string());
    client.session.close().await.unwrap();
    drop(silent);
    daemon.stop().await;
}
