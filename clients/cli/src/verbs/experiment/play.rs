//! `experiment play`: the swarm of a run, with the commands of its protocol scheduled.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_client::{Client, CommandOptions};
use jostle_experiment::{LiveCommand, LiveRun, Plan, PlannedRun};
use jostle_proto::Reply;
use jostle_proto::verbs::{CreateArgs, CreateResult, DeleteArgs, RestoreArgs};
use serde_json::json;

use crate::arguments::PlayArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::suggest::did_you_mean;

/// Creates the swarm of a run, paused, and schedules its commands.
pub async fn play(context: &Context, arguments: &PlayArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let files = super::read(*output, &arguments.file)
        .map_err(|problem| Failure::argument("FILE", problem))?;
    let wrong = |error: String| Failure::argument(arguments.file.display(), error);
    let plan = Plan::of(files).map_err(|error| wrong(error.to_string()))?;
    let run = find(&plan, arguments.run.as_deref())?;
    let live = LiveRun::new(&plan, run).map_err(|error| wrong(error.to_string()))?;
    let swarm = arguments.swarm.as_deref().unwrap_or(&plan.name);
    let options = |k: usize| CommandOptions {
        // A retry with the same id executes nothing twice.
        request_id: arguments.sender.request_id.as_ref().map(|id| match k {
            0 => id.clone(),
            k => format!("{id}-{k}"),
        }),
        ..(&arguments.sender).into()
    };
    let name = swarm.to_owned();
    let created = match &live.snapshot {
        Some(bytes) => {
            let snapshot = STANDARD.encode(bytes);
            let restore = RestoreArgs { name, snapshot };
            client.command_node("restore", &restore, options(0)).await
        }
        None => {
            let create = CreateArgs {
                name,
                spec: live.spec.clone(),
                exist_ok: false,
            };
            client.command_node("create", &create, options(0)).await
        }
    };
    let answer = created.map_err(|error| match Failure::from(error) {
        failure if failure.code() == "already_exists" => Failure::new(
            "already_exists",
            format!("there is a swarm {swarm}: give the new one another name with --as"),
        ),
        failure => failure,
    })?;
    let reply: Reply<CreateResult> = answer.read()?;
    for (k, command) in (1..).zip(&live.commands) {
        let (step, sent) = match command {
            LiveCommand::Batch { step, args } => {
                let options = CommandOptions {
                    at_step: Some(*step),
                    ..options(k)
                };
                (
                    *step,
                    client
                        .command(swarm, "batch", args, options)
                        .await
                        .map(drop),
                )
            }
            LiveCommand::When(args) => {
                let sent = client.command(swarm, "when", args, options(k)).await;
                (args.from_step.unwrap_or(0), sent.map(drop))
            }
        };
        if let Err(error) = sent {
            return Err(undone(client, swarm, step, error.into()).await);
        }
    }
    if output.json {
        return output.document(&json!({
            "swarm": swarm,
            "run": run.name,
            "seed": run.seed,
            "steps": live.steps,
            "commands": live.commands.len(),
            "stop": live.stop,
            "state_hash": reply.result.state_hash,
        }));
    }
    let commands = format::count(live.commands.len() as u64, "command");
    output.data(&format!(
        "created {swarm}, the swarm of run {:?}, and scheduled {commands}: `jostle run {swarm} \
         --until-step {}` takes its steps",
        run.name, live.steps
    ))?;
    if let Some(condition) = &live.stop {
        output.note(&format!(
            "the run ends when {condition}: the swarm pauses then"
        ));
    }
    Ok(())
}

/// Finds a run by its number, from 1, or by its name; without either the first one.
pub fn find<'a>(plan: &'a Plan, run: Option<&str>) -> Result<&'a PlannedRun, Failure> {
    let runs = plan.runs();
    let Some(wanted) = run else {
        return Ok(&runs[0]);
    };
    plan.find(wanted).ok_or_else(|| {
        let names = runs.iter().map(|run| run.name.as_str());
        let meant = did_you_mean(wanted, names).map_or(String::new(), |it| format!("; {it}"));
        Failure::argument(
            "--run",
            format!(
                "there is no run {wanted:?}: give a number from 1 to {} or a name, as `jostled run \
                 FILE --dry-run` lists them{meant}",
                runs.len()
            ),
        )
    })
}

/// Deletes the swarm whose commands could not be scheduled. Returns the error for the user.
async fn undone(client: &Client, swarm: &str, step: u64, error: Failure) -> Failure {
    let deleted = client
        .command(swarm, "delete", &DeleteArgs {}, CommandOptions::default())
        .await;
    let swarm = match deleted {
        Ok(_) => format!("{swarm} was deleted again"),
        Err(_) => format!("{swarm} has a part of the commands: delete it"),
    };
    error.with_advice(Some(format!(
        "the command for step {step} was not scheduled; {swarm}"
    )))
}
