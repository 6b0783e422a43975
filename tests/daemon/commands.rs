//! Every verb and every get, in every phase.

use std::sync::atomic::{AtomicBool, Ordering};

use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, Simulation, Spec};
use jostle_proto::{ErrorCode, contract};
use serde_json::{Map, Value, json};

use crate::support::{Client, Daemon, NODE, PREFIX, read, until};

/// A swarm that faults within a few steps: bodies that turn at a touch, in the longest step that
/// is allowed, are turned so far that two of them cross.
pub async fn fault(client: &Client, name: &str) {
    client.create(name, faulting_spec()).await;
    fault_soon(client, name).await;
}

/// The spec of a swarm that faults.
pub fn faulting_spec() -> Value {
    json!({"n": 60, "pi4": 1e6, "dt": 0.2497, "seed": 2})
}

/// Steps a swarm of [`faulting_spec`] until it faults.
pub async fn fault_soon(client: &Client, name: &str) {
    let error = client.cmd(
        name,
        "step",
        json!({"timeout_secs": 30, "args": {"steps": 20_000}}),
    );
    let _ = error.await;
    until("a fault", async || {
        client.get(name, "status").await["phase"] == "faulted"
    })
    .await;
}

/// Creates a swarm in each phase, with the phase as its name.
pub async fn create_in_every_phase(client: &Client) {
    client.create("paused", json!({"n": 5})).await;
    client.create("running", json!({"n": 5, "rate": 50})).await;
    client.ok("running", "run", json!({})).await;
    fault(client, "faulted").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_created_swarm_is_paused_and_has_every_default() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let reply = client.create("a", json!({"n": 10})).await;
    assert_eq!(
        (&reply["swarm"], &reply["phase"]),
        (&json!("a"), &json!("paused"))
    );
    assert_eq!(
        (&reply["step"], &reply["epoch"], &reply["seq"]),
        (&json!(0), &json!(1), &json!(0))
    );
    assert_eq!(reply["result"]["created"], true);
    let spec = client.get("a", "spec").await;
    assert_eq!(spec["result"], reply["result"]["spec"]);
    // Those of the documentation: `proto/contract/tests/contract/docs.rs` compares them.
    let parameters = contract::parameters().into_iter();
    let defaults = parameters.map(|it| (it.name, it.default));
    let mut expected: Map<String, Value> = defaults.filter(|(_, it)| !it.is_null()).collect();
    expected.extend([
        ("n".into(), json!(10)),
        ("start".into(), json!({"kind": "disc"})),
    ]);
    assert!(expected.len() >= 15, "{expected:?}");
    assert_eq!(spec["result"], Value::Object(expected));
    let status = client.get("a", "status").await;
    assert_eq!(status["result"]["reason"], "created");
    assert_eq!(
        status["result"]["state_hash"],
        reply["result"]["state_hash"]
    );
    assert_eq!(client.node("swarms").await["swarms"][0]["swarm"], "a");
    assert_eq!(client.node("status").await["clients"], 1);
    assert_eq!(client.node("hello").await["wire_version"], 1);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn create_accepts_an_equal_swarm_only_with_exist_ok() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let key = format!("jostle/@node/{NODE}/cmd/create");
    let create = async |request: Value| {
        client
            .query(&key, Some(request.to_string().as_bytes()))
            .await
    };
    let spec = json!({"n": 3, "seed": 5});
    client.create("a", spec.clone()).await;
    let again = create(json!({"name": "a", "spec": spec, "exist_ok": true}))
        .await
        .unwrap();
    assert_eq!(again["result"]["created"], false);
    for request in [
        json!({"name": "a", "spec": spec}),
        json!({"name": "a", "spec": {"n": 4}, "exist_ok": true}),
    ] {
        let error = create(request).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::AlreadyExists);
    }
    daemon.stop().await;
}

/// The table of phases, cell by cell, through a real session.
#[tokio::test(flavor = "multi_thread")]
async fn every_verb_in_every_phase_has_the_effect_in_the_table() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    create_in_every_phase(client).await;

    let one = json!({"select": {"count": 1}});
    let changes = [
        ("set", json!({"pi3": 1.1})),
        ("inform", json!({"select": {"count": 1}, "direction": 1})),
        ("uninform", json!({"select": {"fraction": 0.5}})),
        ("inject", json!({"count": 1})),
        ("remove", one),
    ];
    for (verb, args) in &changes {
        let seq = client.get("paused", "status").await["seq"]
            .as_u64()
            .unwrap();
        let reply = client.ok("paused", verb, args.clone()).await;
        assert_eq!(
            (&reply["step"], &reply["phase"]),
            (&json!(0), &json!("paused")),
            "{verb}"
        );
        assert_eq!(reply["seq"], seq + 1, "{verb}");
        assert_eq!(
            client.ok("running", verb, args.clone()).await["phase"],
            "running",
            "{verb}"
        );
        let (code, message) = client.err("faulted", verb, args.clone()).await;
        assert_eq!(code, ErrorCode::IncorrectState, "{verb}");
        assert!(message.contains("reset"), "{message}");
    }
    for verb in ["run", "pause", "step"] {
        let (code, _) = client.err("faulted", verb, json!({})).await;
        assert_eq!(code, ErrorCode::IncorrectState, "{verb}");
    }
    let (code, message) = client.err("running", "step", json!({})).await;
    assert_eq!(code, ErrorCode::IncorrectState);
    assert!(message.contains("pause"), "{message}");

    assert_eq!(
        client.ok("paused", "pause", json!({})).await["phase"],
        "paused"
    );
    assert_eq!(
        client.ok("paused", "step", json!({"steps": 7})).await["step"],
        7
    );
    assert_eq!(
        client.get("paused", "status").await["result"]["reason"],
        "finished"
    );
    assert_eq!(
        client.ok("paused", "run", json!({})).await["phase"],
        "running"
    );
    assert_eq!(
        client.ok("running", "run", json!({"rate": 1})).await["result"]["rate"],
        1.0
    );
    assert_eq!(
        client.ok("running", "pause", json!({})).await["phase"],
        "paused"
    );
    assert_eq!(
        client.get("running", "status").await["result"]["reason"],
        "requested"
    );

    for name in ["paused", "running", "faulted"] {
        let reply = client.ok(name, "reset", json!({})).await;
        assert_eq!(
            (&reply["step"], &reply["epoch"]),
            (&json!(0), &json!(2)),
            "{name}"
        );
        assert_eq!(
            client.get(name, "status").await["result"]["reason"],
            "reset"
        );
    }
    fault(client, "faulted-again").await;
    for name in ["paused", "running", "faulted", "faulted-again"] {
        client.ok(name, "delete", json!({})).await;
        let error = client
            .query(&format!("jostle/{name}/get/status"), None)
            .await;
        assert_eq!(error.unwrap_err().code, ErrorCode::NotFound);
    }
    // A wildcard query gets no reply for a swarm that was deleted.
    for selector in ["jostle/*/get/status", "jostle/*/state", "jostle/**"] {
        let answers = client.query_all(selector, None).await;
        let of_swarms = answers.iter().filter(|it| match it {
            Ok(reply) => reply.get("node").is_none(),
            Err(error) => error.code == ErrorCode::NotFound,
        });
        assert_eq!(of_swarms.count(), 0, "{selector}: {answers:?}");
    }
    until("silence", async || {
        let key = "jostle/paused/get/status";
        client.query_all(key, None).await.is_empty()
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wildcard_query_gets_no_reply_for_a_swarm_deleted_meanwhile() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("stays", json!({"n": 3})).await;
    let come_and_go = async |name: &str| {
        for _ in 0..150 {
            client.create(name, json!({"n": 3})).await;
            client.ok(name, "delete", json!({})).await;
        }
    };
    let is_done = AtomicBool::new(false);
    let many = async {
        tokio::join!(come_and_go("a"), come_and_go("b"), come_and_go("c"));
        is_done.store(true, Ordering::Relaxed);
    };
    let ask = async |selector: &str| {
        let mut of_others = 0;
        while !is_done.load(Ordering::Relaxed) {
            let answers = client.query_all(selector, None).await;
            let replies: Vec<_> = answers.iter().map(|it| it.as_ref().unwrap()).collect();
            let stays = replies.iter().filter(|it| it["swarm"] == "stays");
            assert_eq!(stays.count(), 1, "{answers:?}");
            of_others += replies.len() - 1;
        }
        assert!(of_others > 0, "{selector}: nothing came and went meanwhile");
    };
    tokio::join!(many, ask("jostle/*/get/status"), ask("jostle/*/state"));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fault_keeps_the_last_good_state_and_reports_the_reason() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    fault(client, "a").await;
    let status = client.get("a", "status").await;
    let reason = status["result"]["reason"].as_str().unwrap();
    let fault = status["result"]["fault"].clone();
    let ids = fault["ids"].as_array().unwrap();
    let named = format!("individuals {} and {} cross", ids[0], ids[1]);
    assert!(reason.contains(&named), "{reason} {fault}");
    assert_eq!((&fault["kind"], ids.len()), (&json!("crossed_bodies"), 2));
    let gap = fault["gap"].as_f64().unwrap();
    let worst = status["result"]["certificate"]["worst_gap"].as_f64();
    assert!(worst.unwrap() <= gap + 1e-9 && gap < 0.5, "{gap} {worst:?}");
    // Also after a restart, and until a reset.
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    assert_eq!(client.get("a", "status").await["result"]["fault"], fault);
    client.ok("a", "reset", json!({})).await;
    let after = client.get("a", "status").await["result"].clone();
    assert!(after.get("fault").is_none(), "{after}");
    assert_eq!(
        status["result"]["certificate"]["crossed"], 0,
        "the state shown is a good one"
    );
    assert!(status["step"].as_u64().unwrap() > 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_pauses_at_its_end_and_resumes_from_there() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 5, "rate": null})).await;
    let reply = client.ok("a", "run", json!({"until_time": 1.0})).await;
    assert_eq!(reply["result"]["until_step"], 50);
    let there = client.wait_for_step("a", 50).await;
    assert_eq!(
        (&there["step"], &there["phase"]),
        (&json!(50), &json!("paused"))
    );
    assert_eq!(there["result"]["reason"], "finished");
    assert_eq!(client.hash_at("a", 80).await, client.hash("a").await);
    assert_eq!(client.ok("a", "step", json!({})).await["step"], 81);
    let (code, _) = client.err("a", "run", json!({"until_step": 80})).await;
    assert_eq!(code, ErrorCode::Conflict);
    let reply = client.ok("a", "run", json!({"until_step": 81})).await;
    assert_eq!(reply["phase"], "paused", "there already");
    client
        .ok("a", "run", json!({"until_step": 1_000_000, "rate": 1}))
        .await;
    let reply = client.ok("a", "run", json!({"rate": 2})).await;
    assert_eq!(
        reply["result"],
        json!({"until_step": 1_000_000, "rate": 2.0})
    );
    client.ok("a", "pause", json!({})).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn step_returns_the_state_if_requested() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 4})).await;
    let reply = client
        .ok("a", "step", json!({"steps": 3, "return": "state"}))
        .await;
    assert_eq!(reply["result"]["steps"], 3);
    let state = &reply["result"]["state"];
    assert_eq!(
        (&state["step"], state["x"].as_array().unwrap().len()),
        (&json!(3), 4)
    );
    assert_eq!(
        reply["result"]["state_hash"],
        client.hash("a").await.as_str()
    );
    assert!(state["certificate"]["residual"].as_f64().unwrap() <= 1e-9);
    for selector in ["jostle/a/state", "jostle/a/state?format=json"] {
        let mut seen = client.query(selector, None).await.unwrap();
        seen["frame"] = state["frame"].clone();
        assert_eq!(&seen, state, "{selector}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_given_start_is_read_back_to_the_bit() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let (x, alpha) = (
        [0.1 + 0.2, -511.999_999_999_999_9],
        [1e-300, -270.024_192_916_423_03],
    );
    let start = json!({"kind": "given", "x": x, "y": [0.0, 1.0 / 3.0], "alpha": alpha});
    client.create("a", json!({"n": 2, "start": start})).await;
    let state = client.query("jostle/a/state", None).await.unwrap();
    assert_eq!((&state["x"], &state["alpha"]), (&json!(x), &json!(alpha)));
    assert_eq!(state["y"][1], 1.0 / 3.0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_whose_expectation_fails_is_rejected() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    client
        .ok("a", "step", json!({"expect_step": 0, "args": {"steps": 2}}))
        .await;
    let (code, message) = client.err("a", "step", json!({"expect_step": 0})).await;
    assert_eq!(code, ErrorCode::Conflict);
    assert!(message.contains("step 2"), "{message}");
    client.ok("a", "reset", json!({"expect_epoch": 1})).await;
    let (code, _) = client.err("a", "step", json!({"expect_epoch": 1})).await;
    assert_eq!(code, ErrorCode::Conflict);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_that_times_out_gets_a_reply_and_continues() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 30})).await;
    let request = json!({"timeout_secs": 0.2, "args": {"steps": 1_000_000_000}});
    let error = client.cmd("a", "step", request).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::DeadlineExceeded);
    let step = error.step.unwrap();
    let status = client.get("a", "status").await;
    assert_eq!(status["phase"], "running");
    assert!(status["step"].as_u64().unwrap() >= step);
    client.ok("a", "pause", json!({})).await;

    // A pause meanwhile ends the `step`, whose reply has the steps taken.
    let other = daemon.another_client().await;
    let request = json!({"timeout_secs": 60, "args": {"steps": 1_000_000_000}});
    let stepping = tokio::spawn(async move { other.ok("a", "step", request).await });
    until("steps", async || {
        client.get("a", "status").await["phase"] == "running"
    })
    .await;
    let paused = client.ok("a", "pause", json!({})).await;
    let stepped = stepping.await.unwrap();
    assert_eq!(stepped["step"], paused["step"]);
    assert_eq!(stepped["phase"], "paused");
    assert!(stepped["result"]["steps"].as_u64().unwrap() < 1_000_000_000);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn wait_replies_when_its_condition_is_met_or_cannot_be() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3, "rate": 10})).await;
    let wait = async |what: &str| {
        client
            .query(&format!("jostle/a/get/wait?{what}"), None)
            .await
    };
    assert_eq!(
        wait("step=5").await.unwrap()["step"],
        0,
        "paused: it will not get there"
    );
    assert_eq!(wait("phase=paused").await.unwrap()["phase"], "paused");
    let error = wait("phase=running;timeout_secs=0.05").await.unwrap_err();
    assert_eq!(error.code, ErrorCode::DeadlineExceeded);
    client.ok("a", "run", json!({"until_step": 100})).await;
    assert!(wait("step=20").await.unwrap()["step"].as_u64().unwrap() >= 20);
    assert_eq!(wait("phase=paused").await.unwrap()["step"], 100);
    for bad in [
        "",
        "step=x",
        "step=1;phase=paused",
        "phase=asleep",
        "step=1;stepp=2",
        "step=1;timeout_secs=-1",
    ] {
        assert_eq!(
            wait(bad).await.unwrap_err().code,
            ErrorCode::InvalidArgument,
            "{bad}"
        );
    }
    // A deletion of the swarm ends the wait with an error.
    let other = daemon.another_client().await;
    let waiting =
        tokio::spawn(async move { other.query("jostle/a/get/wait?phase=running", None).await });
    client.ok("a", "delete", json!({})).await;
    if let Err(error) = waiting.await.unwrap() {
        assert_eq!(error.code, ErrorCode::NotFound);
    }
    daemon.stop().await;
}

/// A thread of its own reads long requests; the receiving thread reads short ones.
#[tokio::test(flavor = "multi_thread")]
async fn commands_of_one_client_are_executed_in_the_order_sent() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 10})).await;
    let long = " ".repeat(40_000);
    let mut answers = Vec::new();
    for k in 0..99 {
        let setting = json!({"pi2": 0.001 * f64::from(k + 1)}).to_string();
        let (verb, request) = match k % 3 {
            0 => ("set", setting + &long),
            1 => (
                "inform",
                json!({"select": {"ids": [k % 10]}, "direction": 0.1}).to_string(),
            ),
            _ => ("set", setting),
        };
        let get = client.session.get(format!("{PREFIX}/a/cmd/{verb}"));
        answers.push(get.payload(request).await.unwrap());
    }
    let mut seqs = Vec::new();
    for answer in answers {
        let answer = answer.recv_async().await.unwrap().into_result().unwrap();
        let reply = read(answer.encoding(), &answer.payload().to_bytes());
        seqs.push(reply["seq"].as_u64().unwrap());
    }
    assert_eq!(seqs, (1..=99).collect::<Vec<_>>());
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulation_in_a_program_draws_as_the_daemon_does() {
    let mut simulation = Simulation::new(&Spec::new(50, 1)).unwrap();
    let five = Change::inform(Selection::Count(5), 0.0);
    for _ in 0..2 {
        simulation.apply(&five).unwrap();
    }
    for _ in 0..20 {
        simulation.step().unwrap();
    }

    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 50, "seed": 1})).await;
    let inform = json!({"select": {"count": 5}, "direction": 0});
    for _ in 0..2 {
        client.ok("a", "inform", inform.clone()).await;
    }
    client.ok("a", "step", json!({"steps": 20})).await;
    let status = client.get("a", "status").await["result"].take();
    let hash: String = simulation
        .state_hash()
        .map(|it| format!("{it:02x}"))
        .concat();
    assert_eq!(status["state_hash"], hash);
    let informed = simulation.state.configuration.weight.iter();
    assert_eq!(status["informed"], informed.filter(|it| **it > 0.0).count());
    daemon.stop().await;
}
