//! `inform`, `uninform`, `inject` and `remove`: some of a swarm's individuals.

use jostle_proto::Reply;
use jostle_proto::verbs::{IdsResult, InformArgs, InjectArgs, RemoveArgs, UninformArgs};
use serde::Serialize;

use crate::arguments::{InformArguments, InjectArguments, SelectArguments};
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::selection::radians;
use crate::verbs::print;

/// Gives individuals a direction.
///
/// # Errors
///
/// Why nobody was informed.
pub async fn inform(bus: &Bus, output: Output, arguments: &InformArguments) -> Result<(), Failure> {
    let direction = radians(arguments.direction, arguments.degrees);
    let args = InformArgs {
        select: arguments.selection.select(),
        direction: direction.expect("clap asks for one of the two"),
        weight: arguments.weight,
        for_time: arguments.for_time,
    };
    change(bus, output, &arguments.name, "inform", &args, "informed").await
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
    let args = UninformArgs {
        select: arguments.selection.select(),
    };
    let name = &arguments.name;
    change(bus, output, name, "uninform", &args, "uninformed").await
}

/// Adds individuals.
///
/// # Errors
///
/// Why nobody was added.
pub async fn inject(bus: &Bus, output: Output, arguments: &InjectArguments) -> Result<(), Failure> {
    let at = &arguments.at;
    let args = InjectArgs {
        count: arguments.count,
        at: (!at.is_empty()).then(|| at.clone()),
        within: arguments.within,
        direction: radians(arguments.direction, arguments.degrees),
        weight: arguments.weight,
    };
    change(bus, output, &arguments.name, "inject", &args, "injected").await
}

/// Takes individuals out of the group.
///
/// # Errors
///
/// Why nobody was removed.
pub async fn remove(bus: &Bus, output: Output, arguments: &SelectArguments) -> Result<(), Failure> {
    let args = RemoveArgs {
        select: arguments.selection.select(),
    };
    change(bus, output, &arguments.name, "remove", &args, "removed").await
}

/// Sends it and says who it was about.
async fn change<A: Serialize + Sync>(
    bus: &Bus,
    output: Output,
    swarm: &str,
    verb: &str,
    args: &A,
    done: &str,
) -> Result<(), Failure> {
    let answer = bus.command(swarm, verb, args).await?;
    print(output, &answer, |reply: &Reply<IdsResult>| {
        let IdsResult { ids, n } = &reply.result;
        let (swarm, step) = (&reply.swarm, reply.step);
        let whom = match ids.len() {
            0 => "nobody".into(),
            count => format!("{count} ({})", format::ids(ids)),
        };
        format!("{done} {whom} at step {step}; {swarm} has {n}")
    })
}
