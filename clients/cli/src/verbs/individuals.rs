//! `inform`, `uninform`, `inject` and `remove`: changes of individuals.

use std::f64::consts::TAU;

use jostle_proto::Reply;
use jostle_proto::verbs::{IdsResult, InformArgs, InjectArgs, RemoveArgs, UninformArgs};

use crate::arguments::{InformArguments, InjectArguments, SelectArguments};
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::selection::radians;

pub async fn inform(context: &Context, arguments: &InformArguments) -> Result<(), Failure> {
    let InformArguments { name, sending, .. } = arguments;
    let direction = radians(arguments.direction, arguments.degrees);
    let args = InformArgs {
        select: arguments.selection.select(),
        direction: direction.expect("clap requires one of the two"),
        weight: arguments.weight,
        for_time: arguments.for_time,
    };
    note_degrees(context, arguments.direction);
    let describe = |reply: &Reply<_>| describe("informed", Some(args.direction), reply);
    context.send(name, sending, &args, describe).await
}

pub async fn uninform(context: &Context, arguments: &SelectArguments) -> Result<(), Failure> {
    let SelectArguments { name, sending, .. } = arguments;
    let args = UninformArgs {
        select: arguments.selection.select(),
    };
    let describe = |reply: &Reply<_>| describe("uninformed", None, reply);
    context.send(name, sending, &args, describe).await
}

pub async fn inject(context: &Context, arguments: &InjectArguments) -> Result<(), Failure> {
    let at = &arguments.at;
    let args = InjectArgs {
        count: arguments.count,
        at: (!at.is_empty()).then(|| at.clone()),
        within: arguments.within,
        direction: radians(arguments.direction, arguments.degrees),
        weight: arguments.weight,
    };
    note_degrees(context, arguments.direction);
    let describe = |reply: &Reply<_>| describe("injected", args.direction, reply);
    context.execute(&arguments.command, &args, describe).await
}

pub async fn remove(context: &Context, arguments: &SelectArguments) -> Result<(), Failure> {
    let SelectArguments { name, sending, .. } = arguments;
    let args = RemoveArgs {
        select: arguments.selection.select(),
    };
    let describe = |reply: &Reply<_>| describe("removed", None, reply);
    context.send(name, sending, &args, describe).await
}

/// Notes that a direction beyond a full turn may be meant in degrees.
fn note_degrees(context: &Context, radians: Option<f64>) {
    if let Some(radians) = radians.filter(|it| it.abs() > TAU) {
        let degrees = format::time(radians);
        context.output.note(&format!(
            "--direction is in radians, and {degrees} rad is {}: did you mean --degrees {degrees}?",
            turned(radians)
        ));
    }
}

/// An angle in degrees, from 0 to 360.
fn turned(radians: f64) -> String {
    let degrees = (radians.to_degrees().rem_euclid(360.0) * 10.0).round() / 10.0;
    format!("{}°", degrees % 360.0)
}

/// The ids of the changed individuals, and their direction.
fn describe(done: &str, direction: Option<f64>, reply: &Reply<IdsResult>) -> String {
    let (swarm, step, n) = (&reply.swarm, reply.step, reply.result.n);
    let individuals = individuals(&reply.result.ids);
    let towards = direction.map_or_else(String::new, |it| {
        format!(" towards {} rad ({})", format::fixed(it, 2), turned(it))
    });
    format!("{done} {individuals}{towards} at step {step}; {swarm} has {n}")
}

/// The number of individuals, and their ids.
pub fn individuals(ids: &[u32]) -> String {
    match ids.len() {
        0 => "no individual".into(),
        count => format!("{count} ({})", format::ids(ids)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_angle_is_within_a_turn() {
        assert_eq!(turned(TAU / 4.0), "90°");
        assert_eq!(turned(-TAU / 4.0), "270°");
        assert_eq!(turned(90.0), "116.6°");
        assert_eq!(turned(TAU - 1e-6), "0°");
    }
}
