//! `get/measures`: measures of the newest state, by name.

use jostle_proto::ErrorCode;
use serde_json::{Map, Value, json};

use crate::support::playback::{recorded_file, upload_and_open};
use crate::support::{Client, Daemon, NODE, PREFIX, TIMEOUT, http, until};

/// The measures of a reply, by name.
async fn values(client: &Client, swarm: &str, parameters: &str) -> Vec<(String, Value)> {
    let reply = client.get(swarm, &format!("measures{parameters}")).await;
    let measures = reply["result"]["measures"].as_array().unwrap().clone();
    let pair = |it: Value| (it["name"].as_str().unwrap().to_owned(), it["value"].clone());
    measures.into_iter().map(pair).collect()
}

/// Order and milling of the state, by their formulas.
fn order_and_milling(state: &Value) -> [f64; 2] {
    let column = |name: &str| -> Vec<f64> {
        let column = state[name].as_array().unwrap();
        column.iter().map(|it| it.as_f64().unwrap()).collect()
    };
    let [x, y, alpha] = ["x", "y", "alpha"].map(column);
    let n = alpha.len() as f64;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / n;
    let centroid = [mean(&x), mean(&y)];
    let mut sums = [0.0; 3];
    for ((x, y), alpha) in x.iter().zip(&y).zip(&alpha) {
        let (sin, cos) = alpha.sin_cos();
        let [dx, dy] = [x - centroid[0], y - centroid[1]];
        sums[0] += cos;
        sums[1] += sin;
        sums[2] += (dx * sin - dy * cos) / dx.hypot(dy);
    }
    [sums[0].hypot(sums[1]) / n, sums[2].abs() / n]
}

#[tokio::test(flavor = "multi_thread")]
async fn measures_are_those_of_the_newest_state_in_the_requested_order() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 20, "seed": 3})).await;
    client
        .ok("a", "step", json!({"args": {"steps": 100}}))
        .await;
    let reply = client
        .get("a", "measures?names=milling,order,clusters.count(0)")
        .await;
    assert_eq!(
        (&reply["step"], &reply["swarm"]),
        (&json!(100), &json!("a"))
    );
    let measures = reply["result"]["measures"].as_array().unwrap();
    let names: Vec<&Value> = measures.iter().map(|it| &it["name"]).collect();
    assert_eq!(names, ["milling", "order", "clusters.count(0)"]);
    assert_eq!(measures[2]["unit"], "clusters");
    let key = jostle_proto::keys::state(PREFIX, "a");
    let state = client.query(&format!("{key}?format=json"), None).await;
    let [order, milling] = order_and_milling(&state.unwrap());
    for (measure, expected) in measures.iter().zip([milling, order]) {
        let value = measure["value"].as_f64().unwrap();
        assert!((value - expected).abs() < 1e-12, "{measure}: {expected}");
    }
    // No individual is informed.
    let drift = values(client, "a", "?names=drift").await;
    assert_eq!(drift, [("drift".to_owned(), Value::Null)]);
    let all = values(client, "a", "").await;
    assert_eq!(all.len(), 21, "{all:?}");
    assert!(all.contains(&("drift".to_owned(), Value::Null)));
    for (name, _) in &all {
        assert!(
            !name.starts_with("msd") && !name.starts_with("speed"),
            "{name}"
        );
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wildcard_requests_measures_of_all_swarms() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    for name in ["a", "b"] {
        client.create(name, json!({"n": 3})).await;
    }
    let selector = format!("{PREFIX}/*/get/measures?names=order");
    let replies = client.query_all(&selector, None).await;
    assert_eq!(replies.len(), 2);
    for reply in replies {
        assert_eq!(reply.unwrap()["result"]["measures"][0]["name"], "order");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn costly_measures_are_rejected_for_a_large_group() {
    let daemon = Daemon::with(&[("max_individuals", "30000")]).await;
    let client = &daemon.client;
    client.create("large", json!({"n": 20_001})).await;
    let key = jostle_proto::keys::get(PREFIX, "large", "measures?names=order,spread");
    let error = client.query(&key, None).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::ResourceExhausted);
    assert_eq!(error.details["limit"], 20_000);
    assert!(error.message.contains("`spread`"), "{error:?}");
    assert!(error.message.contains("leave it out"), "{error:?}");
    let names = values(client, "large", "").await;
    let names: Vec<&str> = names.iter().map(|it| &*it.0).collect();
    let linear = ["order", "nematic", "milling", "drift", "radius_of_gyration"];
    assert_eq!(names, linear);
    let key = jostle_proto::keys::get(PREFIX, "large", "measures?histogram=pair_correlation");
    let error = client.query(&key, None).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::ResourceExhausted);
    assert_eq!(error.details, details(20_001));
    assert!(error.message.contains("use a smaller group"), "{error:?}");
    assert!(!error.message.contains("leave it out"), "{error:?}");
    daemon.stop().await;
}

/// The details of an error for a group of this size.
fn details(n: u64) -> Map<String, Value> {
    let details = json!({"n": n, "limit": 20_000});
    details.as_object().unwrap().clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn costly_measures_are_not_published_for_a_large_group() {
    let daemon = Daemon::with(&[("max_individuals", "30000")]).await;
    let client = &daemon.client;
    let measures = ["order", "spread"];
    let args = json!({"name": "large", "spec": {"n": 20_001, "measures": measures}}).to_string();
    let key = jostle_proto::keys::node_cmd(PREFIX, NODE, "create");
    let error = client.query(&key, Some(args.as_bytes())).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
    assert!(error.message.contains("`spread`"), "{error:?}");

    let spec = json!({"n": 19_999, "measures": measures});
    client.create("large", spec).await;
    let key = jostle_proto::keys::order(PREFIX, "large");
    let orders = client.session.declare_subscriber(key).await.unwrap();
    let address = http::of_daemon(&daemon);
    for (count, is_defined) in [(1, true), (1, false)] {
        client.ok("large", "inject", json!({"count": count})).await;
        let order = loop {
            let sample = tokio::time::timeout(TIMEOUT, orders.recv_async()).await;
            let sample = sample.expect("an order").unwrap();
            let order: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
            if order["measures"]["spread"].is_number() == is_defined {
                break order;
            }
        };
        assert!(order["measures"]["order"].is_number(), "{order}");
        assert_eq!(order["measures"]["spread"].is_null(), !is_defined);
        let mut metrics = String::new();
        let series = |metrics: &str, name: &str| {
            let labels = format!("jostle_swarm_measure{{swarm=\"large\",measure=\"{name}\"}} ");
            metrics.contains(&labels)
        };
        // On a busy machine the first reply may come before the measures are evaluated.
        until("measures in /metrics", async || {
            metrics = http::get(&address, "/metrics").2;
            series(&metrics, "order")
        })
        .await;
        assert_eq!(series(&metrics, "spread"), is_defined, "{metrics}");
    }
    let key = jostle_proto::keys::cmd(PREFIX, "large", "set");
    let args = json!({"measures": ["milling", "spread"]}).to_string();
    let error = client.query(&key, Some(args.as_bytes())).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
    assert!(error.message.contains("`spread`"), "{error:?}");
    let status = client.get("large", "status").await;
    assert_eq!(status["result"]["parameters"]["measures"], json!(measures));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_playback_has_measures_too() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let file = recorded_file(client).await;
    upload_and_open(client, "tape", &file).await.unwrap();
    let key = jostle_proto::keys::state(PREFIX, "tape");
    let state = client.query(&format!("{key}?format=json"), None).await;
    let [order, _] = order_and_milling(&state.unwrap());
    let value = values(client, "tape", "?names=order").await;
    let value = value[0].1.as_f64().unwrap();
    assert!((value - order).abs() < 1e-12, "{value}: {order}");
    daemon.stop().await;
}
