//! `experiment`: grids of runs on the daemon, which executes them without a client.

mod aggregate;
mod attach;
mod over_time;
mod plan;
mod play;
mod results;
pub mod rows;
pub mod series;
mod slurm;
mod trajectory;

pub use self::plan::plan;
pub use self::play::find as find_run;

use std::path::Path;

use jostle_client::Payload;
use jostle_experiment::{DryRun, EncodedFiles, Files, Plan, PlanError, Subset, start_remark};
use jostle_proto::{
    ExperimentArgs, ExperimentName, ExperimentPhase, ExperimentResult, Experiments, NodeReply,
    Progress, SubmitArgs,
};

use crate::arguments::{ChangeExperimentArguments, Experiment, RunExperimentArguments};
use crate::context::Context;
use crate::failure::Failure;
use crate::file;
use crate::format;
use crate::interrupt;
use crate::output::Output;
use crate::suggest::instead_of_unknown;
use crate::table::Column;

pub async fn experiment(context: &Context, what: &Experiment) -> Result<(), Failure> {
    let outcome = execute(context, what).await;
    match (outcome, what.name()) {
        (Err(failure), Some(name)) if failure.is_unknown_name() => {
            let there = context.client.experiments().await.unwrap_or_default();
            let list = "jostle experiment list";
            Err(failure.describe_unknown("experiment", name, &there, list))
        }
        (outcome, _) => outcome,
    }
}

async fn execute(context: &Context, what: &Experiment) -> Result<(), Failure> {
    let Context { client, output } = context;
    match what {
        Experiment::Run(arguments) => run(context, arguments).await,
        Experiment::Play(arguments) => interrupt::either(play::play(context, arguments)).await,
        Experiment::Attach(arguments) => attach::attach(context, &arguments.name).await,
        Experiment::Plan(_) => unreachable!("it needs no daemon"),
        Experiment::List => interrupt::either(list(context)).await,
        Experiment::Status(arguments) => {
            let progress = client.get_experiment(&arguments.name, "progress");
            output.reply(&interrupt::either(progress).await?, status)
        }
        Experiment::Results(arguments) => {
            interrupt::either(results::results(context, arguments)).await
        }
        Experiment::Pause(arguments) => change(context, arguments, ExperimentArgs::Pause).await,
        Experiment::Resume(arguments) => change(context, arguments, ExperimentArgs::Resume).await,
        Experiment::Cancel(arguments) => change(context, arguments, ExperimentArgs::Cancel).await,
        Experiment::Delete(arguments) => {
            let answer = send(context, arguments, ExperimentArgs::Delete).await?;
            output.reply(&answer, |reply: &NodeReply<ExperimentResult>| {
                format!("deleted {}", reply.result.progress.name)
            })
        }
    }
}

/// Submits an experiment and shows its progress.
async fn run(context: &Context, arguments: &RunExperimentArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let files = read(*output, &arguments.file).map_err(|problem| {
        Failure::argument(
            "FILE",
            format!(
                "{problem}; `jostle experiment run --help` shows the format of the file, `jostle \
             experiment list` shows the experiments of the daemon"
            ),
        )
    })?;
    let EncodedFiles {
        toml,
        points,
        start,
        setpoints,
    } = files.into();
    let args = ExperimentArgs::Submit(SubmitArgs {
        toml,
        points,
        start,
        setpoints,
        name: arguments.name.clone(),
        again: arguments.again,
    });
    let sent = client.command_node("experiment", &args, &arguments.sender);
    let answer = interrupt::either(sent).await?;
    if arguments.detach {
        return output.reply(&answer, submitted);
    }
    let reply: NodeReply<ExperimentResult> = answer.read()?;
    if !output.json {
        output.note(&submitted(&reply));
    }
    attach::attach(context, &reply.result.progress.name).await
}

/// Reads an experiment's file, or standard input for `-`, and the files that it names; warns of those
/// outside its folder.
pub fn read(output: Output, path: &Path) -> Result<Files, String> {
    let toml = file::read(path)?;
    let files = Files::with_named(toml, path).map_err(|error| error.to_string())?;
    for warning in files.warnings(path) {
        output.note(&format!("warning: {warning}"));
    }
    Ok(files)
}

/// Shows what an experiment would do. Needs no daemon.
pub fn dry_run(output: Output, arguments: &RunExperimentArguments) -> Result<(), Failure> {
    let files =
        read(output, &arguments.file).map_err(|problem| Failure::argument("FILE", problem))?;
    let of_file = |error: PlanError| {
        let mut problem = error.to_string();
        if let Some(question) = instead_of_unknown(&problem) {
            problem.push_str(&format!("; {question}"));
        }
        Failure::argument(arguments.file.display(), problem)
    };
    let plan = Plan::of(files).map_err(of_file)?;
    let dry_run = DryRun::of(&plan, &Subset::all(&plan)).map_err(of_file)?;
    output.print(&dry_run, &dry_run.to_string())
}

async fn list(context: &Context) -> Result<(), Failure> {
    let Context { client, output } = context;
    let answer = client.get_node("experiments").await?;
    let reply: NodeReply<Experiments> = answer.read()?;
    let if_empty = format!(
        "no experiments on {}: `jostle experiment run FILE` starts one",
        reply.node
    );
    let columns: [Column<Progress>; 8] = [
        ("experiment", |it| it.name.clone()),
        ("phase", |it| phase(it.phase).into()),
        ("runs", |it| it.runs.to_string()),
        ("finished", |it| it.finished.to_string()),
        ("faulted", |it| it.faulted.to_string()),
        ("done", |it| format::percent(it.share)),
        ("took", |it| format::duration(it.elapsed_secs)),
        ("left", |it| {
            format::or_none(it.left_secs.map(format::duration))
        }),
    ];
    let experiments = &reply.result.experiments;
    output.list(&answer, experiments, columns, &if_empty)?;
    // A finished one may lack files of some runs.
    let waits = |it: &&Progress| match it.phase {
        ExperimentPhase::Failed => it.model_version.is_some(),
        ExperimentPhase::Paused => true,
        ExperimentPhase::Finished => it.finished < it.runs,
        _ => false,
    };
    for experiment in experiments.iter().filter(waits) {
        if let Some(reason) = experiment.message.as_ref().filter(|_| !output.json) {
            let (name, phase) = (&experiment.name, phase(experiment.phase));
            output.note(&format!("{name} is {phase}: {reason}"));
        }
    }
    Ok(())
}

async fn change(
    context: &Context,
    arguments: &ChangeExperimentArguments,
    what: fn(ExperimentName) -> ExperimentArgs,
) -> Result<(), Failure> {
    let answer = send(context, arguments, what).await?;
    let describe = |reply: &NodeReply<ExperimentResult>| describe(&reply.result.progress);
    context.output.reply(&answer, describe)
}

async fn send(
    context: &Context,
    arguments: &ChangeExperimentArguments,
    what: fn(ExperimentName) -> ExperimentArgs,
) -> Result<Payload, Failure> {
    let ChangeExperimentArguments { name, sender } = arguments;
    let args = what(ExperimentName { name: name.clone() });
    let answer = context.client.command_node("experiment", &args, sender);
    interrupt::either(answer).await
}

fn submitted(reply: &NodeReply<ExperimentResult>) -> String {
    let ExperimentResult {
        created, progress, ..
    } = &reply.result;
    let name = &progress.name;
    if *created {
        let runs = format::count(progress.runs, "run");
        let warning = progress.message.iter();
        let warning: String = warning.map(|it| format!("\n{it}")).collect();
        format!(
            "submitted {name}, {runs}: `jostle experiment attach {name}` shows its progress{warning}"
        )
    } else {
        format!(
            "{name} already exists with the same file: {}",
            describe(progress)
        )
    }
}

fn describe(progress: &Progress) -> String {
    let Progress {
        name,
        runs,
        finished,
        ..
    } = progress;
    let mut text = format!(
        "{name} is {}, {finished} of {} finished",
        phase(progress.phase),
        format::count(*runs, "run")
    );
    if let Some(secs) = progress.left_secs {
        text.push_str(&format!(", {} left", format::duration(secs)));
    }
    if let Some(version) = progress.start_model_version {
        text.push_str(&format!("; {}", start_remark(version)));
    }
    match (&progress.message, progress.model_version) {
        (Some(message), _) => text.push_str(&format!("; {message}")),
        (None, Some(version)) => text.push_str(&format!(
            "; version {version} of the model executed its runs, and the daemon has another one"
        )),
        (None, None) => {}
    }
    text
}

/// The progress of an experiment and of its active runs.
fn status(progress: &Progress) -> String {
    let mut text = describe(progress);
    for run in &progress.running {
        text.push_str(&format!("\n  {} {}", format::bar(run.share, 20), run.run));
    }
    text
}

fn phase(phase: ExperimentPhase) -> &'static str {
    match phase {
        ExperimentPhase::Queued => "queued",
        ExperimentPhase::Running => "running",
        ExperimentPhase::Paused => "paused",
        ExperimentPhase::Finished => "finished",
        ExperimentPhase::Cancelled => "cancelled",
        ExperimentPhase::Failed => "failed",
    }
}
