//! Why a command failed: its kind, its exit code and, in the message, its remedy.

mod code;

use std::io;

use jostle_proto::{Error, ErrorCode};
use serde_json::{Map, Value, json};
use thiserror::Error as ThisError;

use self::code::{exit_code, name};
use crate::format::count;
use crate::nearest::{did_you_mean, nearest};

/// Why a command failed.
#[derive(Debug, ThisError)]
pub enum Failure {
    /// The daemon said no.
    #[error("{}{}{}", .error.message, hint(.error.code), sentence(.advice.as_deref()))]
    Refused {
        /// What it said.
        error: Box<Error>,
        /// What the command line knows to add for people.
        advice: Option<String>,
    },
    /// An argument cannot be sent as it is.
    #[error("{argument}: {problem}")]
    Argument {
        /// Which one.
        argument: String,
        /// What is wrong with it and what would be right.
        problem: String,
    },
    /// The payload would vanish on its way.
    #[error(
        "the request is {bytes} bytes long and this daemon takes {limit} at most: ask for less at once"
    )]
    TooLarge {
        /// The length of the payload.
        bytes: u64,
        /// The daemon's limit.
        limit: u64,
    },
    /// Nobody listens there.
    #[error(
        "no daemon answers at {endpoint}: start one with `jostled serve`, or name another with -e"
    )]
    NoDaemon {
        /// Where it was looked for.
        endpoint: String,
        /// What zenoh says, for those who look into it.
        cause: String,
    },
    /// Somebody listens there and lets nobody in, or not this client.
    #[error(
        "something listens at {endpoint} but does not let {} in: {}",
        person.as_deref().unwrap_or("this client"),
        match person {
            Some(_) => "these credentials may be newer than the daemon's last start (restart it), out of date, or another daemon's, or it knows no people and takes none",
            None => "if it is a daemon that knows its people, say who you are: --credentials FOLDER",
        }
    )]
    NotLetIn {
        /// Where.
        endpoint: String,
        /// Who wanted in, if they said so.
        person: Option<String>,
    },
    /// The daemon's certificate is for other names than the one that was connected to.
    #[error(
        "the certificate of the daemon at {endpoint} does not name {host}; it names {}: connect by \
         one of these, or run `{}` on the daemon's machine and restart the daemon",
        .names.join(", "),
        adding(.names, .host)
    )]
    WrongName {
        /// Where it was connected to.
        endpoint: String,
        /// By which name or address.
        host: String,
        /// Those in the certificate.
        names: Vec<String>,
    },
    /// zenoh answers, but no daemon of jostle is behind it.
    #[error(
        "zenoh answers at {endpoint}, but no daemon is there under the prefix `{prefix}`: start one with `jostled serve`, or name another with -e, or its prefix with --prefix"
    )]
    NoNode {
        /// Where it was looked for.
        endpoint: String,
        /// The first chunk of its keys.
        prefix: String,
    },
    /// The node that was named is not there.
    #[error("no node {node} here; there are: {}{}", .there.join(", "), sentence(did_you_mean(.node, .there.iter().map(String::as_str)).as_deref()))]
    UnknownNode {
        /// What was given.
        node: String,
        /// Those that are there.
        there: Vec<String>,
    },
    /// More than one daemon, and none was named.
    #[error("several nodes are here, choose one with --node: {}", .there.join(", "))]
    ManyNodes {
        /// Those that are there.
        there: Vec<String>,
    },
    /// Nobody hosts a swarm of that name.
    #[error("no swarm {swarm} on this daemon: {}", remedy(.swarm, .there, "`jostle list` shows what there is"))]
    NoSwarm {
        /// What was given.
        swarm: String,
        /// Those that are there.
        there: Vec<String>,
    },
    /// The daemon has no experiment or no recording of that name.
    #[error("no {what} {name} on this daemon: {}", remedy(.name, .there, list_of(.what)))]
    Unknown {
        /// `experiment` or `recording`.
        what: &'static str,
        /// What was given.
        name: String,
        /// Those that are there.
        there: Vec<String>,
        /// What the daemon said.
        error: Box<Error>,
    },
    /// No swarm has a name that matches.
    #[error("no swarm matches {pattern}: `jostle list` shows what there is")]
    NoMatch {
        /// What was given.
        pattern: String,
    },
    /// One of the swarms to delete is still there.
    #[error("{swarm} was not deleted: {failure}")]
    NotDeleted {
        /// The swarm.
        swarm: String,
        /// Why.
        failure: Box<Failure>,
    },
    /// There is no such message on the wire.
    #[error("no message {message}: {}", remedy(.message, .there, "`jostle schema` lists them"))]
    NoMessage {
        /// What was given.
        message: String,
        /// Those that are there.
        there: Vec<String>,
    },
    /// The doctor found something.
    #[error("{count} of {} failed", self::count(*.of as u64, "check"))]
    Unwell {
        /// How many checks failed.
        count: usize,
        /// How many there were.
        of: usize,
        /// The kind of the first.
        code: &'static str,
    },
    /// Who was asked is there, but the question did not reach it.
    #[error(
        "{whom} is there but does not answer: it refuses this client such requests, or it is closing"
    )]
    Silent {
        /// A swarm or a node.
        whom: String,
    },
    /// The answer did not come in time.
    #[error(
        "{whom} did not answer within {secs} s: it may still do what was asked; --timeout waits longer"
    )]
    TimedOut {
        /// A swarm or a node.
        whom: String,
        /// How long was waited.
        secs: f64,
    },
    /// The answer is not what this version expects.
    #[error("the answer cannot be read ({problem}): the daemon's version may differ from this one")]
    Unreadable {
        /// What is wrong with it.
        problem: String,
    },
    /// The swarm was paused before it reached the end waited for.
    #[error("{swarm} was paused at step {step}{}{}: `jostle run {swarm}` goes on", short_of(*.target), because(.reason.as_deref()))]
    Stopped {
        /// The swarm.
        swarm: String,
        /// Where it stands.
        step: u64,
        /// Where it should have come.
        target: Option<u64>,
        /// What it says.
        reason: Option<String>,
    },
    /// The swarm was put back or restored while it was waited for.
    #[error("{swarm} was reset while it was waited for: it is now at step {step} of epoch {epoch}")]
    StartedAnew {
        /// The swarm.
        swarm: String,
        /// Where it stands.
        step: u64,
        /// Its new epoch.
        epoch: u64,
    },
    /// The swarm faulted while it was waited for.
    #[error("{swarm} faulted at step {step}{}: `jostle reset {swarm}` starts anew", because(.reason.as_deref()))]
    Faulted {
        /// The swarm.
        swarm: String,
        /// The last good step.
        step: u64,
        /// What it says.
        reason: Option<String>,
    },
    /// The swarm was deleted while it was waited for or watched.
    #[error("{swarm} was deleted")]
    Deleted {
        /// The swarm.
        swarm: String,
    },
    /// The past came out otherwise when it was told again.
    #[error(
        "{swarm} comes out otherwise from step {step} on: another version stepped it, or the \
         machine erred; please report it"
    )]
    Mismatch {
        /// The swarm.
        swarm: String,
        /// The first step that differs.
        step: u64,
    },
    /// The experiment ended before all of its runs were over.
    #[error(
        "experiment {name} {how}{}, {finished} of {} finished: `jostle experiment resume {name}` \
         goes on",
        because(.message.as_deref()),
        self::count(*.runs, "run")
    )]
    Unfinished {
        /// The experiment.
        name: String,
        /// How it ended.
        how: &'static str,
        /// The kind of error that is.
        code: &'static str,
        /// How many runs are over.
        finished: u64,
        /// How many there are.
        runs: u64,
        /// What the daemon says.
        message: Option<String>,
    },
    /// A table or a picture cannot be made.
    #[error("{0}")]
    Results(String),
    /// Parts of an experiment cannot be merged.
    #[error("{message}")]
    Merge {
        /// The kind of error.
        code: &'static str,
        /// Why.
        message: String,
    },
    /// The results were measured, and lie outside their bands.
    #[error("{outside} of {count} means lie outside their bands")]
    OutsideBands {
        /// How many.
        outside: usize,
        /// Of how many.
        count: usize,
    },
    /// A file cannot be written.
    #[error("{path}: {error}")]
    File {
        /// Which one.
        path: String,
        /// Why.
        error: io::Error,
    },
    /// There is no room here for what is recorded.
    #[error("{problem}")]
    DiskFull {
        /// What could not go on.
        problem: String,
    },
    /// The daemon came back, the swarm did not.
    #[error("the daemon is back, but without {swarm}")]
    LeftBehind {
        /// The swarm.
        swarm: String,
    },
    /// Ctrl-C.
    #[error("interrupted{}", .left.as_deref().map(|left| format!(": {left}")).unwrap_or_default())]
    Interrupted {
        /// What goes on without the command line.
        left: Option<String>,
    },
    /// The answer to a question was no.
    #[error("not confirmed: nothing was deleted")]
    Declined,
    /// Standard output cannot be written.
    #[error("failed to write: {0}")]
    Output(io::Error),
    /// Nobody reads standard output any more; not an error.
    #[error("nobody reads on")]
    Pipe,
    /// A defect of the command line.
    #[error("this is a defect of the command line: {problem}")]
    Defect {
        /// What happened.
        problem: String,
    },
}

impl Failure {
    /// What the daemon said.
    pub fn refused(error: Error) -> Self {
        Failure::Refused {
            error: Box::new(error),
            advice: None,
        }
    }

    /// The daemon has no such experiment or recording.
    pub fn unknown(what: &'static str, name: &str, there: Vec<String>, error: Box<Error>) -> Self {
        Failure::Unknown {
            what,
            name: name.to_owned(),
            there,
            error,
        }
    }

    /// The same with something to add for people, if there is anything.
    pub fn with_advice(self, said: Option<String>) -> Self {
        match self {
            Failure::Refused { error, advice } => Failure::Refused {
                error,
                advice: said.or(advice),
            },
            failure => failure,
        }
    }

    /// Something that should not happen.
    #[expect(clippy::needless_pass_by_value, reason = "`map_err` hands it over")]
    pub fn defect(error: impl ToString) -> Self {
        Failure::Defect {
            problem: error.to_string(),
        }
    }

    /// An answer that cannot be read.
    #[expect(clippy::needless_pass_by_value, reason = "`map_err` hands it over")]
    pub fn unreadable(error: impl ToString) -> Self {
        Failure::Unreadable {
            problem: error.to_string(),
        }
    }

    /// The kind, in the words of the wire where it has one.
    pub fn code(&self) -> &'static str {
        match self {
            Failure::Refused { error, .. } | Failure::Unknown { error, .. } => name(error.code),
            Failure::Argument { .. } | Failure::ManyNodes { .. } => "invalid_argument",
            Failure::TooLarge { .. } => "resource_exhausted",
            Failure::NoDaemon { .. } | Failure::NoNode { .. } | Failure::WrongName { .. } => {
                "unreachable"
            }
            Failure::UnknownNode { .. }
            | Failure::NoSwarm { .. }
            | Failure::NoMessage { .. }
            | Failure::NoMatch { .. }
            | Failure::Deleted { .. }
            | Failure::LeftBehind { .. } => "not_found",
            Failure::Silent { .. } | Failure::NotLetIn { .. } => "permission_denied",
            Failure::NotDeleted { failure, .. } => failure.code(),
            Failure::TimedOut { .. } => "timeout",
            Failure::Stopped { .. } => "incorrect_state",
            Failure::StartedAnew { .. } => "conflict",
            Failure::Faulted { .. } => "faulted",
            Failure::Mismatch { .. } | Failure::OutsideBands { .. } => "mismatch",
            Failure::Interrupted { .. } | Failure::Declined => "interrupted",
            Failure::Pipe => "broken_pipe",
            Failure::DiskFull { .. } => "storage_full",
            Failure::Unwell { code, .. }
            | Failure::Unfinished { code, .. }
            | Failure::Merge { code, .. } => code,
            Failure::Results(_) => "invalid_argument",
            Failure::Unreadable { .. }
            | Failure::File { .. }
            | Failure::Output(_)
            | Failure::Defect { .. } => "internal",
        }
    }

    /// What the process ends with.
    pub fn exit_code(&self) -> u8 {
        exit_code(self.code())
    }

    /// The error as programs read it: what the daemon said, or the same shape.
    pub fn to_json(&self) -> Value {
        if let Failure::NotDeleted { swarm, failure } = self {
            let mut error = failure.to_json();
            error["message"] = json!(self.to_string());
            error["details"]["swarm"] = json!(swarm);
            return error;
        }
        let (details, step) = match self {
            Failure::Refused { error, .. } => (error.details.clone(), error.step),
            Failure::Unknown {
                name, there, error, ..
            } => {
                let mut details = error.details.clone();
                details.insert("nearest".into(), json!(nearest_of(name, there)));
                (details, error.step)
            }
            Failure::NoDaemon { endpoint, cause } => {
                (object(json!({"endpoint": endpoint, "cause": cause})), None)
            }
            Failure::WrongName {
                endpoint,
                host,
                names,
            } => (
                object(json!({"endpoint": endpoint, "host": host, "names": names})),
                None,
            ),
            Failure::ManyNodes { there } | Failure::UnknownNode { there, .. } => {
                (object(json!({"nodes": there})), None)
            }
            Failure::NoSwarm { swarm, there } => (
                object(json!({"swarm": swarm, "nearest": nearest_of(swarm, there)})),
                None,
            ),
            Failure::NoMessage { message, there } => (
                object(json!({"message": message, "nearest": nearest_of(message, there)})),
                None,
            ),
            Failure::Argument { argument, .. } => (object(json!({"field": argument})), None),
            Failure::Stopped { step, reason, .. } | Failure::Faulted { step, reason, .. } => {
                (object(json!({"reason": reason})), Some(*step))
            }
            Failure::StartedAnew { step, .. } | Failure::Mismatch { step, .. } => {
                (Map::new(), Some(*step))
            }
            _ => (Map::new(), None),
        };
        let message = match self {
            Failure::Refused { error, .. } | Failure::Unknown { error, .. } => {
                error.message.clone()
            }
            failure => failure.to_string(),
        };
        json!({
            "code": self.code(),
            "message": message,
            "details": details,
            "step": step,
        })
    }

    /// Whether asking again may help without anybody doing anything.
    pub fn is_passing(&self) -> bool {
        matches!(
            self.code(),
            "unreachable" | "timeout" | "busy" | "permission_denied"
        )
    }
}

/// The daemon's remedies are fields of requests; what it is called here, where that differs.
fn hint(code: ErrorCode) -> &'static str {
    match code {
        ErrorCode::DeadlineExceeded => " (here: `jostle status` and --timeout)",
        _ => "",
    }
}

/// The command that adds `host` to the names of a daemon's certificate.
fn adding(names: &[String], host: &str) -> String {
    // Every certificate of a daemon has these.
    let own = ["localhost", "127.0.0.1", "::1"];
    let others = names.iter().map(String::as_str);
    let hosts = others.filter(|name| !own.contains(name)).chain([host]);
    let hosts: String = hosts.map(|name| format!(" --host {name}")).collect();
    format!("jostled auth address{hosts}")
}

/// Whether the daemon refused the name of what the request is about, and no field of the request.
pub fn is_unknown_name(error: &Error) -> bool {
    error.code == ErrorCode::NotFound && error.details.is_empty()
}

/// The command that lists what there is.
fn list_of(what: &str) -> &'static str {
    match what {
        "experiment" => "`jostle experiment list` shows what there is",
        _ => "`jostle record --list` shows what there is",
    }
}

/// What may have been meant, and where to look.
fn remedy(word: &str, there: &[String], where_to_look: &str) -> String {
    let question = did_you_mean(word, there.iter().map(String::as_str));
    question.map_or_else(String::new, |question| question + " ") + where_to_look
}

fn nearest_of<'a>(word: &str, among: &'a [String]) -> Vec<&'a str> {
    nearest(word, among.iter().map(String::as_str))
}

/// Something to add, after what was said.
fn sentence(added: Option<&str>) -> String {
    added.map(|added| format!("; {added}")).unwrap_or_default()
}

fn object(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(map) => map,
        _ => Map::new(),
    }
}

fn short_of(target: Option<u64>) -> String {
    target
        .map(|step| format!(", short of {step}"))
        .unwrap_or_default()
}

fn because(reason: Option<&str>) -> String {
    reason
        .map(|reason| format!(" ({reason})"))
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(code: ErrorCode) -> Failure {
        Failure::refused(Error {
            code,
            message: "no".into(),
            details: Map::new(),
            step: Some(7),
        })
    }

    #[test]
    fn what_goes_wrong_here_has_its_exit_code_too() {
        let daemon = Failure::NoDaemon {
            endpoint: "tcp/127.0.0.1:1".into(),
            cause: String::new(),
        };
        assert_eq!(daemon.exit_code(), 6);
        assert_eq!(Failure::Interrupted { left: None }.exit_code(), 130);
        assert_eq!(Failure::Pipe.exit_code(), 0);
        let whom = || "demo".to_owned();
        let swarm = Failure::NoSwarm {
            swarm: whom(),
            there: vec!["demos".into(), "herd".into()],
        };
        assert_eq!(swarm.exit_code(), 3);
        assert!(
            swarm.to_string().contains("did you mean `demos`?"),
            "{swarm}"
        );
        assert_eq!(swarm.to_json()["details"]["nearest"], json!(["demos"]));
        assert_eq!(Failure::Silent { whom: whom() }.exit_code(), 5);
    }

    #[test]
    fn what_the_daemon_said_is_passed_on_as_it_was() {
        let refused = refused(ErrorCode::Conflict).with_advice(Some("rather this".into()));
        assert_eq!(refused.to_string(), "no; rather this");
        let json = refused.to_json();
        assert_eq!(
            json,
            json!({"code": "conflict", "message": "no", "details": {}, "step": 7})
        );
    }
}
