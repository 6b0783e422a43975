//! What each verb does: arguments to a request, the answer to words or JSON.

mod create;
mod individuals;
mod run;
mod show;
mod steer;
mod watch;

use jostle_proto::Reply;
use serde::de::DeserializeOwned;

use crate::arguments::{Arguments, Verb};
use crate::bus::{Answer, Bus};
use crate::failure::Failure;
use crate::format;
use crate::interrupt;
use crate::output::Output;

/// Connects, does what was asked for and says goodbye.
///
/// # Errors
///
/// Why it was not done.
pub async fn execute(arguments: Arguments, output: Output) -> Result<(), Failure> {
    let bus = interrupt::either(Bus::open(arguments.global)).await?;
    let outcome = match arguments.verb {
        // These two have something to say when interrupted.
        Verb::Run(arguments) => run::run(&bus, output, &arguments).await,
        Verb::Watch(arguments) => watch::watch(&bus, output, &arguments).await,
        verb => interrupt::either(once(&bus, output, verb)).await,
    };
    if !matches!(outcome, Err(Failure::Interrupted { .. })) {
        bus.close().await;
    }
    outcome
}

/// The verbs that are one request and one answer.
async fn once(bus: &Bus, output: Output, verb: Verb) -> Result<(), Failure> {
    match verb {
        Verb::Create(arguments) => create::create(bus, output, &arguments).await,
        Verb::List => show::list(bus, output).await,
        Verb::Status(arguments) => show::status(bus, output, &arguments.name).await,
        Verb::Spec(arguments) => show::spec(bus, output, &arguments.name).await,
        Verb::Pause(arguments) => steer::pause(bus, output, &arguments.name).await,
        Verb::Step(arguments) => steer::step(bus, output, &arguments).await,
        Verb::Reset(arguments) => steer::reset(bus, output, &arguments).await,
        Verb::Set(arguments) => steer::set(bus, output, &arguments).await,
        Verb::Delete(arguments) => steer::delete(bus, output, &arguments).await,
        Verb::Inform(arguments) => individuals::inform(bus, output, &arguments).await,
        Verb::Uninform(arguments) => individuals::uninform(bus, output, &arguments).await,
        Verb::Inject(arguments) => individuals::inject(bus, output, &arguments).await,
        Verb::Remove(arguments) => individuals::remove(bus, output, &arguments).await,
        Verb::Run(arguments) => run::run(bus, output, &arguments).await,
        Verb::Watch(arguments) => watch::watch(bus, output, &arguments).await,
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

/// Where a swarm stands, as the end of a sentence.
fn place<T>(reply: &Reply<T>) -> String {
    format!(
        "{} at step {}, time {}",
        format::phase(reply.phase),
        reply.step,
        format::time(reply.time)
    )
}
