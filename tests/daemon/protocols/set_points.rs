//! Exports of swarms that controllers steered: the file has their set-points.

use std::time::Duration;

use jostle_experiment::{Files, Plan, execute_run};
use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};
use tokio::time::sleep;

use super::{file_of, last_hash};
use crate::support::daemon_process::{killed, start};
use crate::support::{Client, Daemon, NODE, PREFIX, until};

/// Asserts that the run of the file has the hash of the swarm, also with the CSV beside the file.
async fn assert_repeats(client: &Client, swarm: &str, what: &str) {
    let hash = client.hash(swarm).await;
    let file = file_of(client, swarm).await;
    assert_eq!(last_hash(&file), hash, "{what}\n{file}");
    let reply = client
        .get(swarm, "experiment?setpoints=found.setpoints.csv")
        .await;
    let setpoints = reply["result"]["setpoints"].as_str().map(str::to_owned);
    let files = Files {
        toml: reply["result"]["file"].as_str().unwrap().to_owned(),
        setpoints,
        ..Files::default()
    };
    let is_named = files.toml.contains("setpoints = \"found.setpoints.csv\"");
    assert_eq!(is_named, files.setpoints.is_some(), "{}", files.toml);
    let plan = Plan::of(files).unwrap();
    let finished = execute_run(&plan, &plan.runs()[0], |_| true).unwrap();
    assert_eq!(finished.row.unwrap().state_hash, hash, "{what}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_file_of_a_steered_swarm_has_a_run_with_its_hash_also_after_kills() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let spec = json!({"n": 16, "seed": 5, "dt": 0.05, "noise": 0.05});
    daemon.1.create("led", spec).await;
    let join = |more: Value| {
        let mut args = json!({"controller": "ada", "deadline_secs": 60, "driving": true});
        args.as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        args
    };
    let advance = |steps: u64, set: Value| json!({"controller": "ada", "steps": steps, "set": set});
    let script = [
        ("inform", json!({"select": {"count": 3}, "direction": 2})),
        (
            "join",
            join(json!({"select": {"ids": [0, 3, 7]}, "on_timeout": "free"})),
        ),
        (
            "advance",
            advance(4, json!({"ids": [0, 3], "direction": [0.1, -2.0]})),
        ),
        ("set", json!({"pi2": 1.25})),
        // The same set-points have another weight now; they are between two commands of a step.
        (
            "advance",
            advance(1, json!({"ids": [3, 0], "direction": [-2.0, 0.1]})),
        ),
        ("inject", json!({"count": 2, "direction": 1})),
        (
            "advance",
            advance(
                9,
                json!({"ids": [7], "direction": [3.0], "weight": [0.5], "turn": [0.4]}),
            ),
        ),
        (
            "advance",
            advance(
                5,
                json!({"ids": [7], "direction": [3.0], "turn": [null], "speed": [0.3]}),
            ),
        ),
        ("remove", json!({"select": {"ids": [3]}})),
        (
            "advance",
            advance(3, json!({"ids": [0], "direction": [0.25], "weight": [3.0]})),
        ),
        ("uninform", json!({"select": {"ids": [0]}})),
        (
            "advance",
            advance(3, json!({"ids": [0], "direction": [0.25], "weight": [3.0]})),
        ),
        // It keeps one of its individuals, and releases that one when it leaves.
        (
            "join",
            join(json!({"select": {"ids": [0]}, "on_timeout": "free", "again": true})),
        ),
        ("advance", json!({"controller": "ada", "steps": 3})),
        ("leave", json!({"controller": "ada"})),
        ("step", json!({"steps": 6})),
    ];
    for epoch in 0..2 {
        for (k, (verb, args)) in script.iter().enumerate() {
            daemon.1.ok("led", verb, args.clone()).await;
            let is_step = matches!(*verb, "advance" | "step");
            if is_step {
                assert_repeats(&daemon.1, "led", &format!("{epoch} {k} {verb}")).await;
            }
            if k == 6 {
                daemon = killed(folder.path(), daemon).await;
                daemon
                    .1
                    .ok(
                        "led",
                        "join",
                        join(json!({"again": true, "on_timeout": "free"})),
                    )
                    .await;
                // Not every step is durable before a command.
                daemon
                    .1
                    .ok("led", "advance", json!({"controller": "ada", "steps": 2}))
                    .await;
                assert_repeats(&daemon.1, "led", &format!("{epoch} after the kill")).await;
            }
        }
        let file = file_of(&daemon.1, "led").await;
        assert!(
            file.contains("\nsetpoints = '''\nstep,id,direction,weight,turn,speed"),
            "{file}"
        );
        daemon
            .1
            .ok("led", "reset", json!({"seed": 12 + epoch}))
            .await;
    }
    // Another run of the same set-points.
    let client = &daemon.1;
    client.ok("led", "step", json!({"steps": 2})).await;
    assert_repeats(client, "led", "no set-points").await;
    assert!(!file_of(client, "led").await.contains("setpoints"));
    daemon.0.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_file_has_what_late_controllers_released() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for on_timeout in ["hold", "free"] {
        client
            .create(on_timeout, json!({"n": 12, "dt": 0.05}))
            .await;
        let join = |controller: &str, id: u32, deadline: f64| {
            json!({"controller": controller, "select": {"ids": [id]}, "deadline_secs": deadline,
                   "on_timeout": on_timeout})
        };
        client.ok(on_timeout, "join", join("ada", 0, 60.0)).await;
        client.ok(on_timeout, "join", join("bob", 1, 0.2)).await;
        let advance = |controller: &str, id: u32| {
            json!({"controller": controller, "steps": 3,
                   "set": {"ids": [id], "direction": [1.0], "weight": [2.0]}})
        };
        let other = daemon.another_client().await;
        tokio::join!(
            client.ok(on_timeout, "advance", advance("ada", 0)),
            other.ok(on_timeout, "advance", advance("bob", 1))
        );
        for _ in 0..3 {
            client
                .ok(
                    on_timeout,
                    "advance",
                    json!({"controller": "ada", "steps": 4}),
                )
                .await;
            assert_repeats(client, on_timeout, on_timeout).await;
        }
        let file = file_of(client, on_timeout).await;
        assert_eq!(file.contains(",1,,\n"), on_timeout == "free", "{file}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_file_has_the_set_points_of_a_controller_that_runs_freely() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("free", json!({"n": 10, "rate": 5})).await;
    client.ok("free", "run", json!({})).await;
    let join = json!({"controller": "ada", "select": {"ids": [2, 5]}, "mode": "free_running",
                      "deadline_secs": 0.5, "on_timeout": "free"});
    client.ok("free", "join", join).await;
    let key = keys::ctl(PREFIX, "free", "ada");
    for sequence in 1..=20 {
        let set = json!({"ids": [2, 5], "direction": [0.1 * f64::from(sequence), -1.0]});
        let put = json!({"sequence": sequence, "set": set}).to_string();
        let sent = client.session.put(&key, put).encoding("application/json");
        sent.await.unwrap();
        sleep(Duration::from_millis(20)).await;
    }
    until("the lease has ended, which releases both", async || {
        file_of(client, "free").await.contains(",5,,\n")
    })
    .await;
    client.ok("free", "pause", json!({})).await;
    client.ok("free", "step", json!({})).await;
    let file = file_of(client, "free").await;
    assert!(
        file.lines().filter(|line| line.contains(",2,")).count() > 4,
        "{file}"
    );
    assert_repeats(client, "free", "free").await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn set_points_that_do_not_fit_into_a_message_are_rejected_and_equal_ones_take_no_space() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("crowd", json!({"n": 200})).await;
    let ids: Vec<u32> = (0..200).collect();
    let join = json!({"controller": "ada", "select": {"ids": ids}});
    client.ok("crowd", "join", join).await;
    let advance = async |direction: f64| {
        let set = json!({"ids": ids, "direction": vec![direction; 200]});
        let args = json!({"controller": "ada", "set": set});
        client.ok("crowd", "advance", args).await;
    };
    for _ in 0..150 {
        advance(1.0 / 3.0).await;
    }
    let file = file_of(client, "crowd").await;
    assert_eq!(last_hash(&file), client.hash("crowd").await);
    assert!(file.len() < 10_000, "{}", file.len());
    for k in 0..150 {
        advance(f64::from(k).sin()).await;
    }
    let key = keys::get(PREFIX, "crowd", "experiment");
    let error = client.query(&key, None).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
    assert!(error.message.contains("fewer set-points"), "{error:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_export_that_is_accepted_can_be_submitted() {
    // 121 kB for a message, of which about a tenth are line breaks.
    let daemon = Daemon::with(&[("max_individuals", "220")]).await;
    let client = &daemon.client;
    client.create("crowd", json!({"n": 200})).await;
    let ids: Vec<u32> = (0..200).collect();
    let join = json!({"controller": "ada", "select": {"ids": ids}});
    client.ok("crowd", "join", join).await;
    let key = keys::get(PREFIX, "crowd", "experiment");
    let mut longest = None;
    for k in 0..80 {
        let set = json!({"ids": ids, "direction": vec![k % 2; 200]});
        let args = json!({"controller": "ada", "set": set});
        client.ok("crowd", "advance", args).await;
        if k < 40 {
            continue;
        }
        match client.query(&key, None).await {
            Ok(reply) => longest = Some(reply["result"]["file"].clone()),
            Err(error) => {
                assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
                break;
            }
        }
    }
    let longest = longest.unwrap();
    assert!(longest.as_str().unwrap().len() > 100_000);
    let key = keys::node_cmd(PREFIX, NODE, "experiment");
    let request = json!({"submit": {"toml": longest, "name": "again"}}).to_string();
    let submitted = client.query(&key, Some(request.as_bytes())).await;
    submitted.unwrap();
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reset_makes_a_swarm_exportable_whose_released_individuals_are_unknown() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("led", json!({"n": 9, "seed": 4})).await;
    let join = |select: Value, again: bool| {
        json!({"controller": "ada", "select": select, "again": again, "on_timeout": "free",
               "deadline_secs": 60})
    };
    let first = join(json!({"ids": [0, 1]}), false);
    client.ok("led", "join", first).await;
    let set = json!({"ids": [0, 1], "direction": [1.0, 2.0]});
    let advance = json!({"controller": "ada", "set": set});
    client.ok("led", "advance", advance).await;
    client
        .ok("led", "join", join(json!({"count": 1}), true))
        .await;
    client
        .ok("led", "leave", json!({"controller": "ada"}))
        .await;
    let key = keys::get(PREFIX, "led", "experiment");
    let error = client.query(&key, None).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::Conflict, "{error:?}");
    assert!(error.message.contains("reset the swarm"), "{error:?}");
    client.ok("led", "reset", json!({})).await;
    client.ok("led", "step", json!({"steps": 3})).await;
    assert_repeats(client, "led", "after the reset").await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn parameters_of_an_export_are_checked_and_give_runs_with_other_seeds() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 8, "seed": 9})).await;
    client.ok("a", "step", json!({"steps": 5})).await;
    for (parameters, field) in [
        ("replicates=0", "replicates"),
        ("replicates=100001", "replicates"),
        ("replicates=many", "replicates"),
        ("setpoints=", "setpoints"),
        ("setpoints=../a.csv", "setpoints"),
        ("setpoints=a b.csv", "setpoints"),
        ("seeds=3", "seeds"),
    ] {
        let key = format!("{}?{parameters}", keys::get(PREFIX, "a", "experiment"));
        let error = client.query(&key, None).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{error:?}");
        assert!(error.message.contains(field), "{error:?}");
    }
    let reply = client.get("a", "experiment?replicates=3").await;
    let plan = Plan::parse(reply["result"]["file"].as_str().unwrap()).unwrap();
    assert_eq!(plan.runs().len(), 3);
    assert!(plan.runs().iter().all(|run| run.seed != 9));
    daemon.stop().await;
}
