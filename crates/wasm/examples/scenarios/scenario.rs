//! A scenario that is executed as it is made.

use jostle_wasm::Engine;
use serde_json::{Value, json};

/// Requests, and the replies of the native engine.
#[derive(Default)]
pub struct Scenario {
    /// The requests, as JSON.
    pub requests: Vec<String>,
    /// The replies, as JSON.
    pub replies: Vec<String>,
    engine: Engine,
}

impl Scenario {
    /// Begins a scenario with a request.
    pub fn new(first: &Value) -> Self {
        let mut scenario = Self::default();
        scenario.send(first);
        scenario
    }

    /// Adds a request; returns the reply.
    pub fn send(&mut self, request: &Value) -> Value {
        self.send_text(request.to_string())
    }

    /// Adds a request as text, which may not be valid, but must be JSON.
    pub fn send_text(&mut self, request: String) -> Value {
        let reply = self.engine.request(&request);
        self.requests.push(request);
        self.replies.push(reply);
        self.replies
            .last()
            .and_then(|it| serde_json::from_str(it).ok())
            .unwrap_or_default()
    }

    /// Takes steps in slices.
    pub fn step(&mut self, steps: u64, slice: u64) {
        let mut left = steps;
        while left > 0 {
            let now = slice.min(left);
            self.send(&json!({"step": {"steps": now}}));
            left -= now;
        }
    }

    /// Returns the ids of the individuals.
    pub fn ids(&self) -> &[u32] {
        self.engine.ids()
    }

    /// Returns a scenario that continues this one from its snapshot.
    pub fn continued(&mut self) -> Self {
        let reply = self.send(&json!({"snapshot": {}}));
        Self::new(&json!({"restore": {"snapshot": reply["ok"]["snapshot"]}}))
    }
}
