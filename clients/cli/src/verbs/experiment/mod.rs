//! `experiment`: grids of runs on the daemon, which goes on whether anybody looks on or not.

mod attach;
mod part;
mod plan;
mod results;
mod slurm;

pub use self::plan::plan;

use jostle_proto::{
    ExperimentArgs, ExperimentName, ExperimentPhase, ExperimentResult, Experiments, NodeReply,
    Progress, SubmitArgs,
};

use crate::arguments::{ChangeExperimentArguments, Experiment, RunExperimentArguments};
use crate::bus::{Answer, Bus};
use crate::failure::{Failure, is_unknown_name};
use crate::file;
use crate::format;
use crate::interrupt;
use crate::output::Output;
use crate::table;
use crate::verbs::print;

/// Does what is asked for.
///
/// # Errors
///
/// Why it was not done.
pub async fn experiment(bus: &Bus, output: Output, what: &Experiment) -> Result<(), Failure> {
    let outcome = carry_out(bus, output, what).await;
    match (outcome, what.name()) {
        (Err(Failure::Refused { error, .. }), Some(name)) if is_unknown_name(&error) => {
            let there = bus.experiments().await.unwrap_or_default();
            Err(Failure::unknown("experiment", name, there, error))
        }
        (outcome, _) => outcome,
    }
}

async fn carry_out(bus: &Bus, output: Output, what: &Experiment) -> Result<(), Failure> {
    match what {
        Experiment::Run(arguments) => run(bus, output, arguments).await,
        Experiment::Attach(arguments) => attach::attach(bus, output, &arguments.name).await,
        Experiment::Plan(_) => unreachable!("it needs no daemon"),
        Experiment::List => interrupt::either(list(bus, output)).await,
        Experiment::Status(arguments) => {
            let answer = interrupt::either(bus.get_experiment(&arguments.name, "progress")).await?;
            print(output, &answer, status)
        }
        Experiment::Results(arguments) => {
            interrupt::either(results::results(bus, output, arguments)).await
        }
        Experiment::Pause(arguments) => change(bus, output, arguments, ExperimentArgs::Pause).await,
        Experiment::Resume(arguments) => {
            change(bus, output, arguments, ExperimentArgs::Resume).await
        }
        Experiment::Cancel(arguments) => {
            change(bus, output, arguments, ExperimentArgs::Cancel).await
        }
        Experiment::Delete(arguments) => {
            let answer = send(bus, arguments, ExperimentArgs::Delete).await?;
            print(output, &answer, |reply: &NodeReply<ExperimentResult>| {
                format!("deleted {}", reply.result.progress.name)
            })
        }
    }
}

/// Submits an experiment and shows how far it is.
async fn run(bus: &Bus, output: Output, arguments: &RunExperimentArguments) -> Result<(), Failure> {
    let toml = file::read(&arguments.file).map_err(|problem| Failure::Argument {
        argument: "FILE".into(),
        problem: format!(
            "{problem}; `jostle experiment run --help` shows what such a file has in it, `jostle \
             experiment list` shows the experiments of the daemon"
        ),
    })?;
    let args = ExperimentArgs::Submit(SubmitArgs {
        toml,
        name: arguments.name.clone(),
    });
    let sent = bus.command_node("experiment", &args, &arguments.sender);
    let answer = interrupt::either(sent).await?;
    if arguments.detach {
        return print(output, &answer, submitted);
    }
    let reply: NodeReply<ExperimentResult> = answer.read()?;
    if !output.json {
        output.note(&submitted(&reply));
    }
    attach::attach(bus, output, &reply.result.progress.name).await
}

async fn list(bus: &Bus, output: Output) -> Result<(), Failure> {
    let answer = bus.get_node("experiments").await?;
    let reply: NodeReply<Experiments> = answer.read()?;
    if !output.json && reply.result.experiments.is_empty() {
        let node = &reply.node;
        output.note(&format!(
            "no experiments on {node}: `jostle experiment run FILE` begins one"
        ));
        return Ok(());
    }
    print(output, &answer, |reply: &NodeReply<Experiments>| {
        let experiments = reply.result.experiments.iter();
        let header = [
            "experiment",
            "phase",
            "runs",
            "finished",
            "faulted",
            "done",
            "took",
            "left",
        ];
        table::table(header, experiments.map(row).collect())
    })
}

async fn change(
    bus: &Bus,
    output: Output,
    arguments: &ChangeExperimentArguments,
    what: fn(ExperimentName) -> ExperimentArgs,
) -> Result<(), Failure> {
    let answer = send(bus, arguments, what).await?;
    print(output, &answer, |reply: &NodeReply<ExperimentResult>| {
        line(&reply.result.progress)
    })
}

async fn send(
    bus: &Bus,
    arguments: &ChangeExperimentArguments,
    what: fn(ExperimentName) -> ExperimentArgs,
) -> Result<Answer, Failure> {
    let args = what(ExperimentName {
        name: arguments.name.clone(),
    });
    interrupt::either(bus.command_node("experiment", &args, &arguments.sender)).await
}

fn submitted(reply: &NodeReply<ExperimentResult>) -> String {
    let ExperimentResult { created, progress } = &reply.result;
    let name = &progress.name;
    if *created {
        let runs = format::count(progress.runs, "run");
        format!("submitted {name}, {runs}: `jostle experiment attach {name}` shows how far it is")
    } else {
        format!(
            "{name} is there already, made from the same file: {}",
            line(progress)
        )
    }
}

/// How an experiment stands, in a line.
fn line(progress: &Progress) -> String {
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
    if let Some(message) = &progress.message {
        text.push_str(&format!("; {message}"));
    }
    text
}

/// How an experiment stands, with the runs under way.
fn status(progress: &Progress) -> String {
    let mut text = line(progress);
    for run in &progress.running {
        text.push_str(&format!("\n  {} {}", format::bar(run.share, 20), run.run));
    }
    text
}

fn row(progress: &Progress) -> [String; 8] {
    [
        progress.name.clone(),
        phase(progress.phase).into(),
        progress.runs.to_string(),
        progress.finished.to_string(),
        progress.faulted.to_string(),
        format!("{:.0} %", 100.0 * progress.share),
        format::duration(progress.elapsed_secs),
        progress
            .left_secs
            .map_or_else(|| format::NONE.into(), format::duration),
    ]
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
