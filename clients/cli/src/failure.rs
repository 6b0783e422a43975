//! Why a command failed: its code, its exit code and, in the message, its remedy.

use std::fmt::Display;
use std::io;

use jostle_client::{Error, MAY_EXECUTE};
use jostle_experiment::stdout::StdoutError;
use jostle_proto::ErrorCode;
use serde_json::{Map, Value, json};

use crate::format::count;
use crate::suggest::{did_you_mean, instead_of_unknown, nearest};

/// An error of a verb.
#[derive(Debug)]
pub struct Failure {
    /// What callers match.
    pub kind: Kind,
    code: String,
    /// Names the remedies of the command line.
    message: String,
    details: Map<String, Value>,
    step: Option<u64>,
}

/// The kinds of failures that some caller handles.
#[derive(Debug)]
pub enum Kind {
    /// An error of a request.
    Request(Box<Error>),
    /// Ctrl-C, without a message.
    Interrupted,
    /// The reader of standard output has closed the pipe; not an error.
    BrokenPipe,
    /// Any other failure.
    Other,
}

impl Failure {
    /// A failure that no caller handles.
    pub fn new(code: impl Into<String>, message: impl Into<String>) -> Self {
        Failure {
            kind: Kind::Other,
            code: code.into(),
            message: message.into(),
            details: Map::new(),
            step: None,
        }
    }

    fn of(kind: Kind, code: &str, message: impl Into<String>) -> Self {
        Failure {
            kind,
            ..Failure::new(code, message)
        }
    }

    /// Adds an entry to the details.
    pub fn with(mut self, key: &str, value: impl Into<Value>) -> Self {
        self.details.insert(key.into(), value.into());
        self
    }

    pub fn at_step(self, step: u64) -> Self {
        Failure {
            step: Some(step),
            ..self
        }
    }

    /// The daemon's error reply.
    pub fn rejected(error: jostle_proto::Error) -> Self {
        Error::Rejected(Box::new(error)).into()
    }

    /// No `what` has this name; `list` is the command that lists those that do.
    pub fn unknown(what: &str, name: &str, there: &[String], list: &str) -> Self {
        let question = did_you_mean(name, there).map_or_else(String::new, |it| it + " ");
        let message = format!("no {what}: {question}`{list}` lists them");
        Failure::new("not_found", message).with("nearest", nearest(name, there))
    }

    /// Describes the rejection of the name of an experiment or a recording.
    pub fn describe_unknown(self, what: &str, name: &str, there: &[String], list: &str) -> Self {
        let what = format!("{what} {name} on this daemon");
        let Failure {
            message, details, ..
        } = Failure::unknown(&what, name, there, list);
        Failure {
            message,
            details,
            ..self
        }
    }

    /// Adds advice for people to a rejection.
    pub fn with_advice(mut self, advice: Option<String>) -> Self {
        if let (Some(_), Some(advice)) = (self.rejection(), advice) {
            self.message.push_str(&format!("; {advice}"));
        }
        self
    }

    /// Adds what remains after it.
    pub fn leaving(mut self, left: impl Display) -> Self {
        self.message.push_str(&format!("; {left}"));
        self
    }

    /// An argument is invalid; `problem` contains the remedy.
    pub fn argument(argument: impl Display, problem: impl Display) -> Self {
        let argument = argument.to_string();
        Failure::new("invalid_argument", format!("{argument}: {problem}")).with("field", argument)
    }

    /// A command to one of several swarms failed; `what` it did not become.
    pub fn not_done(swarm: &str, what: &str, failure: Failure) -> Self {
        Failure {
            kind: Kind::Other,
            message: format!("{swarm} was not {what}: {failure}"),
            ..failure.with("swarm", swarm)
        }
    }

    /// A reply that this version cannot parse.
    pub fn unreadable(error: impl Display) -> Self {
        let message =
            format!("unreadable reply ({error}): daemon and command line may need one version");
        Failure::new("internal", message)
    }

    /// The swarm stopped before the step that was waited for.
    pub fn stopped(swarm: &str, step: u64, end: &RunEnd, reason: Option<String>) -> Self {
        let short = match end {
            RunEnd::Pause => String::new(),
            RunEnd::Step(target) => format!(", short of {target}"),
            RunEnd::Condition { text, .. } => format!(", before {text}"),
        };
        let message = format!(
            "{swarm} was paused at step {step}{short}{}: `jostle run {swarm}` continues{}",
            in_parentheses(reason.as_deref()),
            end.left_in(swarm)
        );
        Failure::new("incorrect_state", message)
            .with("reason", reason)
            .at_step(step)
    }

    /// The swarm has not reached its end within the timeout.
    pub fn not_reached(swarm: &str, end: &RunEnd, secs: f64) -> Self {
        let what = match end {
            RunEnd::Pause => "a pause".to_owned(),
            RunEnd::Step(step) => format!("step {step}"),
            RunEnd::Condition { text, .. } => text.clone(),
        };
        let message = format!(
            "{swarm} did not reach {what} within {secs} s (--timeout): {}",
            end.runs_on(swarm)
        );
        Failure::new("deadline_exceeded", message)
    }

    /// A swarm that does not run has published too few states.
    pub fn not_counted(swarm: &str, shown: u64, count: u64, secs: f64) -> Self {
        let message = format!(
            "{swarm} does not run: {shown} of {count} came, none within {secs} s (--timeout): `jostle run \
             {swarm}` runs it"
        );
        Failure::new("incorrect_state", message)
    }

    /// The condition did not hold within the timeout.
    pub fn not_held(swarm: &str, condition: &str, secs: f64) -> Self {
        let message = format!(
            "{condition} did not hold in {swarm} within {secs} s (--timeout): `jostle status {swarm}` \
             shows whether it runs"
        );
        Failure::new("deadline_exceeded", message)
    }

    /// The swarm was reset or restored during the wait.
    pub fn was_reset(swarm: &str, step: u64, epoch: u64) -> Self {
        let message = format!(
            "{swarm} was reset during the wait (now at step {step} of epoch {epoch}): run it again"
        );
        Failure::new("conflict", message).at_step(step)
    }

    /// The swarm faulted during the wait; `step` is the last good one.
    pub fn faulted(swarm: &str, step: u64, reason: Option<String>) -> Self {
        let message = format!(
            "{swarm} faulted at step {step}{}: `jostle reset {swarm}` resets it",
            in_parentheses(reason.as_deref())
        );
        Failure::new("faulted", message)
            .with("reason", reason)
            .at_step(step)
    }

    /// The swarm was deleted while a verb followed it.
    pub fn deleted(swarm: &str) -> Self {
        Failure::new("not_found", format!("{swarm} was deleted"))
    }

    /// The experiment ended with runs that did not finish; `how` it ended is `code`.
    pub fn unfinished(
        name: &str,
        (how, code): (&str, &str),
        (finished, runs): (u64, u64),
        reason: Option<&str>,
    ) -> Self {
        let message = format!(
            "experiment {name} {how}{}, {finished} of {} finished: `jostle experiment resume \
             {name}` continues",
            in_parentheses(reason),
            count(runs, "run")
        );
        Failure::new(code, message)
    }

    /// The experiment ended since another version of the model executed its finished runs.
    pub fn of_other_model(name: &str, version: u32, reason: Option<&str>) -> Self {
        let message = format!("experiment {name} failed{}", in_parentheses(reason));
        Failure::new("conflict", message).with("model_version", version)
    }

    /// A table cannot be read, or a figure cannot be drawn.
    pub fn results(error: impl std::error::Error + 'static) -> Self {
        let code = match is_full(&error) {
            true => "storage_full",
            false => "invalid_argument",
        };
        Failure::new(code, error.to_string())
    }

    /// A file cannot be written.
    pub fn file(path: impl Display, error: impl std::error::Error + 'static) -> Self {
        let code = if is_full(&error) {
            "storage_full"
        } else {
            "internal"
        };
        Failure::new(code, format!("{path}: {error}"))
    }

    /// The disk is full; `problem` names the operation that failed.
    pub fn disk_full(problem: impl Display) -> Self {
        Failure::new("storage_full", problem.to_string())
    }

    /// Ctrl-C.
    pub fn interrupted() -> Self {
        Failure::of(Kind::Interrupted, "interrupted", "interrupted")
    }

    /// Ctrl-C; `left` is what continues without the command line.
    pub fn interrupted_leaving(left: impl Display) -> Self {
        Failure::new("interrupted", format!("interrupted: {left}"))
    }

    /// Standard output cannot be written.
    pub fn output(error: impl Into<StdoutError>) -> Self {
        let error = error.into();
        match error {
            StdoutError::Closed => Failure::of(Kind::BrokenPipe, "broken_pipe", error.to_string()),
            StdoutError::Failed(_) => Failure::new("internal", error.to_string()),
        }
    }

    /// A defect of the command line.
    pub fn defect(error: impl Display) -> Self {
        let message = format!("defect of the command line, please report it: {error}");
        Failure::new("internal", message)
    }

    /// The code, the one of the wire where the wire has one.
    pub fn code(&self) -> &str {
        &self.code
    }

    /// The exit code of the process; `jostle help exit-codes` has the same table.
    pub fn exit_code(&self) -> u8 {
        match self.code.as_str() {
            "broken_pipe" => 0,
            "invalid_argument" => 2,
            "not_found" => 3,
            "conflict" | "contested" | "incorrect_state" | "already_exists" => 4,
            "permission_denied" => 5,
            "unreachable" | "deadline_exceeded" | "timeout" => 6,
            "busy" | "resource_exhausted" => 7,
            "storage_full" => 8,
            "mismatch" => 9,
            "interrupted" => 130,
            _ => 1,
        }
    }

    /// The error of the request that failed.
    pub fn cause(&self) -> Option<&Error> {
        match &self.kind {
            Kind::Request(error) => Some(error),
            _ => None,
        }
    }

    /// The daemon's error reply.
    pub fn rejection(&self) -> Option<&jostle_proto::Error> {
        match self.cause() {
            Some(Error::Rejected(error)) => Some(error),
            _ => None,
        }
    }

    /// The error for programs, with the remedies of the command line; shaped as the daemon's.
    pub fn to_json(&self) -> Value {
        json!({
            "code": self.code,
            "message": self.message,
            "details": self.details,
            "step": self.step,
        })
    }

    /// Whether the daemon rejected the name in the key, and not a field of the request.
    pub fn is_unknown_name(&self) -> bool {
        self.rejection()
            .is_some_and(|error| error.code == ErrorCode::NotFound && error.details.is_empty())
    }
}

/// The errors of the client, with the remedies of the command line.
impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let failure = match &error {
            Error::Rejected(error) => {
                let mut message = with_options(&error.message);
                if let Some(question) = instead_of_unknown(&message) {
                    message.push_str(&format!("; {question}"));
                }
                Failure {
                    details: error.details.clone(),
                    step: error.step,
                    ..Failure::new(name(error.code), message)
                }
            }
            Error::Option { option, problem } => Failure::argument(format!("--{option}"), problem),
            Error::NoDaemon { endpoint, cause } => {
                // Only how long the client tried: zenoh's text names no remedy.
                let tried = cause.starts_with("tried for").then(|| format!(", {cause}"));
                let tried = tried.unwrap_or_default();
                let tried = match cause.ends_with(MAY_EXECUTE) {
                    true => format!("{tried}; {MAY_EXECUTE}"),
                    false => tried,
                };
                let message = format!(
                    "no daemon answers at {endpoint}{tried}: start one with `jostled serve`, or name \
                     another with -e"
                );
                Failure::new("unreachable", message)
                    .with("endpoint", endpoint.as_str())
                    .with("cause", cause.as_str())
            }
            Error::UnknownHost { endpoint, host } => {
                let message = format!(
                    "no address is known of the host {host} in {endpoint}: name another endpoint \
                     with -e"
                );
                Failure::new("unreachable", message).with("endpoint", endpoint.as_str())
            }
            Error::Mute { endpoint, secs } => {
                let message = format!(
                    "something accepts connections at {endpoint} but sent no reply within {secs} s: \
                     it may hang, or be another program; look at its process, or name another \
                     endpoint with -e"
                );
                Failure::new("unreachable", message).with("endpoint", endpoint.as_str())
            }
            Error::NotAdmitted { endpoint, person } => {
                let (who, remedy) = match person {
                    Some(person) => (
                        person.as_str(),
                        "these credentials may be newer than the daemon's last start (restart it), \
                         expired or another daemon's, a clock may be wrong, or the daemon has no \
                         authentication",
                    ),
                    None => (
                        "this client",
                        "if it is a daemon with authentication, pass --credentials FOLDER",
                    ),
                };
                let message =
                    format!("something listens at {endpoint} but rejected {who}: {remedy}");
                Failure::new("permission_denied", message)
            }
            Error::WrongName {
                endpoint,
                host,
                names,
            } => wrong_name(endpoint, host, names),
            Error::NoNode { endpoint, prefix } => {
                let message = format!(
                    "zenoh answers at {endpoint}, but no daemon is reachable under the prefix \
                     `{prefix}`: start one with `jostled serve`, or name another with -e, or its \
                     prefix with --prefix"
                );
                Failure::new("unreachable", message)
            }
            Error::UnknownNode { node, there } => {
                let question = did_you_mean(node, there).map(|question| format!("; {question}"));
                let message = format!(
                    "no node {node} here; the nodes are: {}{}",
                    there.join(", "),
                    question.unwrap_or_default()
                );
                Failure::new("not_found", message).with("nodes", there.as_slice())
            }
            Error::ManyNodes { there } => {
                let list = there.join(", ");
                let message =
                    format!("several nodes are reachable, select one with --node: {list}");
                Failure::new("invalid_argument", message).with("nodes", there.as_slice())
            }
            Error::NoSwarm { swarm, there } => {
                let what = format!("swarm {swarm} on this daemon");
                Failure::unknown(&what, swarm, there, "jostle list").with("swarm", swarm.as_str())
            }
            Error::NotRecovered { swarm } => {
                let message = format!(
                    "the daemon is back, but without {swarm}: `jostle create` creates it again"
                );
                Failure::new("not_found", message)
            }
            Error::Silent { target } => {
                let message = format!(
                    "{target} exists but does not reply: it forbids this client such requests, or it \
                     is shutting down"
                );
                Failure::new("permission_denied", message)
            }
            Error::TimedOut { target, secs } => {
                let message = format!(
                    "{target} did not reply within {secs} s: it may still execute the request; \
                     --timeout waits longer"
                );
                Failure::new("timeout", message)
            }
            Error::TooLarge { bytes, limit } => {
                let message = format!(
                    "the request is {bytes} bytes long, the limit of the daemon is {limit}: split it"
                );
                Failure::new("resource_exhausted", message)
            }
            Error::Decode { problem } => Failure::unreadable(problem),
            error => Failure::defect(error),
        };
        let kind = Kind::Request(Box::new(error));
        Failure { kind, ..failure }
    }
}

/// The certificate of the daemon does not name the host of the endpoint.
fn wrong_name(endpoint: &str, host: &str, names: &[String]) -> Failure {
    // Every certificate of a daemon has these.
    let own = ["localhost", "127.0.0.1", "::1"];
    let others = names.iter().map(String::as_str);
    let hosts = others.filter(|name| !own.contains(name)).chain([host]);
    let hosts: String = hosts.map(|name| format!(" --host {name}")).collect();
    let message = format!(
        "the certificate of the daemon at {endpoint} does not name {host}; it names {}: connect by \
         one of these, or run `jostled auth address{hosts} --auth-dir FOLDER` on the daemon's machine \
         and restart the daemon",
        names.join(", ")
    );
    Failure::new("unreachable", message)
        .with("endpoint", endpoint)
        .with("host", host)
        .with("names", names)
}

impl Display for Failure {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&self.message)
    }
}

/// Requests and fields of the wire in the daemon's remedies, and their names here.
const REMEDIES: [(&str, &str); 11] = [
    (
        "the work goes on; get/wait replies when it is done, timeout_secs waits longer",
        "it continues; `jostle status` shows it, and a longer --timeout waits longer",
    ),
    (
        "the work goes on; the same request gets the reply if it has a request_id, timeout_secs waits longer",
        "it continues; a longer --timeout waits longer",
    ),
    (
        "the replay has ended; timeout_secs waits longer",
        "the replay has ended; a longer --timeout waits longer",
    ),
    (
        "the node's get/swarms lists what there is",
        "`jostle list` lists them",
    ),
    (
        "the node's get/experiments lists the experiments",
        "`jostle experiment list` lists them",
    ),
    (
        "the node's get/recordings lists the recordings",
        "`jostle record --list` lists them",
    ),
    ("set exist_ok to use it", "--exist-ok uses it"),
    ("set make_room to", "--make-room to"),
    ("or null for as fast", "or max for as fast"),
    ("look at get/journal", "look at `jostle journal`"),
    // Only `leave` gets it here.
    (
        "has joined: join first",
        "has joined: `jostle controllers` lists them",
    ),
];

/// The daemon's message with the options of the command line.
fn with_options(message: &str) -> String {
    // The end of a run, which may have been given as a time.
    let message = match message.strip_prefix("until_step ") {
        Some(rest) if rest.contains(" is in the past") => {
            format!("the end, step {}", rest.replacen(" is in", ", is in", 1))
        }
        _ => message.to_owned(),
    };
    REMEDIES.iter().fold(message, |message, (remedy, here)| {
        message.replace(remedy, here)
    })
}

/// The end of a run.
#[derive(Clone, Debug)]
pub enum RunEnd {
    /// A `pause`.
    Pause,
    /// This step.
    Step(u64),
    /// The first step after which a condition holds.
    Condition {
        /// The condition.
        text: String,
        /// By which `when --cancel` removes it; daemons of earlier versions do not say it.
        id: Option<String>,
    },
}

impl RunEnd {
    /// That a swarm continues without the command line.
    pub fn runs_on(&self, swarm: &str) -> String {
        let until = match self {
            RunEnd::Pause => String::new(),
            RunEnd::Step(step) => format!(" until step {step}"),
            RunEnd::Condition { text, .. } => format!(" until {text}"),
        };
        let left = self.left_in(swarm);
        format!("{swarm} runs on{until}; `jostle pause {swarm}` pauses it{left}")
    }

    /// That the condition is not removed with the wait, if there is one.
    fn left_in(&self, swarm: &str) -> String {
        match self {
            RunEnd::Condition { id, .. } => {
                let id = id.as_deref().unwrap_or("ID");
                format!(", and `jostle when {swarm} --cancel {id}` removes the condition")
            }
            RunEnd::Pause | RunEnd::Step(_) => String::new(),
        }
    }
}

/// The wire name of a code.
fn name(code: ErrorCode) -> String {
    match json!(code) {
        Value::String(name) => name,
        other => other.to_string(),
    }
}

fn in_parentheses(reason: Option<&str>) -> String {
    reason.map_or_else(String::new, |reason| format!(" ({reason})"))
}

/// Whether the cause of an error is a full disk.
fn is_full(error: &(dyn std::error::Error + 'static)) -> bool {
    let system = error.downcast_ref::<io::Error>().map(io::Error::kind);
    let full = matches!(
        system,
        Some(io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
    );
    full || error.source().is_some_and(is_full)
}

#[cfg(test)]
mod tests {
    use jostle_figures::SaveError;

    use super::*;

    fn rejected(code: ErrorCode) -> Failure {
        Failure::rejected(jostle_proto::Error {
            code,
            message: "no".into(),
            details: Map::new(),
            step: Some(7),
        })
    }

    #[test]
    fn every_code_of_the_wire_has_the_exit_code_in_the_help() {
        let table = [
            (ErrorCode::NotFound, "not_found", 3),
            (ErrorCode::AlreadyExists, "already_exists", 4),
            (ErrorCode::InvalidArgument, "invalid_argument", 2),
            (ErrorCode::IncorrectState, "incorrect_state", 4),
            (ErrorCode::ResourceExhausted, "resource_exhausted", 7),
            (ErrorCode::Busy, "busy", 7),
            (ErrorCode::Conflict, "conflict", 4),
            (ErrorCode::Contested, "contested", 4),
            (ErrorCode::PermissionDenied, "permission_denied", 5),
            (ErrorCode::StorageFull, "storage_full", 8),
            (ErrorCode::DeadlineExceeded, "deadline_exceeded", 6),
            (ErrorCode::Faulted, "faulted", 1),
            (ErrorCode::Internal, "internal", 1),
        ];
        for (code, name, exit_code) in table {
            let failure = rejected(code);
            assert_eq!((failure.code(), failure.exit_code()), (name, exit_code));
        }
    }

    #[test]
    fn failures_of_the_client_have_exit_codes_too() {
        let exit_code = |error: Error| Failure::from(error).exit_code();
        let (endpoint, cause) = ("tcp/127.0.0.1:1".into(), String::new());
        assert_eq!(exit_code(Error::NoDaemon { endpoint, cause }), 6);
        let target = "demo".into();
        assert_eq!(exit_code(Error::Silent { target }), 5);
        assert_eq!(Failure::interrupted().exit_code(), 130);
        let full = || io::Error::from(io::ErrorKind::StorageFull);
        let picture = SaveError::Io {
            path: "a.svg".into(),
            source: full(),
        };
        assert_eq!(Failure::results(picture).exit_code(), 8);
        assert_eq!(Failure::file("a.snapshot", full()).exit_code(), 8);
        assert_eq!(Failure::output(StdoutError::Closed).exit_code(), 0);
        let (swarm, there) = ("demo".into(), vec!["demos".into(), "herd".into()]);
        let swarm = Failure::from(Error::NoSwarm { swarm, there });
        assert_eq!(swarm.exit_code(), 3);
        assert!(
            swarm.to_string().contains("did you mean `demos`?"),
            "{swarm}"
        );
        assert_eq!(swarm.to_json()["details"]["nearest"], json!(["demos"]));
    }

    #[test]
    fn remedies_of_the_daemon_name_options_of_the_command_line() {
        for (message, expected) in [
            (
                "not done within 1 s: the work goes on; get/wait replies when it is done, \
                 timeout_secs waits longer",
                "not done within 1 s: it continues; `jostle status` shows it, and a longer \
                 --timeout waits longer",
            ),
            (
                "not done within 1 s: the work goes on; the same request gets the reply if it has a \
                 request_id, timeout_secs waits longer",
                "not done within 1 s: it continues; a longer --timeout waits longer",
            ),
            (
                "not done within 1 s: the replay has ended; timeout_secs waits longer",
                "not done within 1 s: the replay has ended; a longer --timeout waits longer",
            ),
            (
                "there is no swarm \"a\": the node's get/swarms lists what there is",
                "there is no swarm \"a\": `jostle list` lists them",
            ),
            (
                "until_step 50 is in the past, the swarm is at step 60: name a later one",
                "the end, step 50, is in the past, the swarm is at step 60: name a later one",
            ),
        ] {
            let failure = Failure::rejected(jostle_proto::Error {
                code: ErrorCode::NotFound,
                message: message.into(),
                details: Map::new(),
                step: None,
            });
            assert_eq!(failure.to_string(), expected);
            assert_eq!(failure.to_json()["message"], expected);
        }
    }

    #[test]
    fn programs_read_the_advice_too() {
        let rejected = rejected(ErrorCode::Conflict).with_advice(Some("rather this".into()));
        assert_eq!(rejected.to_string(), "no; rather this");
        let json = rejected.to_json();
        assert_eq!(
            json,
            json!({"code": "conflict", "message": "no; rather this", "details": {}, "step": 7})
        );
    }
}
