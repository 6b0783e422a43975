//! Why a request was refused.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A refused or failed request. Clients branch on `code`; `message` says the remedy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Error {
    /// The kind.
    pub code: ErrorCode,
    /// For people: what is wrong and what to do.
    pub message: String,
    /// For programs: such as `field` and `range`.
    #[serde(default)]
    pub details: serde_json::Map<String, serde_json::Value>,
    /// The swarm's step when it happened; `null` if it was about no swarm.
    #[serde(default)]
    pub step: Option<u64>,
}

impl Error {
    /// The same error, of something within a larger argument: the field it names becomes a path.
    #[must_use]
    pub fn within(mut self, path: &str) -> Self {
        self.message = format!("{path}: {}", self.message);
        let field = match self.details.get("field").and_then(|it| it.as_str()) {
            Some("args") if path.ends_with(".args") => path.to_owned(),
            Some(field) => format!("{path}.{field}"),
            None => path.to_owned(),
        };
        self.details.insert("field".into(), field.into());
        self
    }
}

/// The kinds of errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ErrorCode {
    /// No such swarm, or no such noun or verb.
    NotFound,
    /// The name is taken by a swarm with another spec.
    AlreadyExists,
    /// The request is wrong, whatever the swarm's state.
    InvalidArgument,
    /// The request is right, but not in this phase.
    IncorrectState,
    /// A limit of the daemon.
    ResourceExhausted,
    /// Too much at once; try again.
    Busy,
    /// The swarm is not at the step or epoch the request expects.
    Conflict,
    /// Two daemons hold this name: neither executes the request.
    Contested,
    /// Not with these rights.
    PermissionDenied,
    /// The disk is full.
    StorageFull,
    /// Not done within `timeout_secs`; the work goes on.
    DeadlineExceeded,
    /// The swarm faulted while the command ran.
    Faulted,
    /// A defect of the daemon.
    Internal,
}
