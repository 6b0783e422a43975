//! `pause`, `step`, `reset`, `set`, `leave` and `annotate`: the swarm as a whole.

use jostle_proto::verbs::{
    AnnotateArgs, EmptyResult, LeaveArgs, PauseArgs, ResetArgs, ResetResult, Return, SetResult,
    StepArgs, StepResult,
};
use jostle_proto::{Error, ErrorCode, Parameter, Reply, State, Status, contract};
use serde_json::{Map, Value};

use crate::arguments::{
    AnnotateArguments, LeaveArguments, PauseArguments, ResetArguments, SetArguments, StepArguments,
};
use crate::bus::Bus;
use crate::failure::Failure;
use crate::nearest::did_you_mean;
use crate::output::Output;
use crate::table;
use crate::verbs::{place, print_outcome, scheduled};

/// Pauses a swarm.
///
/// # Errors
///
/// Why it was not paused.
pub async fn pause(bus: &Bus, output: Output, arguments: &PauseArguments) -> Result<(), Failure> {
    let PauseArguments { name, sending } = arguments;
    let answer = bus.command(name, "pause", &PauseArgs {}, sending).await?;
    print_outcome(output, &answer, "pause", |reply: &Reply<EmptyResult>| {
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
    let StepArguments { name, sending, .. } = arguments;
    let answer = bus.command(name, "step", &args, sending).await?;
    if !arguments.state || scheduled(&answer).is_some() {
        return print_outcome(output, &answer, "step", |reply: &Reply<StepResult>| {
            let StepResult {
                steps, state_hash, ..
            } = &reply.result;
            let short = if *steps < arguments.steps {
                format!(", only {steps} of {} taken", arguments.steps)
            } else {
                String::new()
            };
            let (swarm, place) = (&reply.swarm, place(reply));
            format!("{swarm} is {place}{short}{}", hash_line(state_hash))
        });
    }
    // The answer came as CBOR; either way it is printed as JSON.
    let mut reply: Reply<StepResult> = answer.read()?;
    if reply.result.state.is_none() {
        reply.result.state = Some(fetch_state(bus, &reply).await?);
    }
    match output.json {
        true => output.data(&json(&reply)?),
        false => output.data(&json(&reply.result.state)?),
    }
}

/// Queries the state that a remembered reply omits; fails if the swarm has changed.
async fn fetch_state(bus: &Bus, reply: &Reply<StepResult>) -> Result<State, Failure> {
    let status = async || {
        let status = bus.get(&reply.swarm, "status").await?;
        status.read::<Reply<Status>>()
    };
    let before = status().await?;
    let state: State = bus.state(&reply.swarm).await?.read()?;
    let status = status().await?;
    // Where no command came between the two statuses, the state between them is theirs.
    let is_same = before.seq == status.seq
        && [state.step, status.step] == [reply.step; 2]
        && status.result.state_hash == reply.result.state_hash;
    match is_same {
        true => Ok(state),
        false => Err(Failure::refused(Error {
            code: ErrorCode::Conflict,
            message: format!(
                "the command was carried out and led to step {}, but its reply with the state was \
                 lost, and the swarm is at step {} now or was changed",
                reply.step, status.step
            ),
            details: Map::new(),
            step: Some(status.step),
        })),
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
    let ResetArguments { name, sending, .. } = arguments;
    let answer = bus.command(name, "reset", &args, sending).await?;
    print_outcome(output, &answer, "reset", |reply: &Reply<ResetResult>| {
        format!(
            "{} is {}, seed {}{}",
            reply.swarm,
            place(reply),
            reply.result.seed,
            hash_line(&reply.result.state_hash)
        )
    })
}

/// A line for a hash; none for the zeros of a replay, which has no state.
fn hash_line(hash: &str) -> String {
    match hash.bytes().all(|digit| digit == b'0') {
        true => String::new(),
        false => format!("\nstate hash {hash}"),
    }
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
    let SetArguments { name, sending, .. } = arguments;
    let answer = bus.command(name, "set", &args, sending).await;
    let answer = answer.map_err(|failure| failure.with_advice(advice_on_set(args.keys())))?;
    print_outcome(output, &answer, "set", |reply: &Reply<SetResult>| {
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

/// Has a controller leave.
///
/// # Errors
///
/// Why it is still there.
pub async fn leave(bus: &Bus, output: Output, arguments: &LeaveArguments) -> Result<(), Failure> {
    let args = LeaveArgs {
        controller: arguments.controller.clone(),
    };
    let LeaveArguments { name, sending, .. } = arguments;
    let answer = bus.command(name, "leave", &args, sending).await?;
    print_outcome(output, &answer, "leave", |reply: &Reply<EmptyResult>| {
        let (controller, swarm) = (&arguments.controller, &reply.swarm);
        format!("{controller} has left {swarm}, which is {}", place(reply))
    })
}

/// Writes a note into the journal and the events.
///
/// # Errors
///
/// Why it was not written.
pub async fn annotate(
    bus: &Bus,
    output: Output,
    arguments: &AnnotateArguments,
) -> Result<(), Failure> {
    let args = AnnotateArgs {
        text: arguments.text.clone(),
    };
    let AnnotateArguments { name, sending, .. } = arguments;
    let answer = bus.command(name, "annotate", &args, sending).await?;
    print_outcome(output, &answer, "annotate", |reply: &Reply<EmptyResult>| {
        format!("{} has the note (seq {})", reply.swarm, reply.seq)
    })
}

/// What people may have meant by a field that no swarm has; of all others the daemon says what
/// can be done.
pub fn advice_on_set<'a>(fields: impl Iterator<Item = &'a String>) -> Option<String> {
    let parameters = contract::parameters();
    let names = |is_wanted: fn(&Parameter) -> bool| {
        let wanted = parameters.iter().filter(move |it| is_wanted(it));
        wanted.map(|it| it.name.as_str()).chain(["make_room"])
    };
    let mut fields = fields.into_iter();
    let unknown = fields.find(|field| names(|_| true).all(|known| known != *field))?;
    did_you_mean(
        unknown,
        names(|parameter| parameter.changed_by.iter().any(|verb| verb == "set")),
    )
}

fn json<T: serde::Serialize>(value: &T) -> Result<String, Failure> {
    serde_json::to_string(value).map_err(Failure::defect)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_in_a_parameter_is_recognised() {
        let advice = |field: &str| advice_on_set([field.to_owned()].iter()).unwrap_or_default();
        assert_eq!(advice("pi3"), "");
        assert_eq!(advice("make_room"), "");
        assert!(advice("publish_evry").contains("`publish_every`"));
        assert_eq!(advice("dt"), "", "it is known and cannot be set");
        assert_eq!(advice("colour"), "");
    }
}
