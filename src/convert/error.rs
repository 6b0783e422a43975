//! Why a request was refused, and the code, words and details it is refused with.

use jostle_convert::error::{named, range_of};
use jostle_convert::{ArgsError, WireError};
use jostle_physics::simulation::ChangeError;
use jostle_proto::role::refused;
use jostle_proto::{Claimant, Error, ErrorCode, RequestError, claim, keys};
use serde_json::{Map, Value, json};
use thiserror::Error as ThisError;

use crate::auth::NotPermitted;
use crate::experiments::ExperimentError;
use crate::playback::{MAX_UPLOAD_BYTES, ReplayError};
use crate::recording::RecordError;
use crate::swarm::error::SwarmError;
use crate::swarm::registry::RegistryError;

/// Why a request was refused.
#[derive(Clone, Debug, ThisError)]
pub enum CommandError {
    /// The payload cannot be read.
    #[error("{0}")]
    Request(#[from] RequestError),
    /// A value is not what it may be.
    #[error(transparent)]
    Value(#[from] WireError),
    /// A field is wrong in another way.
    #[error("{field} {problem}")]
    Field {
        /// Which.
        field: &'static str,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A name cannot be one.
    #[error("{field} {name:?} is no name")]
    Name {
        /// Which.
        field: &'static str,
        /// The name refused, at most its first 64 characters.
        name: String,
    },
    /// The size of the group is outside the daemon's limit.
    #[error("n = {n} is outside its range: give a whole number from 1 to {limit}")]
    Individuals {
        /// The size refused.
        n: u64,
        /// The limit.
        limit: usize,
    },
    /// A selector names a parameter that means nothing here.
    #[error("there is no parameter {name:?} here")]
    Parameter {
        /// As it came.
        name: String,
        /// Those there are.
        known: &'static [&'static str],
    },
    /// A selector gives a parameter twice.
    #[error("{0} is given twice: give it once")]
    Twice(&'static str),
    /// The payload is longer than any that says something useful here.
    #[error("the request has {bytes} bytes, the most is {most_bytes}: send less at once")]
    TooLong {
        /// Its length.
        bytes: usize,
        /// The most there may be.
        most_bytes: usize,
    },
    /// The payload is not in an encoding that requests are read in.
    #[error("the payload is {0:?}: requests are application/json")]
    Encoding(String),
    /// The key names more than one thing to do.
    #[error("a wildcard executes nothing: send the command to one concrete key")]
    Wildcard,
    /// There is no such verb.
    #[error("there is no verb {verb:?}")]
    UnknownVerb {
        /// As it came.
        verb: String,
        /// Those there are.
        known: &'static [&'static str],
    },
    /// There is nothing of that name to get.
    #[error("there is no {noun:?} to get")]
    UnknownNoun {
        /// As it came.
        noun: String,
        /// Those there are.
        known: &'static [&'static str],
    },
    /// There is no such swarm.
    #[error("there is no swarm {0:?}: the node's get/swarms lists what there is")]
    UnknownSwarm(String),
    /// Something within a larger argument is wrong.
    #[error("{path}: {error}")]
    Within {
        /// The path of what it is within, such as `commands[2].args`.
        path: String,
        /// What is wrong.
        error: Box<CommandError>,
    },
    /// The id was given to another request before.
    #[error(
        "request_id {0:?} was given to another request of this client: give each request one of \
         its own"
    )]
    OtherRequest(String),
    /// A snapshot cannot be one.
    #[error("not a snapshot that this daemon can restore: {0}")]
    Snapshot(String),
    /// A snapshot that one message does not carry.
    #[error(
        "the snapshot has {bytes} bytes, the most that one message carries is {most_bytes}: fork \
         the swarm on this daemon, or stop the daemon and copy its data folder"
    )]
    SnapshotTooLong {
        /// Its length.
        bytes: usize,
        /// The most there may be.
        most_bytes: usize,
    },
    /// A step that the swarm has not come to.
    #[error("step {step} is not reached, the swarm is at step {now}: name an earlier one")]
    NotReached {
        /// The step asked for.
        step: u64,
        /// Where it is.
        now: u64,
    },
    /// A past that cannot be told.
    #[error("the swarm's past cannot be told: {0}")]
    History(String),
    /// It takes other rights.
    #[error(transparent)]
    NotPermitted(#[from] NotPermitted),
    /// Another daemon holds the name, too, and has executed commands on it.
    #[error("{}", claim::refused(swarm.as_deref(), claimants).message)]
    Contested {
        /// The swarm; `None` for the daemon's own name.
        swarm: Option<String>,
        /// Both daemons.
        claimants: [Claimant; 2],
    },
    /// The name of a new swarm is claimed by another daemon.
    #[error(
        "daemon {0:?} claims this name: choose another name, or delete the swarm of this name there"
    )]
    Claimed(String),
    /// A defect of the daemon.
    #[error("a defect of the daemon: nothing was changed; please report what you sent")]
    Internal,
    /// The request was dropped without a reply.
    #[error(
        "a defect of the daemon: it dropped the request, and whether it was executed is unknown: send \
         the same request_id again"
    )]
    Dropped,
    /// More clients are connected than there may be.
    #[error(
        "more than the daemon's {} connected: close one, or raise max_clients and start it again",
        match .limit {
            1 => "1 client is".to_owned(),
            limit => format!("{limit} clients are"),
        }
    )]
    TooManyClients {
        /// The limit.
        limit: usize,
    },
    /// Too much at once for the daemon.
    #[error("too much at once for this daemon: try again in a moment")]
    Busy,
    /// The reply took too long.
    #[error(
        "not done within {after_secs} s: the work goes on; get/wait tells when it is done, \
         timeout_secs waits longer"
    )]
    Deadline {
        /// How long it was waited for.
        after_secs: f64,
    },
    /// What was waited for has not come about.
    #[error("not yet so after {after_secs} s: ask again")]
    NotYet {
        /// How long it was waited for.
        after_secs: f64,
    },
    /// The daemon refuses the swarm.
    #[error(transparent)]
    Host(#[from] RegistryError),
    /// The swarm refuses the order.
    #[error(transparent)]
    Order(#[from] SwarmError),
    /// A recording is not shown.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// The laboratory refuses what is to be done with an experiment.
    #[error(transparent)]
    Lab(#[from] ExperimentError),
    /// What is to be done with a recording is refused.
    #[error(transparent)]
    Record(#[from] RecordError),
}

impl CommandError {
    /// The reply took longer than this.
    pub fn deadline(after_secs: f64) -> Self {
        CommandError::Deadline { after_secs }
    }

    /// What was waited for did not come about in this time.
    pub fn not_yet(after_secs: f64) -> Self {
        CommandError::NotYet { after_secs }
    }

    /// The same error, of something within a larger argument.
    #[must_use]
    pub fn within(self, path: String) -> Self {
        CommandError::Within {
            path,
            error: Box::new(self),
        }
    }

    /// The error as it crosses the wire, for a swarm at `step`.
    pub fn to_wire(&self, step: Option<u64>) -> Error {
        if let CommandError::Within { path, error } = self {
            return error.to_wire(step).within(path);
        }
        if let CommandError::Order(SwarmError::InBatch { index, error }) = self {
            let error = CommandError::Order((**error).clone()).to_wire(step);
            let mut error = error.within(&format!("commands[{index}].args"));
            error.message.push_str("; none of the batch was applied");
            return error;
        }
        let details = self.details();
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
            | (CommandError::UnknownNoun { known, .. }, _)
            | (CommandError::Parameter { known, .. }, _) => {
                let known = match known {
                    [] => "none".to_owned(),
                    known => known.join(", "),
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

    /// The code that clients branch on.
    pub fn code(&self) -> ErrorCode {
        match self {
            CommandError::Request(_)
            | CommandError::Value(_)
            | CommandError::Field { .. }
            | CommandError::Name { .. }
            | CommandError::Individuals { .. }
            | CommandError::Parameter { .. }
            | CommandError::Twice(_)
            | CommandError::Encoding(_)
            | CommandError::Wildcard => ErrorCode::InvalidArgument,
            CommandError::UnknownVerb { .. }
            | CommandError::UnknownNoun { .. }
            | CommandError::UnknownSwarm(_) => ErrorCode::NotFound,
            CommandError::Within { error, .. } => error.code(),
            CommandError::OtherRequest(_) => ErrorCode::Conflict,
            CommandError::Snapshot(_) => ErrorCode::InvalidArgument,
            CommandError::NotReached { .. } | CommandError::History(_) => ErrorCode::Conflict,
            CommandError::NotPermitted(_) => ErrorCode::PermissionDenied,
            CommandError::Contested { .. } => ErrorCode::Contested,
            CommandError::Claimed(_) => ErrorCode::AlreadyExists,
            CommandError::Internal | CommandError::Dropped => ErrorCode::Internal,
            CommandError::TooLong { .. }
            | CommandError::SnapshotTooLong { .. }
            | CommandError::TooManyClients { .. } => ErrorCode::ResourceExhausted,
            CommandError::Busy => ErrorCode::Busy,
            CommandError::Deadline { .. } | CommandError::NotYet { .. } => {
                ErrorCode::DeadlineExceeded
            }
            CommandError::Host(error) => match error {
                RegistryError::OtherSpec | RegistryError::SameSpec => ErrorCode::AlreadyExists,
                RegistryError::TooManySwarms { .. }
                | RegistryError::TooMuchMemory { .. }
                | RegistryError::NoThread(_) => ErrorCode::ResourceExhausted,
                RegistryError::Stopping => ErrorCode::Busy,
            },
            CommandError::Replay(error) => match error {
                ReplayError::Unreadable(_) => ErrorCode::InvalidArgument,
                ReplayError::Piece { .. } => ErrorCode::Conflict,
                ReplayError::NotUploaded(_) | ReplayError::Unknown(_) => ErrorCode::NotFound,
                ReplayError::TooLong { .. } => ErrorCode::ResourceExhausted,
                ReplayError::TooMany(_) => ErrorCode::Busy,
                ReplayError::Unkept(_) => ErrorCode::StorageFull,
            },
            CommandError::Lab(error) => match error {
                ExperimentError::Plan { .. }
                | ExperimentError::Name(_)
                | ExperimentError::NoSeries(_) => ErrorCode::InvalidArgument,
                ExperimentError::Unknown(_) | ExperimentError::UnknownRun { .. } => {
                    ErrorCode::NotFound
                }
                ExperimentError::Exists(_) => ErrorCode::AlreadyExists,
                ExperimentError::Phase { .. } | ExperimentError::Unfinished { .. } => {
                    ErrorCode::IncorrectState
                }
                ExperimentError::TooMany(_) => ErrorCode::ResourceExhausted,
                ExperimentError::Unkept(_) => ErrorCode::StorageFull,
                ExperimentError::Unreadable(_) => ErrorCode::Internal,
                ExperimentError::Stopping => ErrorCode::Busy,
            },
            CommandError::Record(error) => match error {
                RecordError::Unknown(_) | RecordError::NoPart { .. } => ErrorCode::NotFound,
                RecordError::NoOffset { .. } => ErrorCode::InvalidArgument,
                RecordError::Exists(_) => ErrorCode::AlreadyExists,
                RecordError::Failed(_) => ErrorCode::IncorrectState,
                RecordError::TooMany(_)
                | RecordError::TooManyKept(_)
                | RecordError::OverQuota { .. }
                | RecordError::NoThread(_) => ErrorCode::ResourceExhausted,
                RecordError::Unkept(_) => ErrorCode::StorageFull,
                RecordError::Ending(_) | RecordError::Stopping => ErrorCode::Busy,
            },
            CommandError::Order(error) => match error {
                SwarmError::Phase(_)
                | SwarmError::Lockstep
                | SwarmError::Recorded
                | SwarmError::NotRecorded
                | SwarmError::RunsFreely(_) => ErrorCode::IncorrectState,
                SwarmError::NotJoined { .. } => ErrorCode::NotFound,
                SwarmError::HasJoined(_) => ErrorCode::AlreadyExists,
                SwarmError::TooManyControllers { .. } => ErrorCode::ResourceExhausted,
                SwarmError::NotClaimed { .. } | SwarmError::NotDriving(_) => {
                    ErrorCode::InvalidArgument
                }
                SwarmError::Conflict { .. }
                | SwarmError::Past { .. }
                | SwarmError::Late { .. }
                | SwarmError::Overtaken { .. }
                | SwarmError::Claimed { .. }
                | SwarmError::Advancing { .. }
                | SwarmError::Superseded => ErrorCode::Conflict,
                SwarmError::InBatch { error, .. } => CommandError::Order((**error).clone()).code(),
                SwarmError::Panicked => ErrorCode::Internal,
                SwarmError::Film(_) | SwarmError::OutsideRecording { .. } => {
                    ErrorCode::InvalidArgument
                }
                SwarmError::Change(error) => jostle_convert::error::code(error),
                SwarmError::TooManyScheduled { .. } => ErrorCode::ResourceExhausted,
                SwarmError::Unsafe(_) => ErrorCode::StorageFull,
                SwarmError::RefusedBefore => ErrorCode::Conflict,
                SwarmError::Displaced { .. } => ErrorCode::DeadlineExceeded,
                SwarmError::Busy => ErrorCode::Busy,
                SwarmError::Faulted(_) => ErrorCode::Faulted,
                SwarmError::Gone => ErrorCode::NotFound,
            },
        }
    }

    fn details(&self) -> Map<String, Value> {
        let details = match self {
            CommandError::Request(error) if !error.field.is_empty() => {
                // A field that should not be there has no range that would help.
                let is_known = !error.problem.starts_with("unknown");
                let range = is_known.then(|| range_of(&error.field)).flatten();
                named(&error.field, Value::Null, range)
            }
            CommandError::Value(WireError::OutOfRange { field, value }) => {
                named(field, value.clone(), range_of(field))
            }
            CommandError::Field { field, .. } => named(field, Value::Null, range_of(field)),
            CommandError::Name { field, name } => named(field, json!(name), Some(keys::NAME_RULE)),
            CommandError::Individuals { n, limit } => {
                json!({"field": "n", "value": n, "range": format!("[1, {limit}]")})
            }
            CommandError::Contested { swarm, claimants } => {
                return claim::refused(swarm.as_deref(), claimants).details;
            }
            CommandError::Claimed(node) => json!({"node": node}),
            CommandError::Snapshot(_) => named("snapshot", Value::Null, range_of("snapshot")),
            CommandError::Parameter { name, known } => json!({"field": name, "known": known}),
            CommandError::Twice(name) => json!({"field": name}),
            CommandError::TooLong { bytes, most_bytes }
            | CommandError::SnapshotTooLong { bytes, most_bytes } => {
                json!({"bytes": bytes, "limit": most_bytes})
            }
            CommandError::Value(WireError::Length { field, length, n }) => {
                json!({"field": field, "length": length, "n": n})
            }
            CommandError::UnknownVerb { known, .. } | CommandError::UnknownNoun { known, .. } => {
                json!({"known": known})
            }
            CommandError::Deadline { after_secs } | CommandError::NotYet { after_secs } => {
                json!({"after_secs": after_secs})
            }
            CommandError::NotPermitted(NotPermitted::Verb { user: person, verb }) => {
                let person = person.as_ref();
                let person = person.map(|person| (person.name.as_str(), person.role));
                Value::Object(refused(person, verb).details)
            }
            CommandError::NotPermitted(NotPermitted::Controller {
                user: person,
                controller,
            }) => {
                json!({"person": person, "controller": controller})
            }
            CommandError::TooManyClients { limit }
            | CommandError::Host(RegistryError::TooManySwarms { limit }) => json!({"limit": limit}),
            CommandError::Host(RegistryError::TooMuchMemory {
                needed,
                free,
                limit,
            }) => json!({"needed": needed, "free": free, "limit": limit}),
            CommandError::Order(SwarmError::Conflict {
                what,
                expected,
                actual,
            }) => {
                json!({"field": format!("expect_{what}"), "expected": expected, "actual": actual})
            }
            CommandError::Order(SwarmError::Past { until, step }) => {
                json!({"field": "until_step", "until": until, "step": step})
            }
            CommandError::Order(SwarmError::OutsideRecording {
                field,
                value,
                first,
                last,
            }) => {
                json!({"field": field, "value": value, "range": format!("[{first}, {last}]")})
            }
            CommandError::Order(SwarmError::Late { at_step, step }) => {
                json!({"field": "at_step", "at_step": at_step, "step": step})
            }
            CommandError::Order(SwarmError::Overtaken { at_step }) => {
                json!({"field": "at_step", "at_step": at_step})
            }
            CommandError::Order(SwarmError::Displaced { after_secs, limit }) => {
                json!({"after_secs": after_secs, "limit": limit})
            }
            CommandError::Order(SwarmError::TooManyScheduled { limit }) => {
                json!({"field": "at_step", "limit": limit})
            }
            CommandError::Lab(error) => match error {
                ExperimentError::Plan { line, .. } => json!({"field": "submit.toml", "line": line}),
                ExperimentError::Name(name) => json!({"field": "submit.toml", "value": name}),
                ExperimentError::UnknownRun { run, .. }
                | ExperimentError::Unfinished { run, .. } => {
                    json!({"field": "run", "value": run})
                }
                ExperimentError::TooMany(limit) => json!({"limit": limit}),
                _ => json!({}),
            },
            CommandError::Replay(ReplayError::Piece { received }) => {
                json!({"field": "upload.offset", "uploaded": received})
            }
            CommandError::Replay(ReplayError::TooLong { length }) => {
                json!({"bytes": length, "limit": MAX_UPLOAD_BYTES})
            }
            CommandError::Record(RecordError::TooMany(limit) | RecordError::TooManyKept(limit)) => {
                json!({"limit": limit})
            }
            CommandError::Record(RecordError::OverQuota { used, quota }) => {
                json!({"bytes": used, "limit": quota})
            }
            CommandError::Record(RecordError::NoPart { part, .. }) => {
                json!({"field": "part", "value": part})
            }
            CommandError::Record(RecordError::NoOffset { offset, .. }) => {
                json!({"field": "offset", "value": offset})
            }
            CommandError::OtherRequest(id) => json!({"field": "request_id", "value": id}),
            CommandError::Order(SwarmError::Change(error)) => jostle_convert::error::details(error),
            CommandError::Order(
                SwarmError::NotJoined { controller, .. }
                | SwarmError::HasJoined(controller)
                | SwarmError::RunsFreely(controller)
                | SwarmError::NotDriving(controller),
            ) => json!({"field": "controller", "value": controller}),
            CommandError::Order(SwarmError::Claimed { id, controller }) => {
                json!({"field": "select", "id": id, "controller": controller})
            }
            CommandError::Order(SwarmError::NotClaimed { id, owner }) => {
                json!({"field": "set.ids", "id": id, "controller": owner})
            }
            CommandError::Order(SwarmError::Advancing { target, .. }) => {
                json!({"field": "controller", "target": target})
            }
            _ => Value::Null,
        };
        match details {
            Value::Object(details) => details,
            _ => Map::new(),
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

/// Words why an order was refused, for a swarm at `step`.
pub fn refusal(error: SwarmError, step: u64) -> Error {
    CommandError::from(error).to_wire(Some(step))
}
