//! The effect of commands: informed individuals, the group, parameters and rules.

use jostle_proto::{ErrorCode, EventKind, Events};
use serde_json::{Value, json};

use crate::support::{Daemon, until};

#[tokio::test(flavor = "multi_thread")]
async fn inform_changes_the_selected_individuals_and_a_draw_repeats() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let mut drawn = Vec::new();
    for name in ["a", "b"] {
        client.create(name, json!({"n": 20, "seed": 9})).await;
        let args = json!({"select": {"fraction": 0.25}, "direction": -1.5, "weight": 0.7});
        let reply = client.ok(name, "inform", args).await;
        drawn.push(reply["result"]["ids"].clone());
    }
    assert_eq!(drawn[0], drawn[1]);
    assert_eq!(drawn[0].as_array().unwrap().len(), 5);
    let state = client.query("jostle/a/state", None).await.unwrap();
    for (id, (weight, direction)) in (0..20u64).zip(
        state["weight"]
            .as_array()
            .unwrap()
            .iter()
            .zip(state["direction"].as_array().unwrap()),
    ) {
        let expected = if drawn[0].as_array().unwrap().contains(&json!(id)) {
            (0.7, -1.5)
        } else {
            (0.0, 0.0)
        };
        assert_eq!(
            (weight.as_f64().unwrap(), direction.as_f64().unwrap()),
            expected,
            "{id}"
        );
    }
    let reply = client
        .ok("a", "uninform", json!({"select": {"count": 2}}))
        .await;
    assert_eq!(reply["result"]["ids"].as_array().unwrap().len(), 2);
    assert_eq!(client.get("a", "status").await["result"]["informed"], 3);
    let (code, _) = client
        .err("a", "uninform", json!({"select": {"count": 4}}))
        .await;
    assert_eq!(code, ErrorCode::InvalidArgument, "only three are informed");

    let args = json!({"select": {"ids": [3]}, "direction": 0, "for_time": 0.1});
    client.ok("b", "inform", args).await;
    client.ok("b", "step", json!({"steps": 4})).await;
    let weight = async || client.query("jostle/b/state", None).await.unwrap()["weight"][3].clone();
    assert_eq!(weight().await, 0.5);
    client.ok("b", "step", json!({})).await;
    assert_eq!(weight().await, 0.0, "informed for 0.1, which is five steps");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn injected_individuals_overlap_no_other_and_removed_ones_do_not_return() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 10})).await;
    let reply = client
        .ok("a", "inject", json!({"count": 5, "direction": 1.0}))
        .await;
    assert_eq!(
        reply["result"],
        json!({"ids": [10, 11, 12, 13, 14], "n": 15})
    );
    let region = json!({"x": 100, "y": 0, "radius": 3});
    client
        .ok("a", "inject", json!({"count": 2, "within": region}))
        .await;
    let at = json!([{"x": -50, "y": 0, "alpha": 0}, {"x": -50, "y": 0.4, "alpha": 0}]);
    client.ok("a", "inject", json!({"at": at})).await;
    let status = client.get("a", "status").await;
    assert_eq!(status["result"]["informed"], 5);
    assert!(
        status["result"]["certificate"]["worst_gap"]
            .as_f64()
            .unwrap()
            >= -1e-12
    );

    let hash = client.hash("a").await;
    let (code, _) = client
        .err(
            "a",
            "inject",
            json!({"at": [{"x": -50, "y": 0.1, "alpha": 1}]}),
        )
        .await;
    assert_eq!(code, ErrorCode::InvalidArgument);
    let small = json!({"x": 0, "y": 0, "radius": 0.5});
    let (code, _) = client
        .err("a", "inject", json!({"count": 100, "within": small}))
        .await;
    assert_eq!(code, ErrorCode::ResourceExhausted);
    assert_eq!(client.hash("a").await, hash);

    let reply = client
        .ok("a", "remove", json!({"select": {"ids": [18, 0]}}))
        .await;
    assert_eq!(reply["result"], json!({"ids": [0, 18], "n": 17}));
    let reply = client.ok("a", "inject", json!({"count": 1})).await;
    assert_eq!(
        reply["result"]["ids"],
        json!([19]),
        "ids are never used twice"
    );
    let (code, message) = client
        .err("a", "remove", json!({"select": {"fraction": 1}}))
        .await;
    assert_eq!(code, ErrorCode::InvalidArgument);
    assert!(message.contains("leave one"), "{message}");
    client.ok("a", "step", json!({"steps": 50})).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn set_changes_what_it_names_and_a_new_shape_makes_room() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 40})).await;
    client.hash_at("a", 2000).await;
    let reply = client
        .ok("a", "set", json!({"pi3": 1.5, "publish_every": 7}))
        .await;
    let result = &reply["result"];
    assert_eq!(
        (&result["before"]["pi3"], &result["now"]["pi3"]),
        (&json!(1.0), &json!(1.5))
    );
    assert_eq!(
        (&result["now"]["publish_every"], &result["now"]["pi4"]),
        (&json!(7), &json!(10.0))
    );

    let hash = client.hash("a").await;
    let (code, message) = client.err("a", "set", json!({"pi1": 8})).await;
    assert_eq!(code, ErrorCode::ResourceExhausted);
    assert!(message.contains("make_room"), "{message}");
    assert_eq!(client.hash("a").await, hash);
    let reply = client
        .ok("a", "set", json!({"pi1": 8, "make_room": true}))
        .await;
    let scaled_by = reply["result"]["scaled_by"].as_f64().unwrap();
    assert!(scaled_by > 1.0 && scaled_by < 3.0, "{scaled_by}");
    client.ok("a", "step", json!({"steps": 100})).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_rules_and_the_noise_change_too_but_no_axes_stay_crossed() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let rules = json!({"contacts": "closest", "stepping": "velocity", "noise": 0.1,
        "attraction": {"kind": "metric", "radius": 3.0}});
    let mut spec = rules.clone();
    spec["n"] = json!(20);
    client.create("made", spec).await;
    client.create("changed", json!({"n": 20})).await;
    let reply = client.ok("changed", "set", rules.clone()).await;
    for (field, value) in rules.as_object().unwrap() {
        assert_eq!(&reply["result"]["now"][field], value, "{field}");
    }
    assert_eq!(reply["result"]["before"]["contacts"], "endpoints");
    assert_eq!(
        client.hash_at("made", 200).await,
        client.hash_at("changed", 200).await,
        "the rules are the same, changed or from the start"
    );
    for (wrong, says) in [
        (json!({"relinearise": 1}), "stepping"),
        (json!({"relinearise": 2}), "relinearise"),
        (json!({"noise": -1}), "noise"),
        (json!({"contacts": "all"}), "contacts"),
        (
            json!({"attraction": {"kind": "metric", "radius": 0}}),
            "radius",
        ),
    ] {
        let (code, message) = client.err("changed", "set", wrong).await;
        assert_eq!(code, ErrorCode::InvalidArgument, "{message}");
        assert!(message.contains(says), "{message}");
    }
    client
        .ok(
            "changed",
            "set",
            json!({"stepping": "position", "relinearise": 1}),
        )
        .await;

    // Needles in long steps: under `closest` some come to cross.
    client
        .create(
            "loose",
            json!({"n": 60, "pi1": 8, "pi4": 1, "dt": 0.05, "contacts": "closest"}),
        )
        .await;
    until("crossed axes", async || {
        client.ok("loose", "step", json!({"steps": 50})).await;
        client.get("loose", "status").await["result"]["certificate"]["crossed"] != 0
    })
    .await;
    let before = client.hash("loose").await;
    for strict in ["endpoints", "clamped"] {
        let request = json!({"contacts": strict, "pi3": 0.9});
        let (code, message) = client.err("loose", "set", request).await;
        assert_eq!(code, ErrorCode::IncorrectState);
        assert!(message.contains("pairs cross"), "{message}");
    }
    assert_eq!(client.hash("loose").await, before, "nothing has changed");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn informing_with_a_weight_of_0_is_rejected_at_once_and_at_its_step() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let weightless = "a weight of 0 informs no individual: set pi2 above 0";
    client.create("a", json!({"n": 6, "pi2": 0})).await;
    let informed = json!({"select": {"ids": [1]}, "direction": 0.5, "weight": 1});
    client.ok("a", "inform", informed).await;
    let hash = client.hash("a").await;
    let args = json!({"select": {"ids": [1, 3]}, "direction": 1});
    let inform = json!({"verb": "inform", "args": args});
    let batch = |first: f64| {
        let set = json!({"verb": "set", "args": {"pi2": first}});
        json!({"commands": [set, inform]})
    };
    let when = json!({"condition": "order > 0.9", "commands": [inform]});
    let inject = json!({"count": 1, "direction": 1});
    for (verb, request) in [
        ("inform", args.clone()),
        ("inject", inject.clone()),
        ("batch", batch(0.0)),
        ("when", when.clone()),
        ("inform", json!({"at_step": 10, "args": args})),
        ("inject", json!({"at_step": 10, "args": inject})),
        ("batch", json!({"at_step": 10, "args": batch(0.0)})),
        ("when", json!({"at_step": 10, "args": when})),
    ] {
        let error = client.cmd("a", verb, request.clone()).await.unwrap_err();
        assert!(error.message.contains(weightless), "{request}: {error:?}");
        assert_eq!(error.code, ErrorCode::InvalidArgument);
    }
    let field = client
        .cmd("a", "inform", args.clone())
        .await
        .unwrap_err()
        .details;
    assert_eq!(field["field"], "weight");
    assert_eq!(client.hash("a").await, hash);

    // One that sets pi2 first, at once or at an earlier step, and one that sets it to 0 before.
    client.ok("a", "batch", batch(0.5)).await;
    client.ok("a", "set", json!({"pi2": 0})).await;
    client
        .ok("a", "set", json!({"at_step": 10, "args": {"pi2": 2}}))
        .await;
    client
        .ok("a", "inform", json!({"at_step": 20, "args": args}))
        .await;
    client
        .ok("a", "set", json!({"at_step": 30, "args": {"pi2": 0}}))
        .await;
    client
        .ok("a", "inform", json!({"at_step": 40, "args": args}))
        .await;
    client.ok("a", "step", json!({"steps": 41})).await;
    let reply = client.get("a", "events").await;
    let events: Events = serde_json::from_value(reply["result"].clone()).unwrap();
    let rejected = events.events.into_iter().filter_map(|it| match it.event {
        EventKind::Refused { error, .. } => Some((it.step, error.message)),
        _ => None,
    });
    let rejected: Vec<(u64, String)> = rejected.collect();
    assert_eq!(rejected, [(40, weightless.to_owned())]);
    let weights = client.query("jostle/a/state", None).await.unwrap()["weight"].clone();
    assert_eq!((&weights[1], &weights[3]), (&json!(2.0), &json!(2.0)));
    let verified = client.get("a", "verify").await["result"].clone();
    assert_eq!(verified["differs_at"], json!(null), "{verified}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn informing_is_scheduled_without_a_weight_while_a_condition_may_set_it() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 6, "pi2": 0})).await;
    let args = json!({"select": {"ids": [3]}, "direction": 1});
    let inform = json!({"at_step": 40, "args": args});
    let refused = client.cmd("a", "inform", inform.clone()).await.unwrap_err();
    assert_eq!(refused.code, ErrorCode::InvalidArgument);
    let set = json!({"verb": "set", "args": {"pi2": 2}});
    let when = json!({"condition": "order > 0 for 0.1", "commands": [set]});
    client.ok("a", "when", when).await;
    client.ok("a", "inform", inform).await;
    let another = json!({"condition": "order > 0 for 1", "commands": [
        {"verb": "inform", "args": {"select": {"ids": [4]}, "direction": 1}},
    ]});
    client.ok("a", "when", another).await;
    client.ok("a", "step", json!({"steps": 100})).await;
    let weights = client.query("jostle/a/state", None).await.unwrap()["weight"].clone();
    assert_eq!((&weights[3], &weights[4]), (&json!(2.0), &json!(2.0)));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_status_and_the_reply_of_set_say_how_many_states_a_second_are_published() {
    let daemon = Daemon::with(&[("max_hz", "50")]).await;
    let client = &daemon.client;
    // 500 states a second are asked for.
    let spec = json!({"n": 3, "dt": 0.02, "rate": 10, "publish_every": 1});
    client.create("a", spec).await;
    let status = async || client.get("a", "status").await["result"]["published_hz"].clone();
    assert_eq!(status().await, 50.0);
    for (every, hz) in [(20, 25.0), (5, 50.0)] {
        let reply = client.ok("a", "set", json!({"publish_every": every})).await;
        assert_eq!(reply["result"]["published_hz"], hz);
        assert_eq!(status().await, hz);
    }
    client
        .ok("a", "run", json!({"until_step": 10, "rate": null}))
        .await;
    client.wait_for_step("a", 10).await;
    assert_eq!(status().await, 50.0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn informed_individuals_that_disagree_have_no_common_direction() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 4})).await;
    let inform = async |id: u32, direction: f64| {
        let args = json!({"select": {"ids": [id]}, "direction": direction});
        client.ok("a", "inform", args).await;
    };
    let order = async || client.get("a", "status").await["result"]["order"].clone();
    assert_eq!(order().await["direction_strength"], Value::Null);
    inform(0, 0.25).await;
    client.ok("a", "step", json!({"steps": 3})).await;
    let agreed = order().await;
    assert_eq!(agreed["direction"], 0.25);
    let strength = agreed["direction_strength"].as_f64().unwrap();
    assert!((1.0 - 1e-15..=1.0).contains(&strength), "{agreed}");
    // Opposite, but for a rounding of π.
    inform(1, 3.3916).await;
    client.ok("a", "step", json!({"steps": 3})).await;
    let apart = order().await;
    for name in ["direction", "drift"] {
        assert_eq!(apart[name], Value::Null, "{apart}");
    }
    let strength = apart["direction_strength"].as_f64().unwrap();
    assert!(0.0 < strength && strength < 1e-5, "{apart}");
    // Of the three steps before.
    assert_eq!(apart["mean_drift"], agreed["mean_drift"]);
    let measured = client.get("a", "measures?names=drift,front").await;
    for measure in measured["result"]["measures"].as_array().unwrap() {
        assert_eq!(measure["value"], Value::Null, "{measured}");
    }
    daemon.stop().await;
}
