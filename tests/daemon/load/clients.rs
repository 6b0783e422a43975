//! More clients than `max_clients`: `hello` is rejected, and the others continue.

use serde_json::json;

use crate::support::excess::{HELLO, expect_hello_rejected};
use crate::support::{Daemon, NODE, until};

#[tokio::test(flavor = "multi_thread")]
async fn hello_is_rejected_while_the_limit_of_clients_is_exceeded() {
    assert_eq!(NODE, "test");
    let daemon = Daemon::with(&[("max_clients", "3")]).await;
    daemon.client.create("a", json!({"n": 3})).await;
    let (_second, third) = (daemon.another_client().await, daemon.another_client().await);
    assert_eq!(third.node("hello").await["limits"]["max_clients"], 3);
    let fourth = daemon.another_client().await;
    expect_hello_rejected(&fourth, 3).await;
    // `hello` of every client is rejected; other requests are executed.
    expect_hello_rejected(&third, 3).await;
    third.ok("a", "step", json!({})).await;
    assert_eq!(third.node("status").await["clients"], 4);
    fourth.session.close().await.unwrap();
    until("there is room again", async || {
        third.query(HELLO, None).await.is_ok()
    })
    .await;
    daemon.stop().await;
}
