//! No request makes the daemon's memory grow for good.

use serde_json::json;
use zenoh::query::Reply;

use crate::support::bad_requests::{prepare_swarms, read_all};
use crate::support::process::Process;
use crate::support::{Client, TIMEOUT};

/// Sends a request for each number, some at a time. Returns how many were accepted.
async fn send(
    client: &Client,
    numbers: std::ops::Range<usize>,
    request: impl Fn(usize) -> (String, Option<Vec<u8>>),
) -> usize {
    const AT_A_TIME: usize = 100;
    let numbers: Vec<usize> = numbers.collect();
    let mut accepted = 0;
    for some in numbers.chunks(AT_A_TIME) {
        let mut pending = Vec::new();
        for number in some {
            let (selector, payload) = request(*number);
            let mut query = client.session.get(selector).timeout(TIMEOUT);
            if let Some(payload) = payload {
                query = query.payload(payload);
            }
            pending.push(query.await.unwrap());
        }
        for replies in pending {
            let reply: Reply = replies.recv_async().await.unwrap();
            accepted += usize::from(reply.into_result().is_ok());
        }
    }
    accepted
}

fn cmd(verb: &str, request: &serde_json::Value) -> (String, Option<Vec<u8>>) {
    let payload = request.to_string().into_bytes();
    (format!("jostle/other/cmd/{verb}"), Some(payload))
}

/// Sends `count` requests of each kind that must leave nothing behind.
async fn send_bad_requests(client: &Client, round: usize, count: usize) {
    let bad: Vec<_> = read_all();
    let numbers = round * count..(round + 1) * count;
    // The bad requests of the tables.
    send(client, numbers.clone(), |number| {
        let bad = &bad[number % bad.len()];
        let selector = bad
            .selector
            .replace("get/wait?", "get/wait?timeout_secs=0.01;");
        (selector, bad.payload.clone())
    })
    .await;

    // Rejected, each with a `request_id`, which may be used again.
    let rejected = send(client, numbers.clone(), |number| {
        let id = format!("rejected-{number}");
        cmd("step", &json!({"request_id": id, "expect_step": 1_000_000}))
    });
    assert_eq!(rejected.await, 0);

    // The same request many times, which is executed once.
    let repeated = send(client, numbers.clone(), |_| {
        let set = json!({"request_id": "once", "args": {"pi3": 1}});
        cmd("set", &set)
    });
    assert_eq!(repeated.await, count);

    // Scheduled for a step that is not reached: a thousand wait, more are rejected, a reset drops all.
    for some in numbers.clone().step_by(2000) {
        let put_off = send(client, some..some + 2000, |number| {
            let far = json!({"at_step": 1_000_000 + number, "args": {"pi3": 1}});
            cmd("set", &far)
        });
        let put_off = put_off.await;
        assert!(put_off >= 1000, "{put_off} at {some}");
        client.ok("other", "reset", json!({})).await;
    }

    // Waits with a timeout that passes at once.
    let waited = send(client, numbers, |_| {
        let wait = "jostle/other/get/wait?step=1000000000;timeout_secs=0.000001";
        (wait.to_owned(), None)
    });
    waited.await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hundred_thousand_requests_without_effect_leave_nothing_behind() {
    const COUNT: usize = 20_000;
    let (daemon, endpoint) = Process::serve();
    let client = Client::open(&endpoint).await;
    prepare_swarms(&client, &["victim", "other"]).await;
    // Fills bounded memory first: the history, and the idempotency cache.
    send_bad_requests(&client, 0, COUNT / 4).await;
    let before = daemon.resident_bytes();
    send_bad_requests(&client, 1, COUNT).await;
    let grown = daemon.resident_bytes().saturating_sub(before);
    println!(
        "{} KiB before, {} KiB more after 5 times {COUNT} requests",
        before >> 10,
        grown >> 10
    );
    // A hundred bytes for each request would be 10 MB.
    assert!(grown < 8 << 20, "{grown} bytes more");
}
