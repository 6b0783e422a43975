//! `attach`: shows the progress of an experiment until it ends.

use std::time::Duration;

use indicatif::ProgressBar;
use jostle_client::Payload;
use jostle_proto::{ExperimentPhase, Progress};

use super::{describe, phase};
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::interrupt;
use crate::output::{self, Output};
use crate::progress::{self, THOUSANDTHS};
use crate::verbs::outage::Outage;

/// After this time without a sample the progress is queried, since a sample may be lost.
const QUERY_INTERVAL: Duration = Duration::from_secs(5);

/// Shows the progress of an experiment until it ends.
pub async fn attach(context: &Context, name: &str) -> Result<(), Failure> {
    let output = context.output;
    let template = "{prefix} {bar:30} {percent:>3}%  {wide_msg}";
    let bar = progress::bar(output, Some(THOUSANDTHS), template, name);
    let outcome = tokio::select! {
        biased;
        outcome = follow(context, name, &bar) => outcome,
        () = interrupt::interrupted() => Err(Failure::interrupted_leaving(format!(
                "{name} continues; `jostle experiment attach {name}` shows it again, `jostle \
                 experiment cancel {name}` ends it"
            ))),
    };
    bar.finish_and_clear();
    let progress = outcome?;
    let unfinished = |how| {
        let (finished, runs) = (progress.finished, progress.runs);
        Failure::unfinished(name, how, (finished, runs), progress.message.as_deref())
    };
    match progress.phase {
        ExperimentPhase::Cancelled => Err(unfinished(("was cancelled", "incorrect_state"))),
        ExperimentPhase::Failed => Err(match progress.model_version {
            Some(version) => Failure::of_other_model(name, version, progress.message.as_deref()),
            None => unfinished(("failed", "internal")),
        }),
        _ if output.json => Ok(()),
        _ => output.data(&format!(
            "{}; took {}\n`jostle experiment results {}` shows the results",
            describe(&progress),
            format::duration(progress.elapsed_secs),
            progress.name
        )),
    }
}

/// Shows the published progress, and queries it if no sample arrives; returns the last progress.
async fn follow(context: &Context, name: &str, bar: &ProgressBar) -> Result<Progress, Failure> {
    let Context { client, output } = context;
    // Subscribes before the query, so that no sample is missed in between.
    let key = client.experiment_key(name, "progress").await?;
    let samples = client.subscribe(&key, 1).await?;
    let mut shown: Option<Progress> = None;
    let mut outage = Outage::default();
    loop {
        let note = |text: &str| bar.suspend(|| output.note(text));
        match client.get_experiment(name, "progress").await {
            Ok(payload) => {
                outage.end(note);
                show(*output, bar, &payload, &mut shown)?;
            }
            Err(error) if error.is_transient() && shown.is_some() => {
                outage.wait_to_retry(error, note).await?;
                continue;
            }
            Err(error) => return Err(error.into()),
        }
        loop {
            if let Some(progress) = shown.take_if(|it| it.phase.is_over()) {
                return Ok(progress);
            }
            match tokio::time::timeout(QUERY_INTERVAL, samples.next()).await {
                Ok(Ok(payload)) => show(*output, bar, &payload, &mut shown)?,
                _ => break,
            }
        }
    }
}

/// Shows the progress unless it is the same as before.
fn show(
    output: Output,
    bar: &ProgressBar,
    answer: &Payload,
    shown: &mut Option<Progress>,
) -> Result<(), Failure> {
    let progress: Progress = answer.read()?;
    if shown.as_ref() == Some(&progress) {
        return Ok(());
    }
    let before = shown.as_ref().map(|shown| shown.phase);
    if output.json {
        output::write(&format!("{}\n", answer.json()?))?;
    } else if bar.is_hidden() && before != Some(progress.phase) && !progress.phase.is_over() {
        output.note(&describe(&progress));
    }
    bar.set_position(progress::thousandths(progress.share));
    let mut message = match progress.phase {
        ExperimentPhase::Running => String::new(),
        other => format!("{}, ", phase(other)),
    };
    let runs = format::count(progress.runs, "run");
    message.push_str(&format!("{} of {runs}", progress.finished));
    if progress.faulted > 0 {
        message.push_str(&format!(", {} faulted", progress.faulted));
    }
    if let Some(secs) = progress.left_secs {
        message.push_str(&format!(", {} left", format::duration(secs)));
    }
    if let Some(reason) = &progress.message {
        message.push_str(&format!("; {reason}"));
    }
    bar.set_message(message);
    *shown = Some(progress);
    Ok(())
}
