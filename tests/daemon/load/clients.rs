//! More clients than there may be: one more is told, and nobody else is worse off.

use jostle_proto::ErrorCode;
use serde_json::json;

use crate::apart::Process;
use crate::load::helper;
use crate::support::{Client, Daemon, NODE, alone, until};

const HELLO: &str = "jostle/@node/test/get/hello";

/// What one more than `limit` is told.
async fn is_refused(client: &Client, limit: usize) {
    let error = client.one(HELLO, None).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
    assert_eq!(error.details["limit"], limit, "{error:?}");
    let remedy =
        format!("the daemon's {limit} clients are connected: close one, or raise max_clients");
    assert!(error.message.contains(&remedy), "{error:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn hello_is_refused_while_more_clients_are_connected_than_there_may_be() {
    assert_eq!(NODE, "test");
    let daemon = Daemon::with(&[("max_clients", "3")]).await;
    daemon.client.create("a", json!({"n": 3})).await;
    let (_second, third) = (daemon.another_client().await, daemon.another_client().await);
    assert_eq!(third.node("hello").await["limits"]["max_clients"], 3);
    let fourth = daemon.another_client().await;
    is_refused(&fourth, 3).await;
    // Whoever asks is told so; what there is goes on.
    is_refused(&third, 3).await;
    third.ok("a", "step", json!({})).await;
    assert_eq!(third.node("status").await["clients"], 4);
    fourth.session.close().await.unwrap();
    until("there is room again", async || {
        third.one(HELLO, None).await.is_ok()
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "long: half a minute, with 4,001 clients"]
async fn of_four_thousand_and_one_clients_the_last_is_told() {
    const MOST: usize = 4000;
    let _alone = alone().await;
    let (daemon, endpoint) = Process::serve();
    let first = Client::open(&endpoint).await;
    first.create("followed", json!({"n": 50, "rate": 1})).await;
    let asked = format!("{endpoint} {}", MOST - 1);
    let (crowd, took, _output) =
        helper("0", "followers::a_following_process", &asked, "connected ");
    assert_eq!(first.node("hello").await["limits"]["max_clients"], MOST);
    let last = Client::open(&endpoint).await;
    is_refused(&last, MOST).await;
    assert_eq!(first.node("status").await["clients"], MOST + 1);
    first.ok("followed", "step", json!({})).await;
    println!(
        "{} more clients in {took} s; the daemon has {} MB",
        MOST - 1,
        daemon.resident_bytes() / 1_000_000
    );
    drop(crowd);
    until("there is room again", async || {
        last.one(HELLO, None).await.is_ok()
    })
    .await;
}
