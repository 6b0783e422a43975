//! Every code an error can have, each provoked through a real session.

use std::collections::BTreeMap;

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::support::process::Process;
use crate::support::{Client, PREFIX, QueryResult, until};

/// The provocations of codes: the first from a daemon that fails at its first change and its 501st
/// step, and is slow before.
async fn provoke(client: &Client, code: ErrorCode) -> Option<QueryResult> {
    let long = json!({"timeout_secs": 0.05, "args": {"steps": 400}});
    let (verb, request) = match code {
        ErrorCode::NotFound => ("fly", json!({})),
        ErrorCode::AlreadyExists => {
            let request = json!({"name": "a", "spec": {"n": 4}}).to_string();
            let key = keys::node_cmd(PREFIX, "test", "create");
            return Some(client.query(&key, Some(request.as_bytes())).await);
        }
        ErrorCode::InvalidArgument => ("step", json!({"steps": 0})),
        ErrorCode::IncorrectState => {
            client.ok("a", "run", json!({"rate": 1})).await;
            let answer = client.cmd("a", "step", json!({})).await;
            client.ok("a", "pause", json!({})).await;
            return Some(answer);
        }
        ErrorCode::ResourceExhausted => {
            let name =
                json!({"name": "b", "spec": {"n": 2, "start": {"kind": "disc", "radius": 1e-3}}});
            let key = keys::node_cmd(PREFIX, "test", "create");
            return Some(client.query(&key, Some(name.to_string().as_bytes())).await);
        }
        ErrorCode::Busy => return Some(too_much().await),
        ErrorCode::Conflict => ("pause", json!({"expect_epoch": 7})),
        ErrorCode::DeadlineExceeded => ("step", long),
        ErrorCode::Faulted => ("step", json!({"timeout_secs": 30, "args": {"steps": 1000}})),
        ErrorCode::Internal => ("set", json!({"pi3": 2})),
        // These take a full disk, people and two daemons: `crash::disk`, `rights` and `contested`
        // have them.
        ErrorCode::StorageFull | ErrorCode::PermissionDenied | ErrorCode::Contested => return None,
    };
    Some(client.cmd("a", verb, request).await)
}

/// Sends more queries at once than the queue holds, to a daemon that is slow to read them.
async fn too_much() -> QueryResult {
    let (_daemon, endpoint) = Process::serve_failing("query=sleep(5)");
    let client = Client::open(&endpoint).await;
    let key = keys::node_get(PREFIX, "test", "hello");
    let mut asked = Vec::new();
    for _ in 0..300 {
        asked.push(client.session.get(&key).await.unwrap());
    }
    for replies in asked {
        while let Ok(reply) = replies.recv_async().await {
            if let Err(error) = reply.into_result() {
                return Err(serde_json::from_slice(&error.payload().to_bytes()).unwrap());
            }
        }
    }
    Ok(Value::Null)
}

#[tokio::test(flavor = "multi_thread")]
async fn every_code_that_can_occur_is_provoked() {
    let (_daemon, endpoint) = Process::serve_failing("command=panic;step=500*sleep(1)->panic");
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 4, "rate": null})).await;
    // The last ones change what the swarm does, so they come in this order.
    let codes = [
        ErrorCode::NotFound,
        ErrorCode::AlreadyExists,
        ErrorCode::InvalidArgument,
        ErrorCode::ResourceExhausted,
        ErrorCode::Busy,
        ErrorCode::Conflict,
        ErrorCode::PermissionDenied,
        ErrorCode::StorageFull,
        ErrorCode::Contested,
        ErrorCode::Internal,
        ErrorCode::IncorrectState,
        ErrorCode::DeadlineExceeded,
        ErrorCode::Faulted,
    ];
    let mut provoked = BTreeMap::new();
    for code in codes {
        if let Some(answer) = provoke(&client, code).await {
            let error = answer.unwrap_err();
            assert_eq!(error.code, code, "{error:?}");
            assert!(!error.message.is_empty());
            provoked.insert(format!("{code:?}"), error.message);
        }
        until("the swarm to stand still", async || {
            client.get("a", "status").await["phase"] != "running"
        })
        .await;
    }
    // As many as the schema lists, less the three.
    let schema = &jostle_proto::contract::schemas()["error"]
        .clone()
        .to_value();
    let listed = schema["$defs"]["ErrorCode"]["oneOf"].as_array().unwrap();
    assert_eq!(provoked.len() + 3, listed.len(), "{provoked:#?}");
}
