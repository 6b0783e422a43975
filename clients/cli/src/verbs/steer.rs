//! `pause`, `step`, `reset`, `set`, `leave`, `annotate` and `protect`: commands to a whole swarm.

use std::time::Duration;

use jostle_client::{Client, Payload};
use jostle_proto::verbs::{
    AnnotateArgs, EmptyResult, LeaveArgs, PauseArgs, ProtectArgs, ResetArgs, ResetResult, Return,
    SetResult, StepArgs, StepResult,
};
use jostle_proto::{Error, ErrorCode, Metrics, NodeReply, Parameter, Reply, State, contract};
use serde_json::{Map, Value};

use crate::arguments::{
    AnnotateArguments, CommandArguments, LeaveArguments, ProtectArguments, ResetArguments,
    SetArguments, StepArguments, SwarmsArguments,
};
use crate::context::Context;
use crate::failure::Failure;
use crate::format::{self, position, standing};
use crate::interrupt;
use crate::output::scheduled;
use crate::suggest::did_you_mean;
use crate::table;
use crate::verbs::which;

pub async fn pause(context: &Context, arguments: &SwarmsArguments) -> Result<(), Failure> {
    let swarms = which::chosen(context, "pause", arguments).await?;
    let (sending, args) = (&arguments.sending, PauseArgs {});
    let pause = async |swarm: &str| context.send(swarm, sending, &args, standing).await;
    which::each(context.output, "pause", &swarms, pause).await
}

pub async fn step(context: &Context, arguments: &StepArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let CommandArguments { name, sending } = &arguments.command;
    let args = StepArgs {
        steps: arguments.steps,
        return_: if arguments.state {
            Return::State
        } else {
            Return::None
        },
    };
    let left = format!("{name} steps on; `jostle pause {name}` pauses it");
    let stepped = client.command(name, "step", &args, sending);
    let answer = interrupt::after_grace(Duration::ZERO, &left, stepped).await?;
    if !arguments.state || scheduled(&answer).is_some() {
        note_not_durable(context, &answer).await;
        return output.outcome(&answer, "step", |reply: &Reply<StepResult>| {
            let StepResult {
                steps, state_hash, ..
            } = &reply.result;
            let short = if *steps < arguments.steps {
                format!(", only {steps} of {} taken", arguments.steps)
            } else {
                String::new()
            };
            format!("{}{short}{}", standing(reply), hash_line(state_hash))
        });
    }
    // The reply is CBOR and is printed as JSON.
    let mut reply: Reply<StepResult> = answer.read()?;
    if reply.result.state.is_none() {
        reply.result.state = Some(fetch_state(client, &reply).await?);
    }
    match output.json {
        true => output.document(&reply),
        false => output.document(&reply.result.state),
    }
}

/// Notes which steps a daemon with a full disk has not stored.
async fn note_not_durable(context: &Context, answer: &Payload) {
    let Ok(reply) = answer.read::<Reply<StepResult>>() else {
        return;
    };
    // They differ for a few milliseconds on every daemon.
    if reply.step > reply.result.durable_step
        && let Ok(metrics) = context.client.get_node("metrics").await
        && let Ok(metrics) = metrics.read::<NodeReply<Metrics>>()
        && let Some(note) = not_durable(reply.result.durable_step, &metrics.result.unwell)
    {
        context.output.note(&note);
    }
}

fn not_durable(durable_step: u64, unwell: &[String]) -> Option<String> {
    let mut unwell = unwell.iter();
    let full = unwell.find(|reason| reason.starts_with("the disk is full"))?;
    Some(format!(
        "not yet on the daemon's disk: steps after {durable_step}; {full}"
    ))
}

/// Queries the state, which a cached reply omits; fails if the swarm has changed.
async fn fetch_state(client: &Client, reply: &Reply<StepResult>) -> Result<State, Failure> {
    let before = client.status(&reply.swarm).await?;
    let state: State = client.state(&reply.swarm).await?.read()?;
    let status = client.status(&reply.swarm).await?;
    // Without a command between the two statuses, the state between them has the same step.
    let is_same = before.seq == status.seq
        && [state.step, status.step] == [reply.step; 2]
        && status.result.state_hash == reply.result.state_hash;
    match is_same {
        true => Ok(state),
        false => Err(Failure::rejected(Error {
            code: ErrorCode::Conflict,
            message: format!(
                "the command was executed and led to step {}, but its reply with the state was \
                 lost, and the swarm is at step {} now or was changed",
                reply.step, status.step
            ),
            details: Map::new(),
            step: Some(status.step),
        })),
    }
}

pub async fn reset(context: &Context, arguments: &ResetArguments) -> Result<(), Failure> {
    let args = ResetArgs {
        seed: arguments.seed,
    };
    let describe = |reply: &Reply<ResetResult>| {
        let ResetResult { seed, state_hash } = &reply.result;
        format!("{}, seed {seed}{}", standing(reply), hash_line(state_hash))
    };
    context.execute(&arguments.command, &args, describe).await
}

/// A line with the hash; empty for the zeros of a playback, which has no state.
fn hash_line(hash: &str) -> String {
    match hash.bytes().all(|digit| digit == b'0') {
        true => String::new(),
        false => format!("\nstate hash {hash}"),
    }
}

pub async fn set(context: &Context, arguments: &SetArguments) -> Result<(), Failure> {
    let mut args = Map::new();
    for assignment in &arguments.assignments {
        let (field, value) = (&assignment.field, assignment.value.clone());
        if args.insert(field.clone(), value).is_some() {
            return Err(Failure::argument(field, "is given twice"));
        }
    }
    if arguments.make_room {
        args.insert("make_room".into(), Value::Bool(true));
    }
    let CommandArguments { name, sending } = &arguments.command;
    let answer = context.client.command(name, "set", &args, sending).await;
    let answer =
        answer.map_err(|error| Failure::from(error).with_advice(advice_on_set(args.keys())))?;
    let describe = |reply: &Reply<SetResult>| {
        let mut text = table::changes(&reply.result);
        let scaled_by = reply.result.scaled_by;
        if scaled_by > 1.0 {
            text.push_str(&format!(
                "\npositions spread by {scaled_by:.4} to make room"
            ));
        }
        if let Some(hz) = reply.result.published_hz
            && args.contains_key("publish_every")
        {
            let hz = format::number(hz);
            text.push_str(&format!("\npublishes at most {hz} states a second"));
        }
        text
    };
    context.output.outcome(&answer, "set", describe)
}

pub async fn leave(context: &Context, arguments: &LeaveArguments) -> Result<(), Failure> {
    let args = LeaveArgs {
        controller: arguments.controller.clone(),
    };
    let describe = |reply: &Reply<_>| {
        let (controller, swarm) = (&args.controller, &reply.swarm);
        format!(
            "{controller} has left {swarm}, which is {}",
            position(reply)
        )
    };
    context.execute(&arguments.command, &args, describe).await
}

pub async fn annotate(context: &Context, arguments: &AnnotateArguments) -> Result<(), Failure> {
    let args = AnnotateArgs {
        text: arguments.text.clone(),
    };
    let describe = |reply: &Reply<_>| format!("{} has the note (seq {})", reply.swarm, reply.seq);
    context.execute(&arguments.command, &args, describe).await
}

pub async fn protect(context: &Context, arguments: &ProtectArguments) -> Result<(), Failure> {
    let ProtectArguments { swarms, off } = arguments;
    let verb = if *off { "unprotect" } else { "protect" };
    let chosen = which::chosen(context, verb, swarms).await?;
    let (sending, args) = (&swarms.sending, ProtectArgs { on: !off });
    let describe = |reply: &Reply<EmptyResult>| {
        let no_longer = if *off { "no longer " } else { "" };
        format!(
            "{} is {no_longer}protected from delete and reset (seq {})",
            reply.swarm, reply.seq
        )
    };
    let protect = async |swarm: &str| context.send(swarm, sending, &args, describe).await;
    which::each(context.output, verb, &chosen, protect).await
}

/// A suggestion for a field that no swarm has; for the others the daemon's error has a remedy.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_that_are_not_durable_are_noted_only_if_the_disk_is_full() {
        let note = |reason: &str| not_durable(7, &[reason.to_owned()]);
        assert_eq!(not_durable(7, &[]), None);
        assert_eq!(note("thread x has been executing one task for 9 s"), None);
        let full = note("the disk is full: free some space").unwrap_or_default();
        assert!(full.starts_with("not yet on the daemon's disk: steps after 7; the disk"));
    }

    #[test]
    fn a_typing_error_in_a_parameter_is_recognised() {
        let advice = |field: &str| advice_on_set([field.to_owned()].iter()).unwrap_or_default();
        assert_eq!(advice("pi3"), "");
        assert_eq!(advice("make_room"), "");
        assert!(advice("publish_evry").contains("`publish_every`"));
        assert_eq!(advice("dt"), "", "it is known and cannot be set");
        assert_eq!(advice("colour"), "");
    }
}
