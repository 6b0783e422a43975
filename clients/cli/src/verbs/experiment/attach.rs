//! `attach`: how far an experiment is, until it is over.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use jostle_proto::{ExperimentPhase, Progress};

use super::{line, phase};
use crate::bus::{Answer, Bus};
use crate::failure::Failure;
use crate::format;
use crate::interrupt;
use crate::output::{self, Output};

/// How long silence is waited through before asking: a sample may be lost.
const SILENCE: Duration = Duration::from_secs(5);
/// How long a lost daemon is waited for.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long to rest before asking again after a failure.
const REST: Duration = Duration::from_millis(500);
/// The bar's length: a share in thousandths.
const WHOLE: u64 = 1000;

/// Shows how far an experiment is until it is over.
///
/// # Errors
///
/// Why it is not finished.
pub async fn attach(bus: &Bus, output: Output, name: &str) -> Result<(), Failure> {
    let bar = bar(output, name);
    let outcome = tokio::select! {
        biased;
        outcome = follow(bus, output, name, &bar) => outcome,
        () = interrupt::pressed() => Err(Failure::Interrupted {
            left: Some(format!(
                "{name} goes on; `jostle experiment attach {name}` shows it again, `jostle \
                 experiment cancel {name}` ends it"
            )),
        }),
    };
    bar.finish_and_clear();
    let progress = outcome?;
    let Progress {
        name,
        runs,
        finished,
        message,
        ..
    } = progress.clone();
    let unfinished = |how, code| Failure::Unfinished {
        name,
        how,
        code,
        finished,
        runs,
        message,
    };
    match progress.phase {
        ExperimentPhase::Cancelled => Err(unfinished("was cancelled", "incorrect_state")),
        ExperimentPhase::Failed => Err(unfinished("failed", "internal")),
        _ if output.json => Ok(()),
        _ => output.data(&format!(
            "{}; took {}\n`jostle experiment results {}` shows what came of it",
            line(&progress),
            format::duration(progress.elapsed_secs),
            progress.name
        )),
    }
}

/// Shows what is published, and asks where nothing is; the last there is to show.
async fn follow(
    bus: &Bus,
    output: Output,
    name: &str,
    bar: &ProgressBar,
) -> Result<Progress, Failure> {
    // Subscribed first and asked then, so that nothing falls in between.
    let samples = bus
        .subscribe(&bus.experiment_key(name, "progress").await?, 1)
        .await?;
    let mut told: Option<Progress> = None;
    let mut lost: Option<Instant> = None;
    loop {
        match bus.get_experiment(name, "progress").await {
            Ok(answer) => {
                lost = None;
                if show(output, bar, &answer, &mut told)? {
                    break;
                }
            }
            Err(failure) if failure.is_passing() && told.is_some() => {
                let since = *lost.get_or_insert_with(|| {
                    let secs = PATIENCE.as_secs();
                    let waiting =
                        format!("{failure}; asking again for up to {secs} s, Ctrl-C ends");
                    bar.suspend(|| output.note(&waiting));
                    Instant::now()
                });
                if since.elapsed() > PATIENCE {
                    return Err(failure);
                }
                tokio::time::sleep(REST).await;
                continue;
            }
            Err(failure) => return Err(failure),
        }
        while let Ok(Ok(sample)) = tokio::time::timeout(SILENCE, samples.recv_async()).await {
            if show(output, bar, &Answer::from(&sample), &mut told)? {
                return told.ok_or_else(|| Failure::defect("nothing was shown"));
            }
        }
    }
    told.ok_or_else(|| Failure::defect("nothing was shown"))
}

/// Shows how far it is; whether it is over.
fn show(
    output: Output,
    bar: &ProgressBar,
    answer: &Answer,
    told: &mut Option<Progress>,
) -> Result<bool, Failure> {
    let progress: Progress = answer.read()?;
    if told.as_ref() == Some(&progress) {
        return Ok(progress.phase.is_over());
    }
    let before = told.as_ref().map(|told| told.phase);
    if output.json {
        output::write(&format!("{}\n", answer.json()?))?;
    } else if bar.is_hidden() && before != Some(progress.phase) && !progress.phase.is_over() {
        output.note(&line(&progress));
    }
    bar.set_position(of_whole(progress.share));
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
    bar.set_message(message);
    let is_over = progress.phase.is_over();
    *told = Some(progress);
    Ok(is_over)
}

/// A share of the bar.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a share is from 0 to 1"
)]
fn of_whole(share: f64) -> u64 {
    (share * WHOLE as f64) as u64
}

/// A bar over the work; hidden unless stderr is a terminal.
fn bar(output: Output, name: &str) -> ProgressBar {
    if output.json {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::with_draw_target(Some(WHOLE), ProgressDrawTarget::stderr());
    let template = "{prefix} {bar:30} {percent:>3}%  {wide_msg}";
    bar.set_style(ProgressStyle::with_template(template).expect("a constant"));
    bar.set_prefix(name.to_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
