//! Individuals whose turn and speed a controller sets directly.

use jostle_proto::ErrorCode;
use serde_json::{Value, json};

use super::{advance, join};
use crate::support::Daemon;

#[tokio::test(flavor = "multi_thread")]
async fn only_controllers_that_joined_with_driving_set_turn_and_speed() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let start = json!({"kind": "given", "x": [0.0, 20.0, 40.0], "y": [0.0, 0.0, 0.0],
        "alpha": [1.5, 1.5, 1.5]});
    client.create("a", json!({"n": 3, "start": start})).await;
    join(client, "ada", &[0, 1], json!({})).await;
    let still = json!({"steps": 50, "return": "state", "set": {"ids": [0, 1], "direction": [0, 0],
        "weight": [0, 0], "turn": [0.0, null], "speed": [0.0, 0.5]}});
    let error = advance(client, "ada", 0, still.clone()).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::InvalidArgument);
    assert!(error.message.contains("driving"), "{}", error.message);
    let again = json!({"again": true, "driving": true, "on_timeout": "free"});
    join(client, "ada", &[0, 1], again).await;
    for (field, wrong) in [("speed", json!([1.5, 0.0])), ("turn", json!([0.0]))] {
        let mut set = json!({"ids": [0, 1], "direction": [0, 0]});
        set[field] = wrong;
        let error = advance(client, "ada", 0, json!({"set": set}))
            .await
            .unwrap_err();
        assert_eq!(error.details["field"], format!("set.{field}"));
    }
    let reply = advance(client, "ada", 0, still).await.unwrap();
    let state = &reply["result"]["state"];
    let moved = |id: usize| {
        let [x, y] = ["x", "y"].map(|axis| state[axis][id].as_f64().unwrap());
        (x - 20.0 * id as f64).hypot(y)
    };
    assert_eq!(state["alpha"][0], 1.5, "it does not turn");
    assert_eq!(moved(0), 0.0, "it does not move");
    assert!(
        (moved(1) - 0.5).abs() < 0.01,
        "half the speed for one time unit"
    );
    assert!(moved(2) > 0.9, "by itself: {}", moved(2));
    let hash = client.hash("a").await;
    let verified = client.get("a", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null);
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    assert_eq!(client.hash("a").await, hash);
    client.ok("a", "leave", json!({"controller": "ada"})).await;
    let reply = client
        .ok("a", "step", json!({"steps": 50, "return": "state"}))
        .await;
    assert_ne!(
        reply["result"]["state"]["alpha"][0], 1.5,
        "on its own again"
    );
    daemon.stop().await;
}
