//! What each verb does: arguments to a request, the answer to words or JSON.

mod auth;
mod batch;
mod claims;
mod copies;
mod create;
mod delete;
mod diff;
mod doctor;
mod events;
mod experiment;
mod figure;
mod individuals;
mod look;
mod lookout;
mod record;
mod replay;
mod results;
mod run;
mod schema;
mod shell;
mod steer;
mod verify;
mod watch;

use std::sync::Arc;
use std::time::Duration;

use jostle_proto::Reply;
use jostle_proto::verbs::Scheduled;
use serde::de::DeserializeOwned;

use crate::arguments::{
    Arguments, Experiment, ExperimentArguments, GlobalArguments, RecordArguments, Verb,
};
use crate::bus::{Answer, Bus};
use crate::failure::Failure;
use crate::format;
use crate::interrupt;
use crate::output::Output;
use crate::values::Figure;
pub use crate::verbs::watch::give_back_the_terminal;

/// Connects, does what was asked for and says goodbye.
///
/// # Errors
///
/// Why it was not done.
pub async fn execute(arguments: Arguments, output: Output) -> Result<(), Failure> {
    let Arguments { global, verb } = arguments;
    // These need no daemon, or want to see for themselves.
    let verb = match verb {
        Verb::Completions(arguments) => return shell::completions(output, &arguments),
        Verb::Man(arguments) => return shell::man(output, &arguments),
        Verb::Claims(arguments) => return claims::judge(output, &arguments),
        Verb::Results(arguments) => return results::results(output, &arguments.what),
        Verb::Experiment(ExperimentArguments {
            what: Experiment::Plan(arguments),
        }) => return experiment::plan(output, &arguments),
        Verb::Doctor => return interrupt::either(doctor::doctor(output, global)).await,
        Verb::Record(RecordArguments {
            recover: Some(file),
            force,
            ..
        }) => return record::recover(output, &file, force),
        Verb::Figure(arguments) if arguments.kind != Figure::Snapshot => {
            return figure::of_results(output, &arguments);
        }
        verb => verb,
    };
    let records = records_to_file(&verb);
    match connected(global, output, verb).await {
        Err(Failure::Interrupted { left: None }) if records => Err(Failure::Interrupted {
            left: Some("nothing was recorded".into()),
        }),
        outcome => outcome,
    }
}

/// Whether a verb makes a recording in a file, which it completes before it ends.
pub fn records_to_file(verb: &Verb) -> bool {
    let Verb::Record(arguments) = verb else {
        return false;
    };
    arguments.name.is_some() && arguments.out.is_some()
}

/// Does what needs a connection, and says goodbye.
async fn connected(global: GlobalArguments, output: Output, verb: Verb) -> Result<(), Failure> {
    let bus = Arc::new(interrupt::either(Bus::open(global)).await?);
    let outcome = match verb {
        // These have something to say when interrupted.
        Verb::Run(arguments) => run::run(&bus, output, &arguments).await,
        Verb::Watch(arguments) => watch::watch(&bus, output, &arguments).await,
        Verb::Record(arguments) => record::record(&bus, output, &arguments).await,
        Verb::Experiment(arguments) => experiment::experiment(&bus, output, &arguments.what).await,
        verb => interrupt::either(once(&bus, output, verb)).await,
    };
    if !matches!(outcome, Err(Failure::Interrupted { .. })) {
        bus.close().await;
    }
    outcome
}

/// How long a verb may take to end once it is interrupted.
pub fn grace(verb: &Verb) -> Duration {
    match verb {
        // All of it is to be on the disk, however slow that is.
        // The first Ctrl-C fetches the rest; a second one leaves the rest on the daemon.
        Verb::Record(_) => Duration::from_secs(3600),
        _ => interrupt::GRACE,
    }
}

/// The verbs that end at once when interrupted.
async fn once(bus: &Bus, output: Output, verb: Verb) -> Result<(), Failure> {
    match verb {
        Verb::Create(arguments) => create::create(bus, output, &arguments).await,
        Verb::Look(arguments) => look::look(bus, output, &arguments).await,
        Verb::Events(arguments) => events::events(bus, output, &arguments).await,
        Verb::Pause(arguments) => steer::pause(bus, output, &arguments).await,
        Verb::Step(arguments) => steer::step(bus, output, &arguments).await,
        Verb::Reset(arguments) => steer::reset(bus, output, &arguments).await,
        Verb::Set(arguments) => steer::set(bus, output, &arguments).await,
        Verb::Leave(arguments) => steer::leave(bus, output, &arguments).await,
        Verb::Annotate(arguments) => steer::annotate(bus, output, &arguments).await,
        Verb::Delete(arguments) => delete::delete(bus, output, &arguments).await,
        Verb::Inform(arguments) => individuals::inform(bus, output, &arguments).await,
        Verb::Uninform(arguments) => individuals::uninform(bus, output, &arguments).await,
        Verb::Inject(arguments) => individuals::inject(bus, output, &arguments).await,
        Verb::Remove(arguments) => individuals::remove(bus, output, &arguments).await,
        Verb::Batch(arguments) => batch::batch(bus, output, &arguments).await,
        Verb::Fork(arguments) => copies::fork(bus, output, &arguments).await,
        Verb::Snapshot(arguments) => copies::snapshot(bus, output, &arguments).await,
        Verb::Restore(arguments) => copies::restore(bus, output, &arguments).await,
        Verb::Replay(arguments) => replay::replay(bus, output, &arguments).await,
        Verb::Seek(arguments) => replay::seek(bus, output, &arguments).await,
        Verb::Auth(arguments) => auth::auth(bus, output, &arguments.what).await,
        Verb::Diff(arguments) => diff::diff(bus, output, &arguments).await,
        Verb::Verify(arguments) => verify::verify(bus, output, &arguments).await,
        Verb::Figure(arguments) => figure::snapshot(bus, output, &arguments).await,
        Verb::Schema(arguments) => schema::schema(bus, output, &arguments).await,
        Verb::Run(_)
        | Verb::Watch(_)
        | Verb::Record(_)
        | Verb::Experiment(_)
        | Verb::Claims(_)
        | Verb::Results(_)
        | Verb::Doctor
        | Verb::Completions(_)
        | Verb::Man(_) => {
            unreachable!("these are carried out elsewhere")
        }
    }
}

/// Prints an answer as it came, or in the words of `tell`.
fn print<T: DeserializeOwned>(
    output: Output,
    answer: &Answer,
    tell: impl FnOnce(&T) -> String,
) -> Result<(), Failure> {
    if output.json {
        output.data(answer.json()?)
    } else {
        output.data(&tell(&answer.read()?))
    }
}

/// Prints the answer to a command as it came, that it waits for its step, or in the words of
/// `tell`.
fn print_outcome<T: DeserializeOwned>(
    output: Output,
    answer: &Answer,
    verb: &str,
    tell: impl FnOnce(&T) -> String,
) -> Result<(), Failure> {
    match scheduled(answer) {
        Some(reply) if !output.json => output.data(&format!(
            "{verb} will be applied at step {}; {} is {}",
            reply.result.applies_at_step,
            reply.swarm,
            place(&reply)
        )),
        _ => print(output, answer, tell),
    }
}

/// The answer to a command that waits for its step; no other answer says when it applies.
fn scheduled(answer: &Answer) -> Option<Reply<Scheduled>> {
    answer.read().ok()
}

/// Where a swarm stands, as the end of a sentence.
fn place<T>(reply: &Reply<T>) -> String {
    format!(
        "{} at step {}, time {}",
        format::phase(reply.phase),
        reply.step,
        format::time(reply.time)
    )
}
