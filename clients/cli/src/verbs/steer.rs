//! `pause`, `step`, `reset`, `set` and `delete`: the swarm as a whole.

use jostle_proto::Reply;
use jostle_proto::verbs::{
    DeleteArgs, EmptyResult, PauseArgs, ResetArgs, ResetResult, Return, SetResult, StepArgs,
    StepResult,
};
use serde_json::{Map, Value};

use crate::arguments::{DeleteArguments, ResetArguments, SetArguments, StepArguments};
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table;
use crate::verbs::{place, print};

/// Pauses a swarm.
///
/// # Errors
///
/// Why it was not paused.
pub async fn pause(bus: &Bus, output: Output, swarm: &str) -> Result<(), Failure> {
    let answer = bus.command(swarm, "pause", &PauseArgs {}).await?;
    print(output, &answer, |reply: &Reply<EmptyResult>| {
        format!("{} is {}", reply.swarm, place(reply))
    })
}

/// Runs a paused swarm some steps on.
///
/// # Errors
///
/// Why it did not step, or that it is not done yet.
pub async fn step(bus: &Bus, output: Output, arguments: &StepArguments) -> Result<(), Failure> {
    let args = StepArgs {
        steps: arguments.steps,
        return_: if arguments.state {
            Return::State
        } else {
            Return::None
        },
    };
    let answer = bus.command(&arguments.name, "step", &args).await?;
    if !arguments.state {
        return print(output, &answer, |reply: &Reply<StepResult>| {
            let StepResult {
                steps, state_hash, ..
            } = &reply.result;
            let short = if *steps < arguments.steps {
                format!(", only {steps} of {} taken", arguments.steps)
            } else {
                String::new()
            };
            let (swarm, place) = (&reply.swarm, place(reply));
            format!("{swarm} is {place}{short}\nstate hash {state_hash}")
        });
    }
    // The answer came as CBOR; either way it is printed as JSON.
    let reply: Reply<StepResult> = answer.read()?;
    if output.json {
        return output.data(&json(&reply)?);
    }
    match &reply.result.state {
        Some(state) => output.data(&json(state)?),
        None => Err(Failure::Unreadable {
            problem: "it has no state".into(),
        }),
    }
}

/// Puts a swarm back to its start.
///
/// # Errors
///
/// Why it was not put back.
pub async fn reset(bus: &Bus, output: Output, arguments: &ResetArguments) -> Result<(), Failure> {
    let args = ResetArgs {
        seed: arguments.seed,
    };
    let answer = bus.command(&arguments.name, "reset", &args).await?;
    print(output, &answer, |reply: &Reply<ResetResult>| {
        format!(
            "{} is {}, seed {}\nstate hash {}",
            reply.swarm,
            place(reply),
            reply.result.seed,
            reply.result.state_hash
        )
    })
}

/// Changes the parameters named.
///
/// # Errors
///
/// Why nothing was changed.
pub async fn set(bus: &Bus, output: Output, arguments: &SetArguments) -> Result<(), Failure> {
    let mut args = Map::new();
    for assignment in &arguments.assignments {
        let field = &assignment.field;
        if args
            .insert(field.clone(), assignment.value.clone())
            .is_some()
        {
            return Err(Failure::Argument {
                argument: field.clone(),
                problem: "is given twice".into(),
            });
        }
    }
    if arguments.make_room {
        args.insert("make_room".into(), Value::Bool(true));
    }
    let answer = bus.command(&arguments.name, "set", &args).await?;
    print(output, &answer, |reply: &Reply<SetResult>| {
        let mut text = table::changes(&reply.result);
        let scaled_by = reply.result.scaled_by;
        if scaled_by > 1.0 {
            text.push_str(&format!(
                "\npositions spread by {scaled_by:.4} to make room"
            ));
        }
        text
    })
}

/// Deletes swarms, each whatever becomes of the others.
///
/// # Errors
///
/// Why the first that is still there was not deleted.
pub async fn delete(bus: &Bus, output: Output, arguments: &DeleteArguments) -> Result<(), Failure> {
    let mut first = None;
    for swarm in &arguments.names {
        match bus.command(swarm, "delete", &DeleteArgs {}).await {
            Ok(answer) => print(output, &answer, |reply: &Reply<EmptyResult>| {
                format!(
                    "deleted {} at step {}, time {}",
                    reply.swarm,
                    reply.step,
                    format::time(reply.time)
                )
            })?,
            Err(failure) => {
                if let Some(earlier) = first.replace(failure) {
                    output.failure(&earlier);
                }
            }
        }
    }
    first.map_or(Ok(()), Err)
}

fn json<T: serde::Serialize>(value: &T) -> Result<String, Failure> {
    serde_json::to_string(value).map_err(Failure::defect)
}
