//! Controllers in lock-step and in free-running mode.

mod driving;
mod idle;
mod late;
mod order;
mod restarted;
mod suspended;
mod tokens;

use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};
use tokio::time::sleep;
use zenoh::liveliness::LivelinessToken;

use crate::support::{Client, Daemon, PREFIX, QueryResult, until};

/// A swarm and its controllers.
async fn join(client: &Client, controller: &str, ids: &[u32], more: Value) -> Value {
    let mut args = json!({"controller": controller, "select": {"ids": ids}});
    for (field, value) in more.as_object().into_iter().flatten() {
        args[field] = value.clone();
    }
    client.ok("a", "join", args).await
}

async fn advance(client: &Client, controller: &str, step: u64, more: Value) -> QueryResult {
    let mut args = json!({"controller": controller});
    for (field, value) in more.as_object().into_iter().flatten() {
        args[field] = value.clone();
    }
    let request = json!({"expect_step": step, "timeout_secs": 20, "args": args});
    client.cmd("a", "advance", request).await
}

async fn steps_on(client: &Client, controller: &str, step: u64) -> Value {
    advance(client, controller, step, json!({})).await.unwrap()
}

async fn token(client: &Client, controller: &str) -> LivelinessToken {
    let key = keys::ctl_alive(PREFIX, "a", controller);
    client
        .session
        .liveliness()
        .declare_token(key)
        .await
        .unwrap()
}

async fn weights(client: &Client) -> Vec<f64> {
    let key = format!("{}?format=json", keys::state(PREFIX, "a"));
    let state = client.query(&key, None).await.unwrap();
    serde_json::from_value(state["weight"].clone()).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_steps_when_all_have_advanced_and_replies_to_each() {
    let daemon = Daemon::start().await;
    let (ada, bob) = (&daemon.client, &daemon.another_client().await);
    ada.create("a", json!({"n": 12})).await;
    let joined = join(ada, "ada", &[0, 1], json!({})).await;
    assert_eq!(joined["result"]["ids"], json!([0, 1]));
    let drawn = json!({"controller": "bob", "select": {"count": 3}});
    let drawn = bob.ok("a", "join", drawn).await["result"]["ids"].clone();
    let drawn: Vec<u32> = serde_json::from_value(drawn).unwrap();
    assert!(
        drawn.iter().all(|id| *id > 1),
        "{drawn:?}: two never own one"
    );
    for (args, code) in [
        (json!({"controller": "ada"}), ErrorCode::AlreadyExists),
        (
            json!({"controller": "eve", "select": {"ids": [1]}}),
            ErrorCode::Conflict,
        ),
        (
            json!({"controller": "eve", "select": {"count": 8}}),
            ErrorCode::InvalidArgument,
        ),
    ] {
        assert_eq!(ada.err("a", "join", args).await.0, code);
    }

    // A controller that has advanced waits; a query does not wait, and delays no controller.
    let set = json!({"set": {"ids": [0], "direction": [1.0], "weight": [2.0]}});
    let (first, ()) = tokio::join!(advance(ada, "ada", 0, set), async {
        until("bob is awaited", async || {
            let status = bob.get("a", "status").await;
            let secs = status["result"]["waiting_for"][0]["secs"].as_f64();
            secs.is_some_and(|secs| secs >= 0.1)
        })
        .await;
        let status = bob.get("a", "status").await;
        let waiting = &status["result"]["waiting_for"];
        assert_eq!(
            (&status["step"], &status["phase"]),
            (&json!(0), &json!("paused"))
        );
        assert_eq!(waiting[0]["controller"], "bob");
        assert_eq!(
            weights(bob).await[0],
            2.0,
            "set-points are there before the step"
        );
        let bob = advance(bob, "bob", 0, json!({"return": "state"}))
            .await
            .unwrap();
        assert_eq!(bob["result"]["state"]["step"], 1);
    });
    let first = first.unwrap();
    assert_eq!(
        (&first["step"], &first["result"]["steps"]),
        (&json!(1), &json!(1))
    );
    assert_eq!(
        ada.get("a", "status").await["result"]["waiting_for"],
        json!([])
    );

    // An `expect_step` that differs from the swarm's step is an error with that step.
    let error = advance(ada, "ada", 0, json!({})).await.unwrap_err();
    assert_eq!((error.code, error.step), (ErrorCode::Conflict, Some(1)));
    let set = json!({"set": {"ids": [drawn[0]], "direction": [1.0]}});
    let error = advance(ada, "ada", 1, set).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::InvalidArgument);
    assert!(error.message.contains("bob"), "{}", error.message);

    // Ten steps in one advance are ten exchanges of the other controller.
    let (ten, ()) = tokio::join!(advance(ada, "ada", 1, json!({"steps": 10})), async {
        for step in 1..11 {
            assert_eq!(steps_on(bob, "bob", step).await["step"], step + 1);
        }
    });
    assert_eq!(ten.unwrap()["result"]["steps"], 10);

    for verb in ["run", "step"] {
        assert_eq!(
            ada.err("a", verb, json!({})).await.0,
            ErrorCode::IncorrectState
        );
    }
    // A controller that leaves frees its individuals, and the others advance without it.
    let (last, _) = tokio::join!(advance(ada, "ada", 11, json!({})), async {
        until("ada waits", async || {
            bob.get("a", "status").await["result"]["waiting_for"][0]["controller"] == "bob"
        })
        .await;
        bob.ok("a", "leave", json!({"controller": "bob"})).await
    });
    let last = last.unwrap();
    assert_eq!(last["step"], 12);
    assert_eq!(
        last["result"]["news"]["left"],
        json!([{"controller": "bob", "why": "left"}])
    );
    let error = advance(bob, "bob", 11, json!({})).await.unwrap_err();
    assert_eq!(
        error.code,
        ErrorCode::NotFound,
        "though it is elsewhere too"
    );
    assert!(
        error.message.contains("left at step 11"),
        "{}",
        error.message
    );
    ada.ok("a", "leave", json!({"controller": "ada"})).await;
    ada.ok("a", "step", json!({"steps": 3})).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_fires_and_after_three_the_others_are_alone() {
    for (on_timeout, weight_while, weight_after) in
        [("hold", 2.0, 2.0), ("free", 0.0, 0.0), ("pause", 2.0, 0.0)]
    {
        let daemon = Daemon::start().await;
        let (ada, bob) = (&daemon.client, &daemon.another_client().await);
        ada.create("a", json!({"n": 12})).await;
        join(ada, "ada", &[0], json!({"deadline_secs": 30})).await;
        let late = json!({"deadline_secs": 0.5, "on_timeout": on_timeout});
        join(bob, "bob", &[1], late).await;
        let set = json!({"set": {"ids": [1], "direction": [1.0], "weight": [2.0]}});
        let (one, other) = tokio::join!(
            advance(ada, "ada", 0, json!({})),
            advance(bob, "bob", 0, set)
        );
        assert_eq!(
            (one.unwrap()["step"].clone(), other.unwrap()["step"].clone()),
            (json!(1), json!(1))
        );
        // No controller waits, so none is late.
        sleep(Duration::from_millis(700)).await;
        let mut step = 1;
        for misses in 1..=3 {
            let began = Instant::now();
            let reply = steps_on(ada, "ada", step).await;
            let took = began.elapsed();
            let is_paused = on_timeout == "pause";
            assert_eq!(reply["result"]["steps"], u64::from(!is_paused), "{reply}");
            step = reply["step"].as_u64().unwrap();
            assert!(took >= Duration::from_millis(500), "{took:?}");
            let missed = &reply["result"]["news"]["missed"];
            assert_eq!(missed[0]["controller"], "bob", "{reply}");
            assert_eq!(missed[0]["misses"], misses);
            if misses < 3 {
                assert_eq!(weights(ada).await[1], weight_while, "{on_timeout}");
            } else {
                let left = json!([{"controller": "bob", "why": "late"}]);
                assert_eq!(reply["result"]["news"]["left"], left);
            }
        }
        assert_eq!(weights(ada).await[1], weight_after, "{on_timeout}");
        let error = advance(bob, "bob", step, json!({})).await.unwrap_err();
        assert!(
            error.message.contains("missed 3 deadlines"),
            "{}",
            error.message
        );
        let journal = ada.get("a", "journal").await;
        let entries = journal["result"]["entries"].as_array().unwrap();
        let deadlines = entries.iter().filter(|it| it["verb"] == "deadline").count();
        assert_eq!(deadlines, 3, "each is an input");

        // The same journal, the same hash: a replay needs no clock.
        let hash = ada.hash("a").await;
        let verified = ada.get("a", "verify").await;
        assert_eq!(verified["result"]["differs_at"], Value::Null);
        let daemon = daemon.restart().await;
        assert_eq!(daemon.client.hash("a").await, hash, "{on_timeout}");
        let status = daemon.client.get("a", "status").await;
        assert_eq!(
            (&status["step"], &status["result"]["controllers"]),
            (&json!(step), &json!(1))
        );
        assert_eq!(
            steps_on(&daemon.client, "ada", step).await["step"],
            step + 1
        );
        daemon.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_advance_resets_the_count_of_misses() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 6})).await;
    join(client, "ada", &[0], json!({})).await;
    join(client, "bob", &[1], json!({"deadline_secs": 0.4})).await;
    let mut step = 0;
    for _ in 0..3 {
        for _ in 0..2 {
            step = steps_on(client, "ada", step).await["step"]
                .as_u64()
                .unwrap();
        }
        let (_, bob) = tokio::join!(
            advance(client, "ada", step, json!({})),
            advance(client, "bob", step, json!({}))
        );
        step = bob.unwrap()["step"].as_u64().unwrap();
    }
    assert_eq!(client.get("a", "status").await["result"]["controllers"], 2);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_whose_token_disappears_is_removed_at_once() {
    let daemon = Daemon::start().await;
    let (ada, bob) = (&daemon.client, daemon.another_client().await);
    ada.create("a", json!({"n": 6})).await;
    join(ada, "ada", &[0], json!({"deadline_secs": 60})).await;
    let _token = token(&bob, "bob").await;
    join(
        &bob,
        "bob",
        &[1],
        json!({"deadline_secs": 60, "on_timeout": "free"}),
    )
    .await;
    let began = Instant::now();
    let (reply, ()) = tokio::join!(advance(ada, "ada", 0, json!({})), async {
        sleep(Duration::from_millis(100)).await;
        bob.session.close().await.unwrap();
    });
    let took = began.elapsed();
    let reply = reply.unwrap();
    assert_eq!(reply["step"], 1);
    assert!(
        took < Duration::from_secs(10),
        "{took:?}, with deadlines of a minute"
    );
    let left = json!([{"controller": "bob", "why": "lost"}]);
    assert_eq!(reply["result"]["news"]["left"], left);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_that_rejoins_stays_when_its_old_token_disappears() {
    let daemon = Daemon::start().await;
    let (client, old) = (&daemon.client, daemon.another_client().await);
    client.create("a", json!({"n": 6})).await;
    let _old_token = token(&old, "ada").await;
    join(&old, "ada", &[0, 1], json!({})).await;
    let _token = token(client, "ada").await;
    let again = json!({"controller": "ada", "again": true});
    let joined = client.ok("a", "join", again).await;
    assert_eq!(joined["result"]["ids"], json!([0, 1]));
    old.session.close().await.unwrap();
    sleep(Duration::from_millis(300)).await;
    assert_eq!(steps_on(client, "ada", 0).await["step"], 1);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_waiting_controller_gets_a_reply_when_a_command_intervenes() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 6})).await;
    join(client, "ada", &[0, 5], json!({})).await;
    join(client, "bob", &[1], json!({})).await;
    let meanwhile = async |verb: &str, args: Value| {
        let step = client.get("a", "status").await["step"].as_u64().unwrap();
        let (reply, _) = tokio::join!(advance(client, "ada", step, json!({"steps": 3})), async {
            until("ada waits", async || {
                client.get("a", "status").await["result"]["waiting_for"][0]["controller"] == "bob"
            })
            .await;
            client.ok("a", verb, args).await
        });
        reply
    };
    let reply = meanwhile("pause", json!({})).await.unwrap();
    assert_eq!(
        (&reply["result"]["steps"], &reply["phase"]),
        (&json!(0), &json!("paused"))
    );
    let reply = meanwhile("reset", json!({})).await.unwrap();
    assert_eq!(reply["result"]["steps"], 0);
    assert_eq!(
        client.get("a", "status").await["result"]["controllers"],
        2,
        "they stay"
    );
    // The news of a controller list its individuals that were removed.
    client
        .ok("a", "remove", json!({"select": {"ids": [5]}}))
        .await;
    let (ada, _) = tokio::join!(
        advance(client, "ada", 0, json!({})),
        advance(client, "bob", 0, json!({}))
    );
    assert_eq!(ada.unwrap()["result"]["news"]["removed"], json!([5]));
    let set = json!({"set": {"ids": [5], "direction": [0.0]}});
    let error = advance(client, "ada", 1, set).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::InvalidArgument);
    // A second request of the same controller replaces its first.
    let (first, second) = tokio::join!(advance(client, "ada", 1, json!({})), async {
        until("ada waits", async || {
            client.get("a", "status").await["result"]["waiting_for"][0]["controller"] == "bob"
        })
        .await;
        tokio::join!(
            advance(client, "ada", 1, json!({})),
            advance(client, "bob", 1, json!({}))
        )
    });
    assert_eq!(first.unwrap_err().code, ErrorCode::Conflict);
    assert_eq!(second.0.unwrap()["step"], 2);
    // A deletion ends every wait.
    let reply = meanwhile("delete", json!({})).await;
    assert_eq!(reply.unwrap()["result"]["steps"], 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn join_stops_a_running_swarm_and_set_points_survive_a_restart() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 20, "rate": 5})).await;
    client.ok("a", "run", json!({})).await;
    join(client, "ada", &[3], json!({"on_timeout": "free"})).await;
    let status = client.get("a", "status").await;
    assert_eq!(
        (&status["phase"], &status["result"]["reason"]),
        (&json!("paused"), &json!("lockstep"))
    );
    let mut step = status["step"].as_u64().unwrap();
    for k in 0..50 {
        let set = json!({"set": {"ids": [3], "direction": [0.1 * f64::from(k)]}});
        step = advance(client, "ada", step, set).await.unwrap()["step"]
            .as_u64()
            .unwrap();
    }
    let named = json!({"request_id": "last", "expect_step": step,
        "args": {"controller": "ada", "steps": 5}});
    let last = client.ok("a", "advance", named.clone()).await;
    let hash = client.hash("a").await;
    assert_eq!(last["result"]["state_hash"], hash);
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    assert_eq!(client.hash("a").await, hash);
    let again = client.ok("a", "advance", named).await;
    assert_eq!(again, last, "once, also after a restart");
    let controllers = client.get("a", "controllers").await;
    let ada = &controllers["result"]["controllers"][0];
    assert_eq!(
        (&ada["controller"], &ada["ids"]),
        (&json!("ada"), &json!([3]))
    );
    assert_eq!(steps_on(client, "ada", step + 5).await["step"], step + 6);
    // A fork has no controllers.
    client.ok("a", "fork", json!({"name": "b"})).await;
    assert_eq!(client.get("b", "status").await["result"]["controllers"], 0);
    client.ok("b", "step", json!({})).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_restart_a_controller_that_leaves_frees_those_it_steered_and_no_others() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 6})).await;
    join(client, "ada", &[0, 1, 2, 3], json!({"on_timeout": "free"})).await;
    let set = json!({"set": {"ids": [0], "direction": [0.1], "weight": [1.0]}});
    advance(client, "ada", 0, set).await.unwrap();
    let inform = json!({"select": {"ids": [3]}, "direction": 0.5, "weight": 2.0});
    client.ok("a", "inform", inform).await;
    assert_eq!(weights(client).await, [1.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    let step = client.get("a", "status").await["step"].clone();
    client.ok("a", "leave", json!({"controller": "ada"})).await;
    assert_eq!(weights(client).await, [0.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    assert_eq!(client.get("a", "status").await["step"], step);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn set_points_reach_a_swarm_that_runs_and_lapse_with_their_lease() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 20, "rate": 2})).await;
    client.ok("a", "run", json!({})).await;
    let free = json!({"mode": "free_running", "deadline_secs": 2.0, "on_timeout": "free"});
    join(client, "ada", &[3, 4], free).await;
    assert_eq!(client.get("a", "status").await["phase"], "running");
    let error = advance(client, "ada", 0, json!({})).await.unwrap_err();
    assert!([ErrorCode::IncorrectState, ErrorCode::Conflict].contains(&error.code));
    let put = async |key: &str, control: Value| {
        client
            .session
            .put(key, control.to_string())
            .encoding("application/json")
            .await
            .unwrap();
    };
    let key = keys::ctl(PREFIX, "a", "ada");
    let puts =
        async || client.get("a", "controllers").await["result"]["controllers"][0]["puts"].clone();
    let set = |sequence: u64, id: u32, weight: f64| json!({"sequence": sequence, "set": {"ids": [id], "direction": [1.0], "weight": [weight]}});
    put(&key, set(1, 3, 2.0)).await;
    until("it is applied", async || weights(client).await[3] == 2.0).await;
    // Stale, for another epoch, of another's individuals, unreadable, out of range, without a controller.
    put(&key, set(1, 3, 9.0)).await;
    let mut other = set(2, 3, 9.0);
    other["epoch"] = json!(7);
    put(&key, other).await;
    until("both are stale", async || puts().await["stale"] == 2).await;
    put(&key, set(3, 5, 9.0)).await;
    until("it is rejected", async || puts().await["refused"] == 1).await;
    put(&key, json!({"sequence": 4})).await;
    put(&key, set(5, 3, -1.0)).await;
    until("they are rejected", async || puts().await["refused"] == 3).await;
    put("jostle/*/ctl/*", set(100, 3, 9.0)).await;
    put("jostle/**", set(100, 3, 9.0)).await;
    let cbor = jostle_proto::to_cbor(&set(6, 4, 3.0));
    let sent = client.session.put(&key, cbor).encoding("application/cbor");
    sent.await.unwrap();
    until("CBOR is read", async || weights(client).await[4] == 3.0).await;
    assert!(weights(client).await.iter().all(|weight| *weight < 9.0));
    // Without further puts its individuals are uninformed again, and an event reports it.
    until("the lease ends", async || {
        weights(client).await.iter().all(|it| *it == 0.0)
    })
    .await;
    let journal = client.get("a", "journal").await;
    let entries = journal["result"]["entries"].as_array().unwrap();
    assert!(entries.iter().any(|it| it["verb"] == "control"));
    assert!(entries.iter().any(|it| it["verb"] == "deadline"));
    client.ok("a", "pause", json!({})).await;
    let verified = client.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null);
    let hash = client.hash("a").await;
    let daemon = daemon.restart().await;
    assert_eq!(daemon.client.hash("a").await, hash);
    daemon.stop().await;
}
