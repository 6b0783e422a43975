//! Requests and replies.

use jostle_convert::{ArgsError, MeasuresError, SnapshotError, WireCode, WireError};
use jostle_experiment::{EncodedFiles, PlanError};
use jostle_physics::simulation::ChangeError;
use jostle_proto::verbs::{Change, Changed, SetPoints};
use jostle_proto::{ErrorCode, Spec};
use serde::{Deserialize, Serialize};

/// A request: an object with one field, which names it and has its arguments.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// The versions of the engine.
    Version {},
    /// Creates a swarm in place of what the engine holds.
    Create { spec: Box<Spec> },
    /// Restores a swarm from a snapshot: its CBOR, in base64.
    Restore { snapshot: String },
    /// The snapshot of the swarm.
    Snapshot {},
    /// Changes the swarm, as the command with the number `seq`; by default the one after the last.
    Apply { change: Change, seq: Option<u64> },
    /// Sets directions, weights and drives, as a controller does.
    Steer(SetPoints),
    /// Takes steps of the swarm.
    Step { steps: u64 },
    /// The status of the swarm or of the run.
    Status {},
    /// Measures of the swarm or of the run, by name.
    Measures { measures: Vec<String> },
    /// Reads an experiment, in place of what the engine holds.
    Plan(EncodedFiles),
    /// The spec of a run, by its index.
    Spec { run: usize },
    /// Begins a run of the experiment, by its index.
    Run { run: usize },
    /// Takes steps of the run.
    Advance { steps: u64 },
}

/// A reply: an object with one field, `ok` or `error`. What the engine holds is unchanged by a request
/// that is rejected.
pub type Reply = Result<Answer, Rejection>;

/// Returns a reply as JSON.
pub fn to_json(reply: &Reply) -> String {
    let text = match reply {
        Ok(answer) => serde_json::to_string(&Envelope::Ok(answer)),
        Err(rejection) => serde_json::to_string(&Envelope::Error(rejection)),
    };
    text.expect("a reply is JSON")
}

#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
enum Envelope<'a> {
    Ok(&'a Answer),
    Error(&'a Rejection),
}

/// A result.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Answer {
    /// Of `version`.
    Version {
        /// Of this program.
        version: &'static str,
        /// Of the model: equal versions compute equal steps.
        model_version: u32,
        /// What it was compiled for.
        target: &'static str,
    },
    /// Of `create`, `restore`, `step`, `status` and `run`.
    Status(Status),
    /// Of `snapshot`.
    Snapshot {
        /// The CBOR, in base64.
        snapshot: String,
    },
    /// Of `apply`.
    Changed(Changed),
    /// Of `steer`.
    Steered {
        /// The number of individuals.
        n: usize,
    },
    /// Of `measures`, in their order; null where a measure is undefined.
    Measures {
        /// The values.
        values: Vec<Option<f64>>,
    },
    /// Of `plan`.
    Plan {
        /// The name of the experiment.
        name: String,
        /// Its runs.
        runs: Vec<RunEntry>,
    },
    /// Of `spec`.
    Spec {
        /// With its defaults, and the seed of the run.
        spec: Box<Spec>,
    },
    /// Of `advance`.
    Advanced(Advanced),
}

/// A state of a swarm or of a run.
#[derive(Debug, Serialize)]
pub struct Status {
    /// The number of steps taken.
    pub step: u64,
    /// The time, in body sizes over the free speed.
    pub time: f64,
    /// The number of individuals.
    pub n: usize,
    /// The length over the width of a body.
    pub pi1: f64,
    /// The hash of the state, 64 hexadecimal digits.
    pub state_hash: String,
    /// The length of the mean heading.
    pub order: f64,
    /// The speed of the centroid along the common direction, in free speeds.
    pub drift: Option<f64>,
    /// The mean order over the steps.
    pub mean_order: Option<f64>,
    /// The residual of the last step, in body sizes.
    pub residual: f64,
    /// The number of contacts of the last step's program.
    pub contacts: usize,
    /// The number of linear systems that were factored for it.
    pub iterations: usize,
    /// The number of steps that missed the target residual.
    pub degraded: u64,
    /// Why the swarm or the run ended early.
    pub fault: Option<String>,
}

/// A run of an experiment.
#[derive(Debug, Serialize)]
pub struct RunEntry {
    /// Its name.
    pub name: String,
    /// The number of its steps, at most.
    pub steps: u64,
    /// The number of individuals at its start.
    pub n: usize,
}

/// A run after some steps.
#[derive(Debug, Serialize)]
pub struct Advanced {
    /// The state.
    #[serde(flatten)]
    pub status: Status,
    /// Whether the run has ended.
    pub finished: bool,
    /// Its row in the table of results, as JSON; null before its end, and if it has none.
    pub row: Option<Box<jostle_results::ResultRow>>,
    /// The table of results with this row only, as CSV.
    pub csv: Option<String>,
}

/// Why a request is rejected.
#[derive(Debug, Serialize)]
pub struct Rejection {
    /// What programs branch on.
    pub code: ErrorCode,
    /// What is wrong, and the remedy.
    pub message: String,
    /// For programs.
    pub details: serde_json::Map<String, serde_json::Value>,
}

impl Rejection {
    /// Returns the rejection of a request that is wrong in itself.
    pub fn invalid(message: &impl ToString) -> Self {
        Self::of(ErrorCode::InvalidArgument, message)
    }

    /// Returns the rejection of a request that does not fit what the engine holds.
    pub fn of(code: ErrorCode, message: &impl ToString) -> Self {
        Self {
            code,
            message: message.to_string(),
            details: serde_json::Map::new(),
        }
    }
}

/// The code and the message of an error. The details that the daemon adds, such as ranges, would bring the
/// schemas of all messages into the module.
fn coded(error: &(impl WireCode + ToString)) -> Rejection {
    Rejection::of(error.code(), error)
}

impl From<WireError> for Rejection {
    fn from(error: WireError) -> Self {
        coded(&error)
    }
}

impl From<ChangeError> for Rejection {
    fn from(error: ChangeError) -> Self {
        coded(&error)
    }
}

impl From<MeasuresError> for Rejection {
    fn from(error: MeasuresError) -> Self {
        coded(&error)
    }
}

impl From<ArgsError> for Rejection {
    fn from(error: ArgsError) -> Self {
        Self::invalid(&error)
    }
}

impl From<SnapshotError> for Rejection {
    fn from(error: SnapshotError) -> Self {
        Self::invalid(&error)
    }
}

impl From<&PlanError> for Rejection {
    fn from(error: &PlanError) -> Self {
        let mut rejection = Self::invalid(error);
        if let PlanError::Field { line, column, .. }
        | PlanError::Points { line, column, .. }
        | PlanError::SetPoints { line, column, .. } = error
        {
            rejection.details.insert("line".to_owned(), (*line).into());
            rejection
                .details
                .insert("column".to_owned(), (*column).into());
        }
        rejection
    }
}
