//! Statuses and states for tests, from the fixtures of the contract.

#![expect(clippy::unwrap_used, reason = "tests")]

use jostle_proto::{Phase, Reply, State, Status};

/// The status of the swarm `demo`, which has taken no step.
pub fn status() -> Reply<Status> {
    let text = include_str!("../../../proto/fixtures/status.reply.json");
    let status: Reply<Status> = serde_json::from_str(text).unwrap();
    reply(status.result)
}

/// A reply of the paused swarm `demo`.
pub fn reply<T>(result: T) -> Reply<T> {
    Reply {
        swarm: "demo".into(),
        epoch: 1,
        step: 0,
        time: 0.0,
        phase: Phase::Paused,
        seq: 4,
        result,
    }
}

/// A state of the swarm `demo`.
pub fn state() -> State {
    let text = include_str!("../../../proto/fixtures/state.json");
    let state = serde_json::from_str(text).unwrap();
    State {
        swarm: "demo".into(),
        ..state
    }
}
