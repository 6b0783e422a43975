//! The events, the journal and the parameters of a swarm.

use jostle_proto::{ErrorCode, Event, EventKind, Events, Journal, Parameters, keys};
use serde_json::{Value, json};
use zenoh_ext::{AdvancedSubscriberBuilderExt, HistoryConfig};

use crate::support::{Client, Daemon, PREFIX};

async fn page(client: &Client, swarm: &str, noun: &str, selector: &str) -> Value {
    let key = keys::get(PREFIX, swarm, noun);
    let reply = client.query(&format!("{key}?{selector}"), None).await;
    reply.unwrap()["result"].take()
}

#[tokio::test(flavor = "multi_thread")]
async fn missed_events_are_queried_page_by_page_and_none_is_missing() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    for _ in 0..40 {
        client.ok("a", "set", json!({"pi3": 1.1})).await;
    }
    let mut after = 0;
    let mut events: Vec<Event> = Vec::new();
    loop {
        let selector = format!("after={after};limit=7");
        let page: Events =
            serde_json::from_value(page(client, "a", "events", &selector).await).unwrap();
        assert_eq!((page.oldest, page.newest), (Some(1), 41));
        assert!(page.events.len() <= 7);
        events.extend(page.events);
        after = events.last().unwrap().number;
        if after == page.newest {
            break;
        }
    }
    let numbers: Vec<u64> = events.iter().map(|event| event.number).collect();
    assert_eq!(numbers, (1..=41).collect::<Vec<_>>());
    assert!(matches!(events[0].event, EventKind::Created { .. }));
    // The same events are published.
    let watcher = daemon.another_client().await;
    let subscriber = watcher
        .session
        .declare_subscriber(keys::event(PREFIX, "a"))
        .history(HistoryConfig::default().detect_late_publishers())
        .await
        .unwrap();
    for expected in &events {
        let sample = subscriber.recv_async().await.unwrap();
        let event: Event = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
        assert_eq!(event, *expected);
    }
    let none = page(client, "a", "events", "after=41").await;
    assert_eq!(none, json!({"events": [], "oldest": 1, "newest": 41}));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_oldest_events_are_evicted_and_the_numbers_show_it() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 2})).await;
    for _ in 0..1100 {
        client.ok("a", "step", json!({})).await;
    }
    let page = page(client, "a", "events", "limit=1000").await;
    let page: Events = serde_json::from_value(page).unwrap();
    assert_eq!((page.oldest, page.newest), (Some(78), 1101));
    // The creation stays, before the gap.
    let first: Vec<u64> = page.events[..3].iter().map(|it| it.number).collect();
    assert_eq!(first, [1, 78, 79]);
    assert_eq!(page.events.len(), 1000);
    daemon.stop().await;
}

/// The spec and the journal determine the state.
#[tokio::test(flavor = "multi_thread")]
async fn executing_a_journal_again_leads_to_the_same_hash() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let spec = json!({"n": 12, "seed": 9, "rate": null});
    client.create("a", spec.clone()).await;
    for (verb, args) in [
        (
            "inform",
            json!({"select": {"count": 4}, "direction": 0.5, "for_time": 1.0}),
        ),
        ("run", json!({"until_step": 80})),
    ] {
        client.ok("a", verb, args).await;
    }
    client.wait_for_step("a", 80).await;
    for (verb, args) in [
        ("inject", json!({"count": 3})),
        (
            "batch",
            json!({"commands": [
                {"verb": "set", "args": {"pi1": 5, "make_room": true}},
                {"verb": "remove", "args": {"select": {"count": 2}}},
            ]}),
        ),
        ("step", json!({"steps": 40})),
        ("uninform", json!({"select": {"fraction": 1}})),
        ("step", json!({"steps": 30})),
    ] {
        client.ok("a", verb, args).await;
    }
    let status = client.get("a", "status").await;

    let journal = client.get("a", "journal").await["result"].take();
    let journal: Journal = serde_json::from_value(journal).unwrap();
    assert_eq!((journal.oldest, journal.newest), (Some(1), 8));
    client.create("b", spec).await;
    for entry in &journal.entries {
        client.wait_for_step("b", entry.step).await;
        let request = json!({"expect_step": entry.step, "args": entry.args});
        let reply = client.ok("b", &entry.verb, request).await;
        assert!(reply["seq"].as_u64() >= Some(entry.seq), "{reply}");
    }
    let again = client.get("b", "status").await;
    assert_eq!(
        again["result"]["state_hash"],
        status["result"]["state_hash"]
    );
    assert_eq!(again["seq"], status["seq"]);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_parameter_has_a_value_range_unit_and_whether_it_may_change() {
    let daemon = Daemon::with(&[("max_individuals", "60")]).await;
    let client = &daemon.client;
    client
        .create("a", json!({"n": 5, "pi1": 3, "seed": 8}))
        .await;
    let parameters = async || -> Parameters {
        let reply = client.get("a", "parameters").await;
        serde_json::from_value(reply["result"].clone()).unwrap()
    };
    let before = parameters().await;
    let spec = client.get("a", "spec").await["result"].take();
    for parameter in &before.parameters {
        assert_eq!(parameter.value, spec[&parameter.name], "{parameter:?}");
        assert!(!parameter.doc.is_empty() && !parameter.unit.is_empty());
        assert_eq!(parameter.live, !parameter.changed_by.is_empty());
    }
    // All but the start.
    assert_eq!(before.parameters.len() + 1, spec.as_object().unwrap().len());
    let find = |parameters: &Parameters, name: &str| {
        let found = parameters.parameters.iter().find(|it| it.name == name);
        found.unwrap().clone()
    };
    assert_eq!(find(&before, "n").maximum, Some(60.0));

    // The usual values are valid, also where the limit of the daemon or of the swarm is below the paper's.
    client.create("long", json!({"n": 5, "pi1": 32})).await;
    let reply = client.get("long", "parameters").await["result"].take();
    let of_long: Parameters = serde_json::from_value(reply).unwrap();
    let mut clipped = Vec::new();
    for parameter in before.parameters.iter().chain(&of_long.parameters) {
        let Some(usual) = parameter.usual else {
            continue;
        };
        let within = parameter.minimum.unwrap_or(0.0)..=parameter.maximum.unwrap();
        let is_valid = within.contains(&usual.from) && within.contains(&usual.to);
        assert!(is_valid && usual.from < usual.to, "{parameter:?}");
        if usual.to == *within.end() {
            clipped.push(&*parameter.name);
        }
    }
    for name in ["n", "dt"] {
        assert!(clipped.contains(&name), "{clipped:?}");
    }
    // If the limit is below all of them there are none.
    let turning = json!({"n": 2, "pi3": 1e4, "dt": 1e-5});
    client.create("turning", turning).await;
    let reply = client.get("turning", "parameters").await["result"].take();
    let dt = find(&serde_json::from_value(reply).unwrap(), "dt");
    assert!(dt.maximum.unwrap() < 0.005 && dt.usual.is_none(), "{dt:?}");

    // Live parameters change, others do not.
    let set = json!({"pi1": 6, "make_room": true, "pi2": 0.25, "publish_every": 7});
    client.ok("a", "set", set).await;
    client
        .ok("a", "run", json!({"rate": null, "until_step": 1}))
        .await;
    client.ok("a", "inject", json!({"count": 1})).await;
    client.ok("a", "reset", json!({"seed": 10})).await;
    let set = json!({"pi1": 6, "make_room": true});
    client.ok("a", "set", set).await;
    let after = parameters().await;
    let changed: Vec<String> = before
        .parameters
        .iter()
        .zip(&after.parameters)
        .filter(|(before, after)| before.value != after.value)
        .map(|(before, _)| before.name.clone())
        .collect();
    assert_eq!(changed, ["pi1", "seed", "rate"]);
    // A longer body permits only a shorter step, up to this range.
    let largest = find(&after, "dt").maximum.unwrap();
    assert!(largest < find(&before, "dt").maximum.unwrap());
    for (dt, fits) in [(largest * 0.999, true), (largest * 1.001, false)] {
        let create = json!({"name": format!("b{fits}"), "spec": {"n": 2, "pi1": 6, "dt": dt}});
        let key = keys::node_cmd(PREFIX, crate::support::NODE, "create");
        let answer = client
            .query(&key, Some(create.to_string().as_bytes()))
            .await;
        assert_eq!(answer.is_ok(), fits, "{dt}: {answer:?}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_query_for_a_page_is_rejected() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 2})).await;
    for (noun, selector, field) in [
        ("events", "after=-1", "after"),
        ("events", "after=1.5", "after"),
        ("journal", "limit=0", "limit"),
        ("journal", "limit=1001", "limit"),
        ("events", "before=3", "before"),
        ("parameters", "after=1", "after"),
    ] {
        let key = keys::get(PREFIX, "a", noun);
        let error = client.query(&format!("{key}?{selector}"), None).await;
        let error = error.unwrap_err();
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{selector}");
        assert_eq!(error.details["field"], field);
    }
    daemon.stop().await;
}
