//! A controller joins once its liveliness token is declared.

use std::time::{Duration, Instant};

use jostle_proto::{Error, ErrorCode, keys};
use serde_json::{Value, json};
use zenoh::bytes::Encoding;

use super::token;
use crate::contested::fleet::Router;
use crate::support::{Client, Daemon, PREFIX, QueryResult, TIMEOUT, http, result_of, until};

/// A `join` as a client sends it that declares no token.
async fn bare_join(client: &Client, request: Value) -> QueryResult {
    let query = client.session.get(keys::cmd(PREFIX, "a", "join"));
    let query = query.payload(request.to_string()).timeout(TIMEOUT);
    let replies = query.encoding(Encoding::APPLICATION_JSON).await.unwrap();
    result_of(replies.recv_async().await.unwrap())
}

fn assert_no_token(error: &Error, controller: &str) {
    let key = keys::ctl_alive(PREFIX, "a", controller);
    assert_eq!(error.code, ErrorCode::IncorrectState, "{error:?}");
    assert!(error.message.contains(&key), "{error:?}");
    assert_eq!(error.details["token"], key);
}

async fn joins(client: &Client) -> usize {
    let journal = client.get("a", "journal").await;
    let entries = journal["result"]["entries"].as_array().unwrap();
    entries.iter().filter(|it| it["verb"] == "join").count()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_join_without_its_token_is_rejected_and_others_do_not_wait() {
    let daemon = Daemon::start().await;
    let (client, other) = (&daemon.client, &daemon.another_client().await);
    client.create("a", json!({"n": 6})).await;
    let began = Instant::now();
    let all = (0..100).map(|k| bare_join(client, json!({"controller": format!("ada-{k}")})));
    let all = futures_util::future::join_all(all);
    let (answers, longest) = tokio::join!(all, async {
        let mut longest = Duration::ZERO;
        while began.elapsed() < Duration::from_millis(1500) {
            let began = Instant::now();
            other.get("a", "status").await;
            other.ok("a", "step", json!({})).await;
            longest = longest.max(began.elapsed());
        }
        longest
    });
    let took = began.elapsed();
    assert!(took >= Duration::from_secs(2), "{took:?}");
    assert!(took < Duration::from_secs(4), "{took:?}");
    assert!(longest < Duration::from_secs(1), "{longest:?}");
    for (k, answer) in answers.into_iter().enumerate() {
        assert_no_token(&answer.unwrap_err(), &format!("ada-{k}"));
    }
    assert_eq!(client.get("a", "status").await["result"]["controllers"], 0);
    assert_eq!(joins(client).await, 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_is_lost_while_the_swarm_is_faulted_removes_its_controller_at_the_reset() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", crate::commands::faulting_spec()).await;
    // Each client holds the token of its controller.
    let ada = daemon.another_client().await;
    for (of, controller) in [(&ada, "ada"), (client, "bob")] {
        let free = json!({"controller": controller, "mode": "free_running"});
        of.ok("a", "join", free).await;
    }
    crate::commands::fault_soon(client, "a").await;
    ada.session.close().await.unwrap();
    let controllers = async || {
        let status = client.get("a", "status").await;
        status["result"]["controllers"].as_u64().unwrap()
    };
    assert_eq!(controllers().await, 2);
    client.ok("a", "reset", json!({})).await;
    until("ada is gone", async || controllers().await == 1).await;
    let left = client.ok("a", "leave", json!({"controller": "bob"})).await;
    assert_eq!(left["result"], json!({}));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_join_waits_for_its_token_and_a_duplicate_is_executed_once() {
    let daemon = Daemon::start().await;
    let (client, other) = (&daemon.client, &daemon.another_client().await);
    client.create("a", json!({"n": 6})).await;
    let request = json!({"request_id": "1", "args": {"controller": "ada", "select": {"ids": [2]}}});
    // The token of another controller is not that of this one.
    let _bob = token(other, "bob").await;
    let (first, second, token) = tokio::join!(
        bare_join(client, request.clone()),
        bare_join(other, request.clone()),
        async {
            tokio::time::sleep(Duration::from_millis(500)).await;
            assert_eq!(joins(client).await, 0);
            token(other, "ada").await
        }
    );
    let first = first.unwrap();
    assert_eq!(first["result"]["ids"], json!([2]));
    assert_eq!(second.unwrap(), first);
    assert_eq!(joins(client).await, 1);
    token.undeclare().await.unwrap();
    until("ada is lost", async || {
        client.get("a", "status").await["result"]["controllers"] == 0
    })
    .await;
    // Its reply is remembered, but it does not join again.
    assert_eq!(bare_join(client, request).await.unwrap(), first);
    assert_eq!(client.get("a", "status").await["result"]["controllers"], 0);
    // One that was rejected changed nothing, and its id may be used again.
    let request = json!({"request_id": "2", "args": {"controller": "ada"}});
    let error = bare_join(client, request.clone()).await.unwrap_err();
    assert_no_token(&error, "ada");
    let _token = super::token(client, "ada").await;
    bare_join(client, request).await.unwrap();
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_join_without_its_token_keeps_the_deadline_of_its_caller() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 6})).await;
    let began = Instant::now();
    let request = json!({"timeout_secs": 0.2, "args": {"controller": "ada"}});
    let error = bare_join(client, request).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::DeadlineExceeded, "{error:?}");
    let took = began.elapsed();
    assert!(took < Duration::from_millis(1500), "{took:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn joins_that_wait_take_no_places_of_other_requests() {
    let daemon = Daemon::start().await;
    let (client, other) = (&daemon.client, &daemon.another_client().await);
    client.create("a", json!({"n": 6})).await;
    // Their callers do not wait, so that they could be sent without end.
    let many = (0..500).map(|k| {
        let args = json!({"controller": format!("ada-{k}")});
        bare_join(client, json!({"timeout_secs": 0.1, "args": args}))
    });
    let (answers, ()) = tokio::join!(futures_util::future::join_all(many), async {
        for _ in 0..50 {
            other.ok("a", "step", json!({})).await;
        }
    });
    let is_busy = |it: &&QueryResult| it.as_ref().is_err_and(|it| it.code == ErrorCode::Busy);
    let busy = answers.iter().filter(is_busy).count();
    assert_eq!(500 - busy, 128, "as many as may wait");
    // One with its token need not wait, however many do.
    let _token = token(other, "bob").await;
    bare_join(other, json!({"controller": "bob"}))
        .await
        .unwrap();
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn over_http_the_token_is_that_of_a_session() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 6})).await;
    let (address, page) = (
        http::of_daemon(&daemon),
        daemon.data_dir().join("page-token"),
    );
    let page = std::fs::read_to_string(page).unwrap();
    let join = async || {
        let (address, page) = (address.clone(), page.clone());
        let sent = tokio::task::spawn_blocking(move || {
            let body = json!({"controller": "ada"}).to_string();
            let head = format!(
                "POST /api/cmd/a/join HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\
                 Authorization: Bearer {}\r\nContent-Length: {}\r\n\r\n",
                page.trim(),
                body.len()
            );
            http::send(&address, &(head + &body))
        });
        sent.await.unwrap()
    };
    let (status, _, body) = join().await;
    assert_eq!(status, 409, "{body}");
    assert_no_token(&serde_json::from_str(&body).unwrap(), "ada");
    let token = token(client, "ada").await;
    assert_eq!(join().await.0, 200);
    token.undeclare().await.unwrap();
    until("ada is lost", async || {
        client.get("a", "status").await["result"]["controllers"] == 0
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn behind_a_router_a_controller_joins_by_its_token() {
    let daemon = Daemon::start().await;
    daemon.client.create("a", json!({"n": 6})).await;
    let router = Router::connected_to(&[&daemon.server.endpoints[0]]);
    let client = Client::open(&router.1).await;
    until("the swarm is there", async || {
        !client
            .query_all(&keys::get(PREFIX, "a", "status"), None)
            .await
            .is_empty()
    })
    .await;
    for k in 0..20 {
        let name = format!("ada-{k}");
        client.ok("a", "join", json!({"controller": name})).await;
    }
    client.session.close().await.unwrap();
    until("all are lost", async || {
        daemon.client.get("a", "status").await["result"]["controllers"] == 0
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_that_ends_before_the_step_at_which_it_joins_is_lost_there() {
    let daemon = Daemon::start().await;
    let (client, other) = (&daemon.client, daemon.another_client().await);
    client.create("a", json!({"n": 6})).await;
    for (client, name) in [(client, "ada"), (&other, "bob")] {
        let args = json!({"controller": name, "mode": "free_running"});
        client
            .ok("a", "join", json!({"at_step": 5, "args": args}))
            .await;
    }
    other.session.close().await.unwrap();
    until("bob has no token", async || {
        let tokens = client.session.liveliness();
        let tokens = tokens
            .get(keys::ctl_alive(PREFIX, "a", "bob"))
            .await
            .unwrap();
        tokens.recv_async().await.is_err()
    })
    .await;
    client.ok("a", "step", json!({"steps": 5})).await;
    until("bob is lost", async || {
        let listed = client.get("a", "controllers").await;
        let listed = listed["result"]["controllers"].as_array().unwrap().clone();
        let names: Vec<_> = listed.iter().map(|it| it["controller"].clone()).collect();
        names == ["ada"]
    })
    .await;
    let hash = client.hash("a").await;
    let verified = client.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null);
    let daemon = daemon.restart().await;
    assert_eq!(daemon.client.hash("a").await, hash);
    assert_eq!(
        daemon.client.get("a", "status").await["result"]["controllers"],
        1
    );
    daemon.stop().await;
}
