//! Conditions that only cause an event, and states from which and up to which one is evaluated.

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use super::{create_informed, fired, spec, verifies, waiting};
use crate::support::daemon_process::{killed, start};
use crate::support::{Client, Daemon, PREFIX};

fn event(condition: &str, name: &str) -> Value {
    json!({"condition": condition, "event": name, "from_step": 0})
}

#[tokio::test(flavor = "multi_thread")]
async fn an_event_is_waited_for_across_a_kill_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let step = 300;
    // It holds 50 steps before that, and began to hold at step 0.
    let lasting = format!("order >= 0 for {}", (step - 50) as f64 * 0.02);
    let draw = json!({"select": {"count": 3}, "direction": -1.0});
    for name in ["a", "twin"] {
        create_informed(&daemon.1, name).await;
        if name == "a" {
            let reply = daemon.1.ok(name, "when", event(&lasting, "mine")).await;
            assert_eq!(reply["result"]["holds"], Value::Null);
            // Of the same name it replaces the first one, of another name it does not.
            daemon.1.ok(name, "when", event("order > 1", "mine")).await;
            daemon.1.ok(name, "when", event(&lasting, "mine")).await;
            daemon.1.ok(name, "when", event(&lasting, "theirs")).await;
            assert_eq!(waiting(&daemon.1, name).await, json!([lasting, lasting]));
        }
        daemon.1.ok(name, "inform", draw.clone()).await;
        let before = json!({"timeout_secs": 60, "args": {"steps": step - 100}});
        daemon.1.ok(name, "step", before).await;
    }
    // The draws of the twin are the same, and so is the step.
    assert_eq!(daemon.1.hash("a").await, daemon.1.hash("twin").await);
    daemon = killed(folder.path(), daemon).await;
    let cancel = json!({"event": "theirs", "cancel": true});
    daemon.1.ok("a", "when", cancel.clone()).await;
    daemon.1.ok("a", "when", cancel).await;
    let path = |event: &str| keys::get(PREFIX, "a", &format!("wait?event={event};timeout_secs=10"));
    let gone = daemon.1.query(&path("theirs"), None).await.unwrap_err();
    assert_eq!(gone.code, ErrorCode::NotFound, "{gone:?}");
    let another = Client::open(&daemon.0.endpoint).await;
    let mine = path("mine");
    let held = another.query(&mine, None);
    let (held, _) = tokio::join!(
        held,
        daemon
            .1
            .ok("a", "run", json!({"until_step": 2000, "rate": 50}))
    );
    assert!(held.unwrap()["step"].as_u64().unwrap() >= 1);
    let [(at, args)] = &fired(&daemon.1, "a").await[..] else {
        panic!("not once")
    };
    assert_eq!(args["event"], "mine");
    daemon.1.ok("a", "pause", json!({})).await;
    // Once it has held, the reply is immediate, also after a restart.
    daemon = killed(folder.path(), daemon).await;
    daemon.1.query(&path("mine"), None).await.unwrap();
    verifies(&daemon.1, "a").await;
    // A kill may undo the last steps of the twin.
    let mut steps = [0; 2];
    for (k, name) in ["a", "twin"].into_iter().enumerate() {
        daemon.1.ok(name, "pause", json!({})).await;
        steps[k] = daemon.1.get(name, "status").await["step"].as_u64().unwrap();
    }
    let rest = json!({"timeout_secs": 60, "args": {"steps": steps[0] - steps[1]}});
    daemon.1.ok("twin", "step", rest).await;
    assert_eq!(daemon.1.hash("a").await, daemon.1.hash("twin").await);
    assert_eq!(*at, step - 50);
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_condition_that_holds_already_does_not_wait() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec()).await;
    let reply = client.ok("a", "when", event("order >= 0", "now")).await;
    assert_eq!(reply["result"], json!({"holds": true}));
    let at_once = json!({"condition": "order >= 0", "pause": true, "from_step": 0});
    let (code, message) = client.err("a", "when", at_once).await;
    assert_eq!(code, ErrorCode::Conflict, "{message}");
    assert!(message.contains("next step"), "{message}");
    for args in [
        event("order > 0", ""),
        event("order > 0", &"x".repeat(65)),
        event("order > 0", "a;b"),
        event("order > 0", "a=b"),
        event("order > 0", "A"),
        json!({"condition": "order > 0", "event": "a", "pause": true}),
        json!({"condition": "order > 0", "event": "a", "protocol": true}),
        json!({"condition": "order > 0", "pause": true, "draw": 3}),
        json!({"condition": "order > 0", "pause": true, "from_step": 5, "before_step": 5}),
        json!({"condition": "order > 0", "pause": true, "from_step": 1.5}),
        json!({"condition": "order > 0", "event": "a", "cancel": true}),
        json!({"event": "a"}),
    ] {
        let (code, message) = client.err("a", "when", args.clone()).await;
        assert_eq!(code, ErrorCode::InvalidArgument, "{args}: {message}");
    }
    assert_eq!(waiting(client, "a").await, Value::Null);
    // From a step on, and up to one.
    client
        .ok(
            "a",
            "when",
            json!({"condition": "order >= 0", "pause": true, "from_step": 7}),
        )
        .await;
    client
        .ok(
            "a",
            "when",
            json!({"condition": "order >= 0", "pause": true, "from_step": 9, "before_step": 10}),
        )
        .await;
    client
        .ok(
            "a",
            "when",
            json!({"condition": "order > 1", "pause": true, "before_step": 4}),
        )
        .await;
    let reply = client.ok("a", "step", json!({"steps": 20})).await;
    assert_eq!(reply["result"]["steps"], 7, "{reply}");
    assert_eq!(waiting(client, "a").await, json!(["order >= 0"]));
    let reply = client.ok("a", "step", json!({"steps": 20})).await;
    assert_eq!(reply["result"]["steps"], 2, "{reply}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_condition_that_holds_already_replaces_the_one_with_its_event() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec()).await;
    client.ok("a", "when", event("order > 1", "mine")).await;
    let reply = client.ok("a", "when", event("order >= 0", "mine")).await;
    assert_eq!(reply["result"], json!({"holds": true}));
    assert_eq!(waiting(client, "a").await, Value::Null);
    // One that is rejected replaces none.
    let at_step = |step: u64| json!({"condition": "order >= 0", "pause": true, "from_step": step});
    client.ok("a", "when", at_step(3)).await;
    client.ok("a", "step", json!({"steps": 2})).await;
    client.err("a", "when", at_step(1)).await;
    assert_eq!(waiting(client, "a").await, json!(["order >= 0"]));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_last_condition_with_an_event_is_waited_for() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", spec()).await;
    let path = keys::get(PREFIX, "a", "wait?event=mine;timeout_secs=1");
    let code = async || {
        let reply = client.query(&path, None).await;
        reply.map_or_else(|error| Some(error.code), |_| None)
    };
    let next = json!({"condition": "order >= 0", "event": "mine"});
    let never = json!({"condition": "order > 1", "event": "mine"});
    for (verb, args) in [
        ("when", json!({"cancel": true, "event": "mine"})),
        ("when", json!({"cancel": true})),
        ("reset", json!({})),
    ] {
        client.ok("a", "when", next.clone()).await;
        client.ok("a", "step", json!({"steps": 2})).await;
        assert_eq!(code().await, None, "{verb}");
        client
            .ok("a", "when", json!({"cancel": true, "event": "other"}))
            .await;
        assert_eq!(code().await, None, "{verb}");
        let pause = json!({"condition": "order > 1", "pause": true});
        client.ok("a", "when", pause).await;
        let id = client.get("a", "status").await["result"]["conditions"][0]["id"].take();
        client
            .ok("a", "when", json!({"cancel": true, "id": id}))
            .await;
        assert_eq!(code().await, None, "{verb}");
        client.ok("a", "when", never.clone()).await;
        assert_eq!(code().await, Some(ErrorCode::DeadlineExceeded), "{verb}");
        client.ok("a", verb, args.clone()).await;
        assert_eq!(code().await, Some(ErrorCode::NotFound), "{verb} {args}");
        // The same without a second condition.
        client.ok("a", "when", next.clone()).await;
        client.ok("a", "step", json!({"steps": 2})).await;
        client.ok("a", verb, args.clone()).await;
        assert_eq!(code().await, Some(ErrorCode::NotFound), "{verb} {args}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_reply_has_the_id_by_which_the_condition_is_removed() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create_informed(client, "a").await;
    let changes = json!([{"verb": "set", "args": {"pi3": 2.0}}]);
    for args in [
        json!({"condition": "order > 1", "pause": true}),
        json!({"condition": "order > 1", "commands": changes}),
        json!({"condition": "order > 1", "event": "mine"}),
    ] {
        let request = json!({"client": "ada", "request_id": args.to_string(), "args": args});
        let reply = client.cmd("a", "when", request.clone()).await.unwrap();
        let id = &reply["result"]["id"];
        let status = client.get("a", "status").await;
        assert_eq!(status["result"]["conditions"][0]["id"], *id, "{status}");
        assert_eq!(client.cmd("a", "when", request).await.unwrap(), reply);
        let cancelled = client
            .ok("a", "when", json!({"cancel": true, "id": id}))
            .await;
        assert_eq!(cancelled["result"], json!({}));
        assert_eq!(waiting(client, "a").await, Value::Null);
    }
    let holds = json!({"condition": "order >= 0", "event": "mine", "from_step": 0});
    let reply = client.ok("a", "when", holds).await;
    assert_eq!(reply["result"], json!({"holds": true}));
    daemon.stop().await;
}
