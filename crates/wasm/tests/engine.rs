//! What an engine holds between requests.

use jostle_wasm::Engine;
use serde_json::{Value, json};

/// Sends a request; returns the reply.
fn send(engine: &mut Engine, request: &Value) -> Value {
    let reply = engine.request(&request.to_string());
    serde_json::from_str(&reply).expect("a reply is JSON")
}

/// Checks that the engine rejects requests, and then holds what it held.
fn check_unchanged_by(engine: &mut Engine, requests: &[Value]) {
    let before = send(engine, &json!({"status": {}}));
    assert!(before["ok"]["step"].is_u64(), "{before}");
    for request in requests {
        let reply = send(engine, request);
        assert!(reply["error"]["code"].is_string(), "{request}: {reply}");
        assert_eq!(send(engine, &json!({"status": {}})), before, "{request}");
    }
}

#[test]
fn a_request_that_is_rejected_leaves_the_swarm_or_the_run_as_it_was() {
    let rejected = [
        json!({"create": {"spec": {"n": 0}}}),
        json!({"restore": {"snapshot": "aGVsbG8="}}),
        json!({"plan": {"toml": "name = 'a'\nduration = -1\nspec = { n = 3 }\n"}}),
        json!({"plan": {"toml": "", "start": "no base64"}}),
        json!({"run": {"run": 7}}),
        json!({"apply": {"change": {"verb": "set", "args": {}}}}),
        json!({"measures": {"measures": ["disorder"]}}),
    ];
    let mut engine = Engine::new();
    send(
        &mut engine,
        &json!({"create": {"spec": {"n": 3, "seed": 7}}}),
    );
    send(&mut engine, &json!({"step": {"steps": 5}}));
    check_unchanged_by(&mut engine, &rejected);
    let toml = "name = 'a'\nduration = 1\nspec = { n = 3 }\n";
    send(&mut engine, &json!({"plan": {"toml": toml}}));
    send(&mut engine, &json!({"run": {"run": 0}}));
    send(&mut engine, &json!({"advance": {"steps": 5}}));
    check_unchanged_by(&mut engine, &rejected);
    let last = send(&mut engine, &json!({"advance": {"steps": 100}}));
    assert_eq!(last["ok"]["step"], 50, "{last}");
}
