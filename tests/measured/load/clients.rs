//! The default maximum of clients, and one more.

use serde_json::json;

use crate::load::helper;
use crate::support::excess::{HELLO, expect_hello_rejected};
use crate::support::process::Process;
use crate::support::{Client, until};

#[tokio::test(flavor = "multi_thread")]
#[ignore = "long: half a minute, with 4,001 clients"]
async fn of_four_thousand_and_one_clients_the_last_is_rejected() {
    const MAX_CLIENTS: usize = 4000;
    let (daemon, endpoint) = Process::serve();
    let first = Client::open(&endpoint).await;
    first.create("followed", json!({"n": 50, "rate": 1})).await;
    let asked = format!("{endpoint} {}", MAX_CLIENTS - 1);
    let (crowd, took, _output) =
        helper("0", "followers::a_following_process", &asked, "connected ");
    assert_eq!(
        first.node("hello").await["limits"]["max_clients"],
        MAX_CLIENTS
    );
    let last = Client::open(&endpoint).await;
    expect_hello_rejected(&last, MAX_CLIENTS).await;
    assert_eq!(first.node("status").await["clients"], MAX_CLIENTS + 1);
    first.ok("followed", "step", json!({})).await;
    println!(
        "{} more clients in {took} s; the daemon has {} MB",
        MAX_CLIENTS - 1,
        daemon.resident_bytes() / 1_000_000
    );
    drop(crowd);
    until("there is room again", async || {
        last.query(HELLO, None).await.is_ok()
    })
    .await;
}
