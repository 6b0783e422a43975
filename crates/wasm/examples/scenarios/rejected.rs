//! Requests that are rejected: the texts and the codes are the same everywhere, too.

use serde_json::json;

use crate::scenario::Scenario;

/// Returns scenarios of invalid requests, between valid ones.
pub fn all() -> impl Iterator<Item = Scenario> {
    let mut scenario = Scenario::new(&json!({"step": {"steps": 1}}));
    for request in [
        json!({"run": {"run": 0}}),
        json!({"advance": {"steps": 1}}),
        json!({"fly": {}}),
        json!(["step"]),
        json!(null),
        json!({"create": {"spec": {"n": 0}}}),
        json!({"create": {"spec": {"n": 4_000_000_000u64}}}),
        json!({"create": {"spec": {"n": 10, "pi1": 0.5}}}),
        json!({"create": {"spec": {"n": 10, "dt": 1e300}}}),
        json!({"create": {"spec": {"n": 10, "pi1": 3, "size": 1}}}),
        json!({"create": {"spec": {"n": 2, "start": {"kind": "given", "x": [0, 0], "y": [0, 0], "alpha": [0, 1]}}}}),
        json!({"create": {"spec": {"n": 200, "start": {"kind": "disc", "radius": 0.5}}}}),
        json!({"restore": {"snapshot": "no base64"}}),
        json!({"restore": {"snapshot": "aGVsbG8="}}),
        json!({"plan": {"toml": "name = \"a\"\nduration = -1\nspec = { n = 10 }\n"}}),
        json!({"plan": {"toml": "name = \"a\"\nduration = 1\nspec = { n = ten }\n"}}),
        json!({"create": {"spec": {"n": 20, "seed": 7}}}),
        json!({"step": {"steps": -1}}),
        json!({"step": {"steps": 20}}),
        json!({"apply": {"change": {"verb": "inform", "args": {"select": {"ids": [99]}, "direction": 0}}}}),
        json!({"apply": {"change": {"verb": "remove", "args": {"select": {"fraction": 1}}}}}),
        json!({"apply": {"change": {"verb": "inject", "args": {"at": [{"x": 0, "y": 1e9, "alpha": 0}]}}}}),
        json!({"apply": {"change": {"verb": "inject", "args": {"count": 1, "within": {"x": 0, "y": 0, "radius": -1}}}}}),
        json!({"apply": {"change": {"verb": "set", "args": {}}}}),
        json!({"apply": {"change": {"verb": "set", "args": {"relinearise": 1, "stepping": "velocity"}}}}),
        json!({"steer": {"ids": [1, 1], "direction": [0, 0]}}),
        json!({"steer": {"ids": [1], "direction": [0], "speed": [2]}}),
        json!({"measures": {"measures": ["order", "disorder"]}}),
        json!({"measures": {"measures": ["msd(5)"]}}),
        json!({"run": {"run": 0}}),
        json!({"step": {"steps": 20}}),
    ] {
        scenario.send(&request);
    }
    for text in [
        r#"{"step": {"steps": 1e400}}"#,
        r#"{"step": {"steps": 1}, "status": {}}"#,
    ] {
        scenario.send_text(text.to_owned());
    }
    std::iter::once(scenario)
}
