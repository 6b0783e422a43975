//! Why a request is rejected.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// An error. Clients branch on `code`; `message` has the remedy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Error {
    /// The kind of error, such as `conflict`.
    pub code: ErrorCode,
    /// For people: what is wrong, and the remedy.
    pub message: String,
    /// For programs, such as `field` and `range`; may be empty.
    #[serde(default)]
    pub details: serde_json::Map<String, serde_json::Value>,
    /// The swarm's step at that time; `null` if it concerns no swarm.
    #[serde(default)]
    pub step: Option<u64>,
}

impl Error {
    /// Returns the error as that of the part at `path` of an argument: its field becomes a path.
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
    /// The swarm, noun or verb does not exist.
    NotFound,
    /// A swarm of this name with another spec exists.
    AlreadyExists,
    /// The request is invalid in every state of the swarm.
    InvalidArgument,
    /// The request is not allowed in this phase.
    IncorrectState,
    /// A limit of the daemon is exceeded.
    ResourceExhausted,
    /// Too many requests at once; retry.
    Busy,
    /// The swarm is not at the step or epoch that the request expects.
    Conflict,
    /// Two daemons serve this name: neither executes the request.
    Contested,
    /// The client has no permission.
    PermissionDenied,
    /// The disk is full.
    StorageFull,
    /// Not executed within `timeout_secs`; the message states whether the daemon continues with it.
    DeadlineExceeded,
    /// The swarm faulted while the command ran.
    Faulted,
    /// The daemon has a defect.
    Internal,
}

/// Maximum length of a field's path that an error repeats, in characters.
const MAX_PATH_CHARS: usize = 100;

/// Maximum length of the problem in an error, in characters.
const MAX_PROBLEM_CHARS: usize = 400;

/// A request that cannot be read: which field and what is wrong with it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RequestError {
    /// The field, as a path such as `spec.start.x[3]`; empty for the request as a whole.
    pub field: String,
    /// What is wrong with it.
    pub problem: String,
}

impl RequestError {
    /// The error of a field; both texts are truncated.
    pub(crate) fn new(field: &str, problem: &str) -> Self {
        RequestError {
            field: truncate(field, MAX_PATH_CHARS),
            problem: truncate(problem, MAX_PROBLEM_CHARS),
        }
    }
}

impl fmt::Display for RequestError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.field.is_empty() {
            formatter.write_str(&self.problem)
        } else {
            write!(formatter, "{}: {}", self.field, self.problem)
        }
    }
}

impl std::error::Error for RequestError {}

/// Returns the path of a field of the object at `path`.
pub(crate) fn below(path: &str, name: &str) -> String {
    if path.is_empty() {
        name.to_owned()
    } else {
        format!("{path}.{name}")
    }
}

/// Returns the first `limit` characters. An error does not repeat long input.
fn truncate(text: &str, limit: usize) -> String {
    match text.char_indices().nth(limit) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}
