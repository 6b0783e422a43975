//! `inform`, `uninform`, `inject` and `remove`: some of a swarm's individuals.

use jostle_proto::Reply;
use jostle_proto::verbs::{IdsResult, InformArgs, InjectArgs, RemoveArgs, UninformArgs};

use crate::arguments::{InformArguments, InjectArguments, SelectArguments};
use crate::bus::{Answer, Bus};
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::selection::radians;
use crate::verbs::print_outcome;

/// Gives individuals a direction.
///
/// # Errors
///
/// Why nobody was informed.
pub async fn inform(bus: &Bus, output: Output, arguments: &InformArguments) -> Result<(), Failure> {
    let InformArguments { name, sending, .. } = arguments;
    let direction = radians(arguments.direction, arguments.degrees);
    let args = InformArgs {
        select: arguments.selection.select(),
        direction: direction.expect("clap asks for one of the two"),
        weight: arguments.weight,
        for_time: arguments.for_time,
    };
    let answer = bus.command(name, "inform", &args, sending).await?;
    tell(output, &answer, "inform", "informed")
}

/// Takes individuals' direction away.
///
/// # Errors
///
/// Why nobody was uninformed.
pub async fn uninform(
    bus: &Bus,
    output: Output,
    arguments: &SelectArguments,
) -> Result<(), Failure> {
    let SelectArguments { name, sending, .. } = arguments;
    let args = UninformArgs {
        select: arguments.selection.select(),
    };
    let answer = bus.command(name, "uninform", &args, sending).await?;
    tell(output, &answer, "uninform", "uninformed")
}

/// Adds individuals.
///
/// # Errors
///
/// Why nobody was added.
pub async fn inject(bus: &Bus, output: Output, arguments: &InjectArguments) -> Result<(), Failure> {
    let InjectArguments {
        name, at, sending, ..
    } = arguments;
    let args = InjectArgs {
        count: arguments.count,
        at: (!at.is_empty()).then(|| at.clone()),
        within: arguments.within,
        direction: radians(arguments.direction, arguments.degrees),
        weight: arguments.weight,
    };
    let answer = bus.command(name, "inject", &args, sending).await?;
    tell(output, &answer, "inject", "injected")
}

/// Takes individuals out of the group.
///
/// # Errors
///
/// Why nobody was removed.
pub async fn remove(bus: &Bus, output: Output, arguments: &SelectArguments) -> Result<(), Failure> {
    let SelectArguments { name, sending, .. } = arguments;
    let args = RemoveArgs {
        select: arguments.selection.select(),
    };
    let answer = bus.command(name, "remove", &args, sending).await?;
    tell(output, &answer, "remove", "removed")
}

/// Says who it was about.
fn tell(output: Output, answer: &Answer, verb: &str, done: &str) -> Result<(), Failure> {
    print_outcome(output, answer, verb, |reply: &Reply<IdsResult>| {
        let whom = whom(&reply.result.ids);
        let (swarm, step, n) = (&reply.swarm, reply.step, reply.result.n);
        format!("{done} {whom} at step {step}; {swarm} has {n}")
    })
}

/// How many, and who.
pub fn whom(ids: &[u32]) -> String {
    match ids.len() {
        0 => "no individual".into(),
        count => format!("{count} ({})", format::ids(ids)),
    }
}
