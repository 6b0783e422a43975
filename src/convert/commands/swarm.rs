//! The arguments of commands to a swarm that need more than their types.

use std::sync::Arc;

use jostle_conditions::Condition;
use jostle_convert::{WireError, change, value};
use jostle_physics::simulation::Change;
use jostle_proto::verbs::{
    self as proto, AdvanceArgs, AnnotateArgs, BatchArgs, JoinArgs, MAX_NOTE_CHARS, RunArgs,
    WhenArgs,
};
use jostle_proto::{RequestError, SeekArgs};

use crate::convert::commands::{CommandError, args_of_change, check_name, is_legible};
use crate::swarm::command::{Command, Seek, Until, Which};
use crate::swarm::membership::{self, ControllerSettings, JoinOptions};
use crate::swarm::sender::Sender;
use crate::swarm::watch::{Action, Draws, Watch};

/// Maximum steps of one command.
const MAX_STEPS: u64 = 1_000_000_000;

/// Maximum end of a run, and time to seek: longer than any run, and exact as a number of steps.
const MAX_TIME: f64 = 1e12;

/// Maximum length of the name of an event.
const MAX_EVENT_CHARS: usize = 64;

/// Parameters of a spec that cannot change.
const CHOSEN_AT_CREATION: [&str; 4] = ["n", "dt", "seed", "start"];

/// `run`: steps at a rate, until a step or time, or without end.
pub fn run(args: RunArgs) -> Result<Command, CommandError> {
    let until = match (args.until_step, args.until_time) {
        (Some(_), Some(_)) => {
            let problem = "and until_step are both given: name one end";
            return Err(CommandError::field("until_time", problem));
        }
        (Some(step), None) => Some(Until::Step(value::whole("until_step", step)?)),
        (None, Some(time)) if (0.0..=MAX_TIME).contains(&time) => Some(Until::Time(time)),
        (None, Some(time)) => return Err(WireError::out_of_range("until_time", time).into()),
        (None, None) => None,
    };
    let rate = args.rate.map(value::rate).transpose()?;
    Ok(Command::Run { until, rate })
}

/// `advance`: a controller permits steps; the swarm takes them when all controllers have.
pub fn advance(args: AdvanceArgs) -> Result<Command, CommandError> {
    check_name("controller", &args.controller)?;
    Ok(Command::Advance {
        controller: args.controller,
        steps: count(args.steps)?,
        set: args.set.map(change::set_points).transpose()?,
    })
}

/// Checks the number of steps.
pub fn count(steps: u64) -> Result<u64, CommandError> {
    if (1..=MAX_STEPS).contains(&steps) {
        return Ok(steps);
    }
    Err(WireError::out_of_range("steps", steps).into())
}

/// `batch`: all of several changes at one step, or none.
pub fn batch(args: BatchArgs) -> Result<Command, CommandError> {
    let changes = changes(args.commands)?;
    let draws = draws(args.draw, args.protocol)?;
    Ok(Command::Batch { changes, draws })
}

fn draws(draw: Option<u64>, is_of_protocol: bool) -> Result<Draws, CommandError> {
    Ok(match draw {
        Some(draw) => Draws::From(value::whole("draw", draw)?),
        None if is_of_protocol => Draws::Protocol,
        None => Draws::Command,
    })
}

fn changes(commands: Vec<proto::Change>) -> Result<Vec<Change>, CommandError> {
    // The parser rejects more than the maximum.
    if commands.is_empty() {
        let problem = "holds none: give at least one";
        return Err(CommandError::field("commands", problem));
    }
    let mut changes = Vec::with_capacity(commands.len());
    for (index, command) in commands.into_iter().enumerate() {
        let within = |error| CommandError::from(error).within(args_of_change(index));
        changes.push(change::change(command).map_err(within)?);
    }
    Ok(changes)
}

/// `when`: an action once a condition holds, or the end of those that wait.
pub fn when(args: WhenArgs) -> Result<Command, CommandError> {
    if let Some(event) = &args.event {
        check_event(event)?;
    }
    let Some(text) = &args.condition else {
        return cancel(args);
    };
    if args.cancel {
        let problem = "removes waiting conditions: give it without condition";
        return Err(CommandError::field("cancel", problem));
    }
    if args.id.is_some() {
        let problem = "is chosen by the daemon: give it with cancel";
        return Err(CommandError::field("id", problem));
    }
    let condition = Condition::parse(text)?;
    // The journal and checkpoints have the normal form, or the text if the normal form is longer than a
    // condition may be.
    let normal = condition.to_string();
    let is_read_again = Condition::parse(&normal).is_ok();
    let fired = WhenArgs {
        condition: Some(if is_read_again { normal } else { text.clone() }),
        ..args
    };
    // Arguments that were read can be written.
    let text = serde_json::to_string(&fired).map_err(|_| CommandError::Internal)?;
    let step = |field, step: Option<u64>| step.map(|it| value::whole(field, it)).transpose();
    let (from, before) = (
        step("from_step", fired.from_step)?,
        step("before_step", fired.before_step)?,
    );
    if before.is_some_and(|before| before <= from.unwrap_or(0)) {
        let problem = "is not after from_step: no state lies between them";
        return Err(CommandError::field("before_step", problem));
    }
    if fired.draw.is_some() && fired.commands.is_none() {
        let problem = "is the key of the draws of commands: give it with commands";
        return Err(CommandError::field("draw", problem));
    }
    let draws = draws(fired.draw, fired.protocol)?;
    let action = match (fired.pause, fired.commands, fired.event) {
        (true, None, None) if fired.protocol => Action::Stop,
        (true, None, None) => Action::Pause,
        (false, Some(commands), None) => Action::Batch(changes(commands)?, draws),
        (false, None, Some(event)) if !fired.protocol => Action::Event(event.into()),
        _ => {
            let problem = "commands and event are alternatives: give \"pause\": true, commands, or event \
                           without protocol";
            return Err(CommandError::field("pause", problem));
        }
    };
    Ok(Command::Watch(Box::new(Watch {
        condition,
        action,
        from,
        before,
        is_protocol: fired.protocol,
        fired: Arc::new(Sender {
            verb: "fired",
            args: text,
            ..Sender::default()
        }),
    })))
}

/// `when` without a condition: the end of all that wait, or of the one with an event or of an id.
fn cancel(args: WhenArgs) -> Result<Command, CommandError> {
    let alone = WhenArgs {
        cancel: true,
        event: args.event.clone(),
        id: args.id.clone(),
        ..WhenArgs::default()
    };
    if args != alone {
        let problem = "is missing: give a condition, such as \"order > 0.9\", or cancel alone";
        return Err(CommandError::field("condition", problem));
    }
    Ok(Command::Unwatch(match (args.event, args.id) {
        (None, None) => Which::All,
        (Some(event), None) => Which::Event(event.into()),
        (None, Some(id)) => {
            check_name("id", &id)?;
            Which::Id(id)
        }
        (Some(_), Some(_)) => {
            let problem = "and event name one condition each: give one of them";
            return Err(CommandError::field("id", problem));
        }
    }))
}

/// Checks the name of an event.
pub fn check_event(event: &str) -> Result<(), CommandError> {
    let length = event.chars().count();
    if (1..=MAX_EVENT_CHARS).contains(&length) && !event.contains(char::is_control) {
        return Ok(());
    }
    let problem = "must have 1 to 64 characters, and no control characters";
    Err(CommandError::field("event", problem))
}

/// `fired`, from the journal: the condition of a `when` holds.
pub fn fired(args: WhenArgs) -> Result<Command, CommandError> {
    match when(args)? {
        Command::Watch(watch) => Ok(Command::Fired(watch)),
        _ => Err(CommandError::field("condition", "is missing")),
    }
}

/// `join`: registers a controller.
pub fn join(args: JoinArgs) -> Result<Command, CommandError> {
    check_name("controller", &args.controller)?;
    let deadline = membership::deadline(args.deadline_secs)
        .ok_or_else(|| WireError::out_of_range("deadline_secs", args.deadline_secs))?;
    Ok(Command::Join(JoinOptions {
        controller: args.controller,
        selection: args.select.map(change::selection).transpose()?,
        settings: ControllerSettings {
            mode: args.mode.into(),
            deadline,
            on_timeout: args.on_timeout.into(),
            driving: args.driving,
        },
        again: args.again,
    }))
}

/// `seek`: moves a playback to another frame.
pub fn seek(args: SeekArgs) -> Result<Seek, CommandError> {
    match (args.step, args.time, args.fraction) {
        (Some(step), None, None) => Ok(Seek::Step(value::whole("step", step)?)),
        (None, Some(time), None) if (0.0..=MAX_TIME).contains(&time) => Ok(Seek::Time(time)),
        (None, Some(time), None) => Err(WireError::out_of_range("time", time).into()),
        (None, None, Some(share)) if (0.0..=1.0).contains(&share) => Ok(Seek::Fraction(share)),
        (None, None, Some(share)) => Err(WireError::out_of_range("fraction", share).into()),
        _ => {
            let problem = "must have exactly one of step, time and fraction";
            Err(CommandError::field("args", problem))
        }
    }
}

/// Checks the text of `annotate`.
pub fn check_note(args: &AnnotateArgs) -> Result<(), CommandError> {
    let chars = args.text.chars().count();
    if !(1..=MAX_NOTE_CHARS).contains(&chars) {
        return Err(CommandError::field(
            "text",
            "must have 1 to 1000 characters",
        ));
    }
    if !is_legible(&args.text) {
        let problem = "has control or bidirectional formatting characters, or none that is visible: write \
                       one line without them";
        return Err(CommandError::field("text", problem));
    }
    Ok(())
}

/// Returns an error with the alternatives for parameters that cannot change.
pub fn explain_set(error: RequestError) -> CommandError {
    let field = CHOSEN_AT_CREATION
        .iter()
        .find(|field| **field == error.field && error.problem.starts_with("unknown field"));
    match field {
        Some(field) => CommandError::Field {
            field,
            problem: "is chosen at creation and never set: create a swarm with it, or give \
                      reset a new seed; inject and remove change how many there are",
        },
        None => error.into(),
    }
}
