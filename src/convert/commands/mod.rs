//! Converts the arguments of requests to commands.
//!
//! An error names the field, its range and the remedy.

use std::sync::Arc;
use std::time::Duration;

use jostle_convert::value::{new_max_idle_secs, whole};
use jostle_convert::{WireError, change};
use jostle_physics::simulation::Change;
use jostle_proto::contract::selectors::QueryParameter;
use jostle_proto::verbs::{
    AdvanceArgs, AnnotateArgs, DeleteArgs, LeaveArgs, OwnVerb, PauseArgs, ProtectArgs, ResetArgs,
    Return, StepArgs, SwarmVerb,
};
use jostle_proto::{MAX_LABEL_LENGTH, Request, is_plain, keys};
use unicode_width::UnicodeWidthStr as _;

use crate::swarm::command::{Command, When};
use crate::swarm::handle::{CommandMessage, ReplyTo};
use crate::swarm::sender::Sender;

pub mod create;
pub mod measures;
pub mod set_points;
pub mod swarm;
pub mod wait;

pub use crate::convert::error::{CommandError, args_of_change};

/// Timeout of a request without `timeout_secs`.
pub const DEFAULT_TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum timeout of a request, in seconds.
const MAX_TIMEOUT_SECS: f64 = 3600.0;

/// Parses a command to a swarm, and whether its reply contains the state.
pub fn read(verb: &str, request: &Request) -> Result<(CommandMessage, bool), CommandError> {
    let verb = SwarmVerb::of(verb).ok_or_else(|| unknown_verb(verb))?;
    let (command, returns_state) = parse(verb, request)?;
    let at_step = request.at_step;
    let at_step = at_step.map(|step| whole("at_step", step));
    let message = CommandMessage {
        command,
        when: When {
            at_step: at_step.transpose()?,
            expect_epoch: request.expect_epoch,
            expect_step: request.expect_step,
        },
        sender: Arc::new(sender(verb.name(), request)?),
        user: None,
        reply_to: ReplyTo::ignored(),
    };
    Ok((message, returns_state))
}

fn unknown_verb(verb: &str) -> CommandError {
    CommandError::UnknownVerb {
        verb: truncate(verb),
        known: &keys::SWARM_VERBS,
    }
}

/// Parses the arguments of a command, and whether its reply contains the state.
fn parse(verb: SwarmVerb, request: &Request) -> Result<(Command, bool), CommandError> {
    let mut returns_state = false;
    let command = match verb {
        SwarmVerb::Delete => {
            let DeleteArgs {} = request.args()?;
            Command::Delete
        }
        SwarmVerb::Run => swarm::run(request.args()?)?,
        SwarmVerb::Pause => {
            let PauseArgs {} = request.args()?;
            Command::Pause
        }
        SwarmVerb::Step => {
            let args: StepArgs = request.args()?;
            returns_state = args.return_ == Return::State;
            Command::Step(swarm::count(args.steps)?)
        }
        SwarmVerb::Reset => {
            let ResetArgs { seed } = request.args()?;
            Command::Reset(seed.map(|seed| whole("seed", seed)).transpose()?)
        }
        SwarmVerb::Set => {
            Command::Change(change::set(request.args().map_err(swarm::explain_set)?)?)
        }
        SwarmVerb::Inform => Command::Change(change::inform(request.args()?)?),
        SwarmVerb::Uninform => Command::Change(change::uninform(request.args()?)?),
        SwarmVerb::Inject => Command::Change(change::inject(request.args()?)?),
        SwarmVerb::Remove => Command::Change(change::remove(request.args()?)?),
        SwarmVerb::Batch => swarm::batch(request.args()?)?,
        SwarmVerb::Join => swarm::join(request.args()?)?,
        SwarmVerb::Advance => {
            if request.at_step.is_some() {
                let problem = "cannot schedule an advance: a controller advances from the step of the \
                               swarm: leave it out";
                return Err(CommandError::field("at_step", problem));
            }
            let args: AdvanceArgs = request.args()?;
            returns_state = args.return_ == Return::State;
            swarm::advance(args)?
        }
        SwarmVerb::Leave => Command::Leave(controller(request)?),
        SwarmVerb::Annotate => {
            swarm::check_note(&request.args()?)?;
            Command::Annotate
        }
        SwarmVerb::When => swarm::when(request.args()?)?,
        SwarmVerb::Protect => {
            let ProtectArgs { on } = request.args()?;
            Command::Protect(on)
        }
        // The registry forks, and a playback seeks: a swarm executes neither.
        SwarmVerb::Fork | SwarmVerb::Seek => return Err(unknown_verb(verb.name())),
    };
    Ok((command, returns_state))
}

/// Checks what the changes of a new command have in ranges that were larger in earlier versions.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn check_new(command: &Command) -> Result<(), CommandError> {
    for (index, change) in command.changes().iter().enumerate() {
        if let Change::Set(settings) = change
            && let Some(secs) = settings.max_idle_secs
        {
            let checked = new_max_idle_secs(secs).map_err(CommandError::from);
            checked.map_err(|error| match command {
                Command::Change(_) => error,
                _ => error.within(args_of_change(index)),
            })?;
        }
    }
    Ok(())
}

/// Parses a command from the journal: one of a client, or one that the swarm gave itself.
pub fn read_journaled(verb: &str, request: &Request) -> Result<(Command, bool), CommandError> {
    if let Some(verb) = OwnVerb::of(verb) {
        return Ok((own(verb, request)?, false));
    }
    match SwarmVerb::of(verb).ok_or_else(|| unknown_verb(verb))? {
        // Earlier versions accepted more characters.
        SwarmVerb::Annotate => {
            let AnnotateArgs { .. } = request.args()?;
            Ok((Command::Annotate, false))
        }
        verb => parse(verb, request),
    }
}

/// Parses a command that the swarm gave itself.
pub fn own(verb: OwnVerb, request: &Request) -> Result<Command, CommandError> {
    Ok(match verb {
        OwnVerb::Deadline => Command::Deadline(controller(request)?),
        OwnVerb::Lost => Command::Lost(controller(request)?),
        OwnVerb::Idle => Command::Idle(controller(request)?),
        OwnVerb::Fired => swarm::fired(request.args()?)?,
        OwnVerb::Control => set_points::parse_journaled(request)?,
    })
}

fn controller(request: &Request) -> Result<String, CommandError> {
    let LeaveArgs { controller } = request.args()?;
    check_name("controller", &controller)?;
    Ok(controller)
}

/// Returns the timeout of a request.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn timeout(request: &Request) -> Result<Duration, CommandError> {
    match request.timeout_secs {
        None => Ok(DEFAULT_TIMEOUT),
        Some(secs) => check_timeout(secs),
    }
}

/// Checks a timeout.
///
/// # Errors
///
/// [`WireError::OutOfRange`].
pub fn check_timeout(secs: f64) -> Result<Duration, CommandError> {
    match secs > 0.0 && secs <= MAX_TIMEOUT_SECS {
        true => Ok(duration(secs)),
        false => Err(WireError::out_of_range("timeout_secs", secs).into()),
    }
}

/// Converts seconds above 0 to a duration, at least a nanosecond.
fn duration(secs: f64) -> Duration {
    Duration::from_secs_f64(secs).max(Duration::from_nanos(1))
}

/// Returns the parameters of a selector, each of which must be one of `known` and occur once.
/// Parameters of zenoh itself, which begin with `_`, are left out.
///
/// # Errors
///
/// [`CommandError::Parameter`] and [`CommandError::Twice`].
pub fn selector<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
    known: &'static [QueryParameter],
) -> Result<Vec<(&'static str, &'a str)>, CommandError> {
    let mut read: Vec<(&'static str, &str)> = Vec::new();
    for (name, value) in parameters {
        if name.starts_with('_') {
            continue;
        }
        let Some(name) = known.iter().map(|it| it.name).find(|it| *it == name) else {
            return Err(CommandError::Parameter {
                name: truncate(name),
                known,
            });
        };
        if read.iter().any(|(before, _)| *before == name) {
            return Err(CommandError::Twice(name));
        }
        read.push((name, value));
    }
    Ok(read)
}

/// Returns the start of an unknown word or of an invalid name, for an error.
pub fn truncate(word: &str) -> String {
    word.chars().take(keys::MAX_NAME_LENGTH).collect()
}

/// Checks a name that becomes a part of a key.
///
/// # Errors
///
/// [`CommandError::Name`].
pub fn check_name(field: &'static str, name: &str) -> Result<(), CommandError> {
    if keys::is_name(name) {
        return Ok(());
    }
    let name = truncate(name);
    Err(CommandError::Name { field, name })
}

/// Whether a text has characters that are safe to print, at least one of them visible.
pub(crate) fn is_legible(text: &str) -> bool {
    text.chars().all(is_plain) && text.trim().width() > 0
}

/// Returns the sender of a request, with its verb and arguments.
///
/// # Errors
///
/// [`CommandError::Field`] for an invalid `client` or `request_id`.
pub fn sender(verb: &'static str, request: &Request) -> Result<Sender, CommandError> {
    let label = |field, label: &Option<String>| match label {
        Some(text) if !text.is_empty() && (text.len() > MAX_LABEL_LENGTH || !is_legible(text)) => {
            let problem = "is too long, has control or bidirectional formatting characters, or none that \
                           is visible";
            Err(CommandError::field(field, problem))
        }
        other => Ok(other.clone()),
    };
    Ok(Sender {
        verb,
        args: request
            .args
            .as_ref()
            .map_or_else(|| "{}".into(), |args| args.get().to_owned()),
        client: label("client", &request.client)?,
        request_id: label("request_id", &request.request_id)?,
        digest: None,
    })
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn a_journal_may_have_times_that_are_no_longer_accepted() {
        let request = |secs: f64| {
            let args = serde_json::json!({"args": {"max_idle_secs": secs}}).to_string();
            Request::from_json(args.as_bytes()).unwrap()
        };
        for (secs, is_accepted) in [(1e-300, false), (0.099, false), (0.1, true), (0.0, true)] {
            let (command, _) = read_journaled("set", &request(secs)).unwrap();
            let checked = check_new(&command);
            assert_eq!(checked.is_ok(), is_accepted, "{secs}: {checked:?}");
        }
    }

    #[test]
    fn a_journal_may_have_notes_that_are_no_longer_accepted() {
        for text in ["a\u{200e}b", "\u{61c}", " \u{200b}", "\u{3164}\u{ad}"] {
            let args = serde_json::json!({"text": text}).to_string();
            let request = Request::from_json(args.as_bytes()).unwrap();
            assert!(read("annotate", &request).is_err(), "{text:?}");
            let (command, _) = read_journaled("annotate", &request).unwrap();
            assert_eq!(command, Command::Annotate, "{text:?}");
        }
    }
}
