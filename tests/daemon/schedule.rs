//! Scheduled commands and batches.

use jostle_proto::{ErrorCode, Event, EventKind, Events, keys};
use serde_json::{Value, json};

use crate::support::streams::{next_event, subscribe};
use crate::support::{Client, Daemon, PREFIX, until};

/// Every event in the history of a swarm.
async fn events(client: &Client, swarm: &str) -> Vec<Event> {
    let reply = client.get(swarm, "events").await;
    let events: Events = serde_json::from_value(reply["result"].clone()).unwrap();
    events.events
}

fn at(step: u64, args: Value) -> Value {
    let mut request = json!({"at_step": step});
    request["args"] = args;
    request
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_for_a_later_step_is_acknowledged_announced_and_executed_there() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 8, "seed": 3})).await;
    client.create("b", json!({"n": 8, "seed": 3})).await;
    let set = json!({"pi3": 1.5});

    // Scheduled while the swarm is paused, and while it runs.
    let request = json!({"at_step": 7, "client": "me", "request_id": "later", "args": set});
    let reply = client.ok("a", "set", request).await;
    assert_eq!(reply["result"], json!({"applies_at_step": 7}));
    assert_eq!((&reply["step"], &reply["seq"]), (&json!(0), &json!(0)));
    assert_eq!(client.get("a", "status").await["result"]["scheduled"], 1);
    let reply = client.ok("a", "step", json!({"steps": 12})).await;
    assert_eq!(reply["seq"], 2);
    assert_eq!(client.get("a", "status").await["result"]["scheduled"], 0);

    // Sent without `at_step`, at the same step.
    client.ok("b", "step", json!({"steps": 7})).await;
    client.ok("b", "set", set.clone()).await;
    let by_hand = client.ok("b", "step", json!({"steps": 5})).await;
    assert_eq!(
        reply["result"]["state_hash"],
        by_hand["result"]["state_hash"]
    );

    let received = events(client, "a").await;
    let scheduled = received.iter().find_map(|event| match &event.event {
        EventKind::Scheduled {
            applies_at_step,
            verb,
            request_id,
            ..
        } => Some((*applies_at_step, verb.as_str(), request_id.clone())),
        _ => None,
    });
    assert_eq!(scheduled, Some((7, "set", Some("later".into()))));
    let applied = received.iter().find_map(|event| match &event.event {
        EventKind::Command {
            verb, request_id, ..
        } if verb == "set" => Some((event.step, request_id.clone())),
        _ => None,
    });
    assert_eq!(applied, Some((7, Some("later".into()))));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_step_in_the_past_is_a_conflict_and_the_present_one_is_now() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 4})).await;
    client.ok("a", "step", json!({"steps": 5})).await;
    let request = at(4, json!({"pi3": 2}));
    let error = client.cmd("a", "set", request).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::Conflict);
    assert_eq!(error.details["field"], "at_step");
    assert_eq!((&error.details["step"], error.step), (&json!(5), Some(5)));
    let reply = client.ok("a", "set", at(5, json!({"pi3": 2}))).await;
    assert_eq!(reply["result"]["now"]["pi3"], 2.0);
    let largest = (1_u64 << 53) - 1;
    client.ok("a", "set", at(largest, json!({"pi3": 2}))).await;
    let beyond = client.err("a", "set", at(largest + 1, json!({"pi3": 2})));
    assert_eq!(beyond.await.0, ErrorCode::InvalidArgument);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_running_swarm_pauses_resumes_and_ends_at_the_scheduled_steps() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 4, "rate": null})).await;
    for (step, verb) in [(100, "pause"), (100, "step"), (101, "run"), (200, "delete")] {
        let reply = client.ok("a", verb, at(step, json!({}))).await;
        assert_eq!(reply["result"]["applies_at_step"], step, "{verb}");
    }
    let subscriber = subscribe(client, keys::event(PREFIX, "a")).await;
    client.ok("a", "run", json!({})).await;
    let mut received = Vec::new();
    let is_end = |event: &Event| matches!(event.event, EventKind::Deleted { .. });
    while !received.last().is_some_and(is_end) {
        received.push(next_event(&subscriber).await);
    }
    let applied: Vec<(u64, &str)> = received
        .iter()
        .filter_map(|event| match &event.event {
            EventKind::Command { verb, .. } => Some((event.step, verb.as_str())),
            EventKind::Deleted { .. } => Some((event.step, "delete")),
            _ => None,
        })
        .collect();
    let expected = [
        (0, "run"),
        (100, "pause"),
        (100, "step"),
        (101, "run"),
        (200, "delete"),
    ];
    assert_eq!(applied, expected);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scheduled_command_that_fails_at_its_step_is_an_event() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    // An invalid argument is rejected at once.
    let (code, message) = client.err("a", "set", at(9, json!({"pi1": 0.5}))).await;
    assert_eq!(code, ErrorCode::InvalidArgument, "{message}");
    // A missing individual is an error only at the step.
    let remove = json!({"select": {"ids": [2]}});
    client.ok("a", "remove", at(3, remove.clone())).await;
    client.ok("a", "remove", at(3, remove)).await;
    // The swarm runs at the step of this command.
    client.ok("a", "step", at(4, json!({}))).await;
    let reply = client.ok("a", "step", json!({"steps": 5})).await;
    assert_eq!(reply["step"], 5);
    let rejected: Vec<(u64, String, ErrorCode)> = events(client, "a")
        .await
        .into_iter()
        .filter_map(|event| match event.event {
            EventKind::Refused { verb, error, .. } => Some((event.step, verb, error.code)),
            _ => None,
        })
        .collect();
    let expected = [
        (3, "remove".to_owned(), ErrorCode::InvalidArgument),
        (4, "step".to_owned(), ErrorCode::IncorrectState),
    ];
    assert_eq!(rejected, expected);
    assert_eq!(client.get("a", "status").await["result"]["n"], 2);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_event_of_a_rejected_command_has_the_range_of_the_reply() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    let number = "a number from -1e6 to 1e6";
    let pose = json!({"at": [{"x": 50, "y": 0, "alpha": 1e7}]});
    let batch = json!({"commands": [{"verb": "inject", "args": pose}]});
    for (verb, args, field, range) in [
        (
            "inject",
            json!({"count": 1, "within": {"x": 0, "y": 0, "radius": -1}}),
            "within.radius",
            "a number above 0, at most 1e6",
        ),
        ("inject", pose, "at[0].alpha", number),
        ("batch", batch, "commands[0].args.at[0].alpha", number),
    ] {
        let now = client.cmd("a", verb, args.clone()).await.unwrap_err();
        let step = client.get("a", "status").await["step"].as_u64().unwrap();
        // Individuals are placed at the step, so their places are checked there.
        client.ok("a", verb, at(step + 1, args)).await;
        client.ok("a", "step", json!({})).await;
        let rejected = events(client, "a").await.pop().unwrap();
        let EventKind::Refused { error, .. } = rejected.event else {
            panic!("{verb}: {rejected:?}");
        };
        for error in [&now, &error] {
            assert_eq!(error.details["field"], field, "{error:?}");
            assert_eq!(error.details["range"], range, "{error:?}");
        }
        assert_eq!(error.message, now.message);
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reset_rejects_all_that_waits() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    for step in [10, 20] {
        client.ok("a", "set", at(step, json!({"pi3": 2}))).await;
    }
    client.ok("a", "reset", json!({})).await;
    assert_eq!(client.get("a", "status").await["result"]["scheduled"], 0);
    let rejected: Vec<Value> = events(client, "a")
        .await
        .into_iter()
        .filter_map(|event| match event.event {
            EventKind::Refused { error, .. } => Some(json!([error.code, error.details["at_step"]])),
            _ => None,
        })
        .collect();
    assert_eq!(rejected, [json!(["conflict", 10]), json!(["conflict", 20])]);
    client.ok("a", "step", json!({"steps": 30})).await;
    let status = client.get("a", "status").await;
    assert_eq!(status["result"]["parameters"]["pi3"], 1.0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_number_of_scheduled_commands_is_limited() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    let mut rejected = 0;
    for step in 0..1030 {
        let request = at(1000 + step, json!({"pi3": 2}));
        if let Err(error) = client.cmd("a", "set", request).await {
            assert_eq!(error.code, ErrorCode::ResourceExhausted);
            rejected += 1;
        }
    }
    assert_eq!(rejected, 1030 - 1024);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_faulted_swarm_accepts_no_scheduled_command_but_reset() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    crate::commands::fault(client, "a").await;
    let step = client.get("a", "status").await["step"].as_u64().unwrap();
    let (code, _) = client
        .err("a", "set", at(step + 5, json!({"pi3": 2})))
        .await;
    assert_eq!(code, ErrorCode::IncorrectState);
    client.ok("a", "reset", at(step, json!({}))).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_faulted_swarm_schedules_no_command_that_it_executes_at_once() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    crate::commands::fault(client, "a").await;
    let step = client.get("a", "status").await["step"].as_u64().unwrap();
    for (verb, args) in [
        ("annotate", json!({"text": "here"})),
        ("protect", json!({"on": true})),
    ] {
        // It takes no step, so it would never be executed.
        let (code, message) = client.err("a", verb, at(step + 5, args.clone())).await;
        assert_eq!(code, ErrorCode::IncorrectState, "{verb}: {message}");
        client.ok("a", verb, args).await;
    }
    assert_eq!(client.get("a", "status").await["result"]["scheduled"], 0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_batch_has_the_effect_of_its_changes_sent_alone_at_that_step() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let changes = [
        ("set", json!({"pi3": 1.5, "pi4": 5})),
        ("inform", json!({"select": {"count": 3}, "direction": 0.5})),
        ("inject", json!({"count": 2, "direction": 1})),
        ("remove", json!({"select": {"fraction": 0.2}})),
        ("uninform", json!({"select": {"count": 1}})),
    ];
    let commands: Vec<Value> = changes
        .iter()
        .map(|(verb, args)| json!({"verb": verb, "args": args}))
        .collect();
    for name in ["a", "b"] {
        client.create(name, json!({"n": 10, "seed": 4})).await;
        client.ok(name, "step", json!({"steps": 3})).await;
    }
    let batch = client.ok("a", "batch", json!({"commands": commands})).await;
    assert_eq!((&batch["step"], &batch["seq"]), (&json!(3), &json!(6)));
    for ((verb, args), result) in changes
        .iter()
        .zip(batch["result"]["results"].as_array().unwrap())
    {
        let mut alone = client.ok("b", verb, args.clone()).await["result"].take();
        // The changes of a batch are applied together: none has a rate of its own.
        alone.as_object_mut().unwrap().remove("published_hz");
        assert_eq!(*result, json!({"verb": verb, "result": alone}));
    }
    assert_eq!(client.hash("a").await, client.hash("b").await);
    // One event and one entry for all of them.
    let journal = client.get("a", "journal").await;
    let last = &journal["result"]["entries"][1];
    assert_eq!((&last["verb"], &last["seq"]), (&json!("batch"), &json!(6)));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_batch_with_one_impossible_change_changes_nothing() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 10, "seed": 4})).await;
    let before = client.get("a", "status").await;
    for (bad, field) in [
        (
            json!({"verb": "set", "args": {"pi1": 99}}),
            "commands[3].args.pi1",
        ),
        (
            json!({"verb": "remove", "args": {"select": {"ids": [77]}}}),
            "commands[3].args.select.ids",
        ),
        (
            json!({"verb": "inform", "args": {"select": {"count": 1}, "direction": 1, "weight": -1}}),
            "commands[3].args.weight",
        ),
    ] {
        let commands = json!({"commands": [
            {"verb": "set", "args": {"pi3": 2, "publish_every": 9}},
            {"verb": "inject", "args": {"count": 3}},
            {"verb": "inform", "args": {"select": {"count": 5}, "direction": 0}},
            bad,
            {"verb": "set", "args": {"pi4": 3}},
        ]});
        let error = client.cmd("a", "batch", commands).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{error:?}");
        assert_eq!(error.details["field"], field, "{error:?}");
        assert_eq!(client.get("a", "status").await, before);
    }
    // Draws are as without the batch.
    client.create("b", json!({"n": 10, "seed": 4})).await;
    let inform = json!({"select": {"count": 5}, "direction": 0});
    for name in ["a", "b"] {
        client.ok(name, "inform", inform.clone()).await;
    }
    assert_eq!(client.hash("a").await, client.hash("b").await);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scheduled_batch_applies_as_a_whole_between_two_steps_of_a_running_swarm() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client
        .create("a", json!({"n": 6, "seed": 1, "rate": null}))
        .await;
    client.ok("a", "run", json!({})).await;
    let step = client.get("a", "status").await["step"].as_u64().unwrap() + 50_000;
    let commands = json!({"commands": [
        {"verb": "set", "args": {"pi3": 1.25}},
        {"verb": "inject", "args": {"count": 2}},
    ]});
    client.ok("a", "batch", at(step, commands)).await;
    client.ok("a", "pause", at(step + 10, json!({}))).await;
    until("its step", async || {
        client.get("a", "status").await["phase"] == "paused"
    })
    .await;
    let status = client.get("a", "status").await;
    assert_eq!(status["step"], step + 10);
    assert_eq!(status["result"]["n"], 8);
    let journal = client.get("a", "journal").await;
    let entries = journal["result"]["entries"].as_array().unwrap();
    let steps: Vec<(&str, u64)> = entries
        .iter()
        .map(|entry| {
            (
                entry["verb"].as_str().unwrap(),
                entry["step"].as_u64().unwrap(),
            )
        })
        .collect();
    assert_eq!(steps[1..], [("batch", step), ("pause", step + 10)]);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_scheduled_after_others_ran_replaces_none_that_is_pending() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    let later = async |at_step: u64, publish_every: u64| {
        let set = json!({"publish_every": publish_every});
        client.ok("a", "set", at(at_step, set)).await;
    };
    later(5, 2).await;
    later(10, 3).await;
    client.ok("a", "step", json!({"steps": 6})).await;
    later(10, 4).await;
    assert_eq!(client.get("a", "status").await["result"]["scheduled"], 2);
    client.ok("a", "step", json!({"steps": 6})).await;
    let journal = client.get("a", "journal").await;
    let entries = journal["result"]["entries"].as_array().unwrap();
    let set = entries.iter().filter(|entry| entry["verb"] == "set");
    let set: Vec<_> = set
        .map(|entry| (&entry["step"], &entry["args"]["publish_every"]))
        .collect();
    let expected = [(5, 2), (10, 3), (10, 4)].map(|(step, every)| (json!(step), json!(every)));
    assert!(
        set.iter()
            .copied()
            .eq(expected.iter().map(|(step, every)| (step, every))),
        "{set:?}"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_journal_of_a_fork_has_what_was_scheduled_before_also_after_a_restart() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 8})).await;
    client.ok("a", "set", at(4, json!({"pi3": 1.5}))).await;
    client.ok("a", "set", at(9, json!({"pi3": 2.5}))).await;
    client.ok("a", "fork", json!({"name": "b"})).await;
    client.ok("b", "step", json!({"steps": 6})).await;
    let entries =
        async |client: &Client| client.get("b", "journal").await["result"]["entries"].clone();
    let before = entries(client).await;
    let is_there = before
        .as_array()
        .unwrap()
        .iter()
        .any(|it| it["args"]["pi3"] == 1.5);
    assert!(is_there, "{before}");
    // The daemon stops, which writes a checkpoint after the command.
    let daemon = daemon.restart().await;
    assert_eq!(entries(&daemon.client).await, before);
    daemon.stop().await;
}
