//! Statuses, states and results for tests, from the fixtures of the contract and stored files.

#![expect(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use jostle_proto::{Phase, Reply, State, Status};
use jostle_results::{ResultRow, table};

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

/// The results of a run.
pub fn result_row() -> ResultRow {
    let stored = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/stored/bf41dde");
    let rows = table::read(&stored.join("results/results.csv"));
    rows.unwrap().swap_remove(0)
}
