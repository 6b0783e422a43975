//! Why a request is rejected, and the error reply.

mod jobs;
mod models;
mod swarm;

use jostle_conditions::ConditionError;
use jostle_convert::error::{named, object};
use jostle_convert::{ArgsError, MeasuresError, Place, WireCode, WireError};
use jostle_physics::simulation::ChangeError;
use jostle_proto::contract::selectors::QueryParameter;
use jostle_proto::role::rejection;
use jostle_proto::{Claimant, Error, ErrorCode, RequestError, claim, keys};
use serde_json::{Map, Value, json};
use thiserror::Error as ThisError;

use crate::auth::NotPermitted;
use crate::experiments::ExperimentError;
use crate::persistence::limits::LimitError;
use crate::playback::ReplayError;
use crate::recording::RecordError;
use crate::store::StoreError;
use crate::swarm::error::SwarmError;
use crate::swarm::recovery_progress::still_left;
use crate::swarm::registry::RegistryError;

pub use models::EarlierModelError;

/// What separates the parameters of a query.
const SEPARATORS: &str = "separate parameters with `;`, over HTTP with `&`";

/// Why a request is rejected.
#[derive(Clone, Debug, ThisError)]
#[expect(missing_docs, reason = "the messages say when each is returned")]
pub enum CommandError {
    #[error("{0}")]
    Request(#[from] RequestError),
    #[error(transparent)]
    Value(#[from] WireError),
    #[error("{field} {problem}")]
    Field {
        field: &'static str,
        problem: &'static str,
    },
    /// Perhaps since another separator made the next parameter a part of it.
    #[error("{field} is not {expected}; {SEPARATORS}")]
    Unreadable {
        field: &'static str,
        expected: &'static str,
    },
    #[error("limit is not a whole number from 1 to {max}; {SEPARATORS}")]
    PageLimit { max: usize },
    #[error(
        "timeout_secs of a wait is not a number above 0 and at most {max}: repeat the wait to wait longer"
    )]
    WaitTimeout { max: u64 },
    #[error("condition: {0}")]
    Condition(#[from] ConditionError),
    #[error("condition: {0}")]
    NeverHolds(String),
    #[error("invalid {field} {name:?}")]
    Name {
        field: &'static str,
        /// At most the first 64 characters of the name.
        name: String,
    },
    #[error("n = {n} is outside its range: give a whole number from 1 to {limit}")]
    Individuals { n: u64, limit: usize },
    #[error("unknown parameter {name:?}")]
    Parameter {
        /// As received.
        name: String,
        known: &'static [QueryParameter],
    },
    #[error("{0} is given twice: give it once")]
    Twice(&'static str),
    #[error("the request has {bytes} bytes, the maximum is {max_bytes}: send less at once")]
    TooLong { bytes: usize, max_bytes: usize },
    #[error("the payload is {0:?}: requests are application/json")]
    Encoding(String),
    #[error("a wildcard executes nothing: send the command to one concrete key")]
    Wildcard,
    #[error("there is no verb {verb:?}")]
    UnknownVerb {
        /// As received.
        verb: String,
        known: &'static [&'static str],
    },
    #[error("there is no {noun:?} to get")]
    UnknownNoun {
        /// As received.
        noun: String,
        known: &'static [&'static str],
    },
    #[error("there is no swarm {0:?}: the node's get/swarms lists what there is")]
    UnknownSwarm(String),
    /// A part of an argument is invalid.
    #[error("{path}: {error}")]
    Within {
        /// The path of the part, such as `commands[2].args`.
        path: String,
        error: Box<CommandError>,
    },
    #[error(
        "request_id {0:?} was given to another request of this client: give each request one of \
         its own"
    )]
    OtherRequest(String),
    #[error("not a snapshot that this daemon can restore: {0}")]
    Snapshot(String),
    #[error(
        "the snapshot has {bytes} bytes, the maximum of one message is {max_bytes}: fork \
         the swarm on this daemon, or stop the daemon and copy its data folder"
    )]
    SnapshotTooLong { bytes: usize, max_bytes: usize },
    #[error(
        "the file with the set-points of its controllers has {bytes} bytes as JSON, the maximum of \
         one message is {max_bytes}: export the swarm after fewer set-points"
    )]
    ExportTooLong { bytes: usize, max_bytes: usize },
    #[error("step {step} is not reached, the swarm is at step {now}: name an earlier one")]
    NotReached { step: u64, now: u64 },
    #[error("the history of the swarm cannot be replayed: {0}")]
    History(String),
    #[error(transparent)]
    EarlierModel(#[from] EarlierModelError),
    #[error(transparent)]
    Limit(#[from] LimitError),
    #[error("the store cannot be read: {0}")]
    Store(String),
    #[error(transparent)]
    NotPermitted(#[from] NotPermitted),
    /// Another daemon serves the same name and has executed commands on it.
    #[error("{}", claim::rejection(swarm.as_deref(), claimants).message)]
    Contested {
        /// The swarm; `None` for the daemon's own name.
        swarm: Option<String>,
        claimants: [Claimant; 2],
    },
    #[error(
        "daemon {0:?} claims this name: choose another name, or delete the swarm of this name there"
    )]
    Claimed(String),
    /// A controller joins without the token by which the daemon learns that its client is gone.
    #[error(
        "controller {controller} does not hold its liveliness token: declare {key} in a zenoh session that \
         stays open, then send `join` again"
    )]
    NoToken { controller: String, key: String },
    /// The daemon has a defect.
    #[error("a defect of the daemon: nothing was changed; please report what you sent")]
    Internal,
    /// The request was dropped without a reply.
    #[error(
        "a defect of the daemon dropped the request; whether it was executed is unknown: look at get/journal, \
         and send it with another request_id if it was not"
    )]
    Dropped,
    #[error(
        "more than the daemon's {} connected: close one, or raise max_clients and start it again",
        match .limit {
            1 => "1 client is".to_owned(),
            limit => format!("{limit} clients are"),
        }
    )]
    TooManyClients { limit: usize },
    #[error("too much at once for this daemon: try again in a moment")]
    Busy,
    #[error(
        "this daemon checks with others which of them serves the name, after a router closed or \
         the machine was suspended: try again in half a second"
    )]
    HandingOver,
    /// Its reply could be wrong before every swarm of the previous run is recovered.
    #[error(
        "this daemon has started and recovers its swarms{}, so it executes nothing that depends on \
         them: try again in a moment",
        still_left(*.swarms_left)
    )]
    Recovering { swarms_left: usize },
    #[error("not done within {} s: {remedy}", rounded(*.after_secs))]
    Deadline {
        after_secs: f64,
        /// What becomes of it, and what to do.
        remedy: &'static str,
    },
    #[error("condition not met within {} s: retry", rounded(*.after_secs))]
    NotYet { after_secs: f64 },
    #[error(transparent)]
    Registry(#[from] RegistryError),
    #[error(transparent)]
    Swarm(#[from] SwarmError),
    #[error(transparent)]
    Replay(#[from] ReplayError),
    #[error(transparent)]
    Experiment(#[from] ExperimentError),
    #[error(transparent)]
    Record(#[from] RecordError),
    #[error(transparent)]
    Measures(#[from] MeasuresError),
}

/// The path of the arguments of a change in a batch.
pub fn args_of_change(index: usize) -> String {
    format!("commands[{index}].args")
}

/// The names of parameters.
fn names(parameters: &[QueryParameter]) -> Vec<&'static str> {
    parameters.iter().map(|it| it.name).collect()
}

/// Seconds as people read them: three digits, and whole ones from 100 on.
fn rounded(secs: f64) -> f64 {
    let decimals = (2.0 - secs.log10().floor()).clamp(0.0, 9.0);
    let unit = 10_f64.powf(decimals);
    (secs * unit).round() / unit
}

impl From<StoreError> for CommandError {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::NoSwarm(name) => CommandError::UnknownSwarm(name),
            error => CommandError::Store(error.to_string()),
        }
    }
}

impl CommandError {
    /// A field is invalid: what is wrong with it, and the remedy.
    pub fn field(field: &'static str, problem: &'static str) -> Self {
        CommandError::Field { field, problem }
    }

    /// A command of a swarm was not executed within `after_secs`.
    pub fn deadline(after_secs: f64) -> Self {
        let remedy =
            "the work goes on; get/wait replies when it is done, timeout_secs waits longer";
        CommandError::Deadline { after_secs, remedy }
    }

    /// A command of the daemon was not executed within `after_secs`.
    pub fn node_deadline(after_secs: f64) -> Self {
        let remedy = "the work goes on; the same request gets the reply if it has a request_id, \
                      timeout_secs waits longer";
        CommandError::Deadline { after_secs, remedy }
    }

    /// A command that creates a swarm, without an id, was not executed within `after_secs`.
    pub fn ended(after_secs: f64) -> Self {
        let remedy = "it has ended and created nothing; timeout_secs waits longer, and with a request_id \
                      it goes on";
        CommandError::Deadline { after_secs, remedy }
    }

    /// A query got no reply within `after_secs`.
    pub fn read_deadline(after_secs: f64) -> Self {
        let remedy = "the daemon or the swarm is busy; send the query again";
        CommandError::Deadline { after_secs, remedy }
    }

    /// A verification took longer than `after_secs`.
    pub fn verify_deadline(after_secs: f64) -> Self {
        let remedy = "the replay has ended; timeout_secs waits longer";
        CommandError::Deadline { after_secs, remedy }
    }

    /// The condition of a `wait` did not become true within `after_secs`.
    pub fn not_yet(after_secs: f64) -> Self {
        CommandError::NotYet { after_secs }
    }

    /// Returns the error as that of the part at `path` of an argument.
    #[must_use]
    pub fn within(self, path: String) -> Self {
        CommandError::Within {
            path,
            error: Box::new(self),
        }
    }

    /// Returns the error reply; `step` is the current step of the swarm, `place` that of the fields that the
    /// error names.
    pub fn to_wire(&self, step: Option<u64>, place: &Place) -> Error {
        if let CommandError::Within { path, error } = self {
            return error.to_wire(step, &place.within(path)).within(path);
        }
        if let CommandError::Swarm(SwarmError::InBatch { index, error }) = self {
            let path = args_of_change(*index);
            let error = CommandError::Swarm((**error).clone());
            let mut error = error.to_wire(step, &place.within(&path)).within(&path);
            error.message.push_str("; none of the batch was applied");
            return error;
        }
        let details = self.details(place);
        let mut message = self.to_string();
        match (&self, details.get("range")) {
            (CommandError::Request(_) | CommandError::Value(_), Some(range)) => {
                let range = range.as_str().unwrap_or_default();
                message = format!("{message}: give {range}");
            }
            (CommandError::Name { .. }, _) => {
                message = format!(
                    "{message}: names are 1 to {} of a-z, 0-9, - and _, the first a letter or digit",
                    keys::MAX_NAME_LENGTH
                );
            }
            (CommandError::UnknownVerb { known, .. }, _)
            | (CommandError::UnknownNoun { known, .. }, _) => {
                message = format!("{message}: there are {}", known.join(", "));
            }
            (CommandError::Parameter { known, .. }, _) => {
                let known = match known {
                    [] => "none".to_owned(),
                    known => names(known).join(", "),
                };
                message = format!("{message}: there are {known}");
            }
            _ => {}
        }
        Error {
            code: self.code(),
            message,
            details,
            step,
        }
    }
}

impl WireCode for CommandError {
    fn code(&self) -> ErrorCode {
        match self {
            CommandError::Request(error) => error.code(),
            CommandError::Value(error) => error.code(),
            CommandError::Within { error, .. } => error.code(),
            CommandError::NotPermitted(error) => error.code(),
            CommandError::Registry(error) => error.code(),
            CommandError::Swarm(error) => error.code(),
            CommandError::Replay(error) => error.code(),
            CommandError::Experiment(error) => error.code(),
            CommandError::Record(error) => error.code(),
            CommandError::Measures(error) => error.code(),
            CommandError::Field { .. }
            | CommandError::Unreadable { .. }
            | CommandError::PageLimit { .. }
            | CommandError::WaitTimeout { .. }
            | CommandError::Condition(_)
            | CommandError::NeverHolds(_)
            | CommandError::Name { .. }
            | CommandError::Individuals { .. }
            | CommandError::Parameter { .. }
            | CommandError::Twice(_)
            | CommandError::Encoding(_)
            | CommandError::Wildcard
            | CommandError::Snapshot(_) => ErrorCode::InvalidArgument,
            CommandError::UnknownVerb { .. }
            | CommandError::UnknownNoun { .. }
            | CommandError::UnknownSwarm(_) => ErrorCode::NotFound,
            CommandError::OtherRequest(_)
            | CommandError::NotReached { .. }
            | CommandError::History(_)
            | CommandError::EarlierModel(_) => ErrorCode::Conflict,
            CommandError::NoToken { .. } => ErrorCode::IncorrectState,
            CommandError::Contested { .. } => ErrorCode::Contested,
            CommandError::Claimed(_) => ErrorCode::AlreadyExists,
            CommandError::Internal | CommandError::Dropped | CommandError::Store(_) => {
                ErrorCode::Internal
            }
            CommandError::TooLong { .. }
            | CommandError::SnapshotTooLong { .. }
            | CommandError::ExportTooLong { .. }
            | CommandError::Limit(_)
            | CommandError::TooManyClients { .. } => ErrorCode::ResourceExhausted,
            CommandError::Busy | CommandError::HandingOver | CommandError::Recovering { .. } => {
                ErrorCode::Busy
            }
            CommandError::Deadline { .. } | CommandError::NotYet { .. } => {
                ErrorCode::DeadlineExceeded
            }
        }
    }

    fn details(&self, place: &Place) -> Map<String, Value> {
        match self {
            CommandError::Request(error) => error.details(place),
            CommandError::Value(error) => error.details(place),
            CommandError::NotPermitted(error) => error.details(place),
            CommandError::Registry(error) => error.details(place),
            CommandError::Swarm(error) => error.details(place),
            CommandError::Replay(error) => error.details(place),
            CommandError::Experiment(error) => error.details(place),
            CommandError::Record(error) => error.details(place),
            CommandError::Measures(error) => error.details(place),
            CommandError::Field { field, .. } | CommandError::Unreadable { field, .. } => {
                named(field, Value::Null, place.range(field))
            }
            CommandError::PageLimit { .. } => named("limit", Value::Null, place.range("limit")),
            CommandError::WaitTimeout { .. } => {
                named("timeout_secs", Value::Null, place.range("timeout_secs"))
            }
            CommandError::Condition(error) => {
                object(json!({"field": "condition", "column": error.column}))
            }
            CommandError::NeverHolds(_) => object(json!({"field": "condition"})),
            CommandError::Name { field, name } => named(field, json!(name), Some(keys::NAME_RULE)),
            CommandError::Individuals { n, limit } => {
                object(json!({"field": "n", "value": n, "range": format!("[1, {limit}]")}))
            }
            CommandError::Contested { swarm, claimants } => {
                claim::rejection(swarm.as_deref(), claimants).details
            }
            CommandError::NoToken { controller, key } => {
                object(json!({"field": "controller", "value": controller, "token": key}))
            }
            CommandError::Claimed(node) => object(json!({"node": node})),
            CommandError::EarlierModel(error) => error.details(),
            CommandError::Snapshot(_) => named("snapshot", Value::Null, place.range("snapshot")),
            CommandError::Parameter { name, known } => {
                object(json!({"field": name, "known": names(known)}))
            }
            CommandError::Twice(name) => object(json!({"field": name})),
            CommandError::TooLong { bytes, max_bytes }
            | CommandError::SnapshotTooLong { bytes, max_bytes }
            | CommandError::ExportTooLong { bytes, max_bytes } => {
                object(json!({"bytes": bytes, "limit": max_bytes}))
            }
            CommandError::UnknownVerb { known, .. } | CommandError::UnknownNoun { known, .. } => {
                object(json!({"known": known}))
            }
            CommandError::Deadline { after_secs, .. } | CommandError::NotYet { after_secs } => {
                object(json!({"after_secs": after_secs}))
            }
            CommandError::Limit(LimitError::Membership { verb, retry_secs }) => {
                object(json!({"verb": verb, "retry_secs": retry_secs}))
            }
            CommandError::Limit(LimitError::Rate { retry_secs }) => {
                object(json!({"retry_secs": retry_secs}))
            }
            CommandError::HandingOver => object(json!({"reason": "handover"})),
            CommandError::Recovering { swarms_left } => {
                object(json!({"reason": "recovering", "swarms_left": swarms_left}))
            }
            CommandError::TooManyClients { limit } => object(json!({"limit": limit})),
            CommandError::OtherRequest(id) => object(json!({"field": "request_id", "value": id})),
            _ => Map::new(),
        }
    }
}

impl WireCode for NotPermitted {
    fn code(&self) -> ErrorCode {
        ErrorCode::PermissionDenied
    }

    fn details(&self, _place: &Place) -> Map<String, Value> {
        match self {
            NotPermitted::Verb { user: person, verb } => {
                let person = person.as_ref();
                let person = person.map(|person| (person.name.as_str(), person.role));
                rejection(person, verb).details
            }
            NotPermitted::Controller {
                user: person,
                controller,
            } => object(json!({"person": person, "controller": controller})),
        }
    }
}

impl From<ArgsError> for CommandError {
    fn from(error: ArgsError) -> Self {
        match error {
            ArgsError::Value(error) => error.into(),
            ArgsError::Field { field, problem } => CommandError::Field { field, problem },
        }
    }
}

impl From<ChangeError> for CommandError {
    fn from(error: ChangeError) -> Self {
        SwarmError::from(error).into()
    }
}
