//! `run`: lets a swarm run and, if asked to, waits for hours until it is there.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use jostle_proto::verbs::{RunArgs, RunResult};
use jostle_proto::{ErrorCode, OrderSample, Phase, Reply, Status, keys};

use crate::arguments::RunArguments;
use crate::bus::{Answer, Bus};
use crate::failure::Failure;
use crate::format;
use crate::interrupt;
use crate::output::Output;
use crate::values::Rate;
use crate::verbs::lookout::RISE;
use crate::verbs::{place, print, print_outcome};

/// How long the daemon holds a question before it is asked again.
const HELD: Duration = Duration::from_secs(30);
/// How long a lost daemon is waited for.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long to rest before asking again after a failure.
const REST: Duration = Duration::from_millis(500);

/// Lets a swarm run.
///
/// # Errors
///
/// Why it does not run, or why it did not come to the end waited for.
pub async fn run(bus: &Bus, output: Output, arguments: &RunArguments) -> Result<(), Failure> {
    let args = RunArgs {
        until_step: arguments.until_step,
        until_time: arguments.until,
        rate: arguments.rate.map(|Rate(rate)| rate),
    };
    let swarm = &arguments.name;
    // A daemon may be gone and back between its answer and the first look.
    let lost_before = bus.lost();
    let answer = interrupt::either(bus.command(swarm, "run", &args, &arguments.sending)).await?;
    if !arguments.wait {
        return print_outcome(output, &answer, "run", tell);
    }
    let reply: Reply<RunResult> = answer.read()?;
    let began = Instant::now();
    let target = reply.result.until_step;
    let bar = bar(output, &reply);
    let outcome = tokio::select! {
        biased;
        outcome = reached(bus, output, &reply, lost_before, &bar) => outcome,
        () = advance(bus, swarm, &reply, &bar) => Err(Failure::Interrupted { left: None }),
        () = interrupt::pressed() => Err(Failure::Interrupted {
            left: Some(runs_on(swarm, target)),
        }),
    };
    bar.finish_and_clear();
    let (answer, reached) = outcome?;
    // Where it stands is data even if it is not where it should be.
    print(output, &answer, |reply: &Reply<Status>| {
        let secs = began.elapsed().as_secs_f64();
        format!("{} is {}; waited {secs:.1} s", reply.swarm, place(reply))
    })?;
    reached
}

/// The answer to a `run` that nobody waits for.
fn tell(reply: &Reply<RunResult>) -> String {
    let RunResult { until_step, rate } = reply.result;
    let mut text = format!("{} is {}", reply.swarm, place(reply));
    if let Some(step) = until_step {
        text.push_str(&format!(", until step {step}"));
    }
    text.push_str(&format!(", rate {}", format::rate(rate)));
    text
}

fn runs_on(swarm: &str, target: Option<u64>) -> String {
    let until = target.map_or_else(String::new, |step| format!(" until step {step}"));
    format!("{swarm} runs on{until}; `jostle pause {swarm}` pauses it")
}

/// Asks again and again until the swarm is there or can no longer get there by itself; the last
/// answer, and whether it is the one waited for.
async fn reached(
    bus: &Bus,
    output: Output,
    started: &Reply<RunResult>,
    mut lost_before: u64,
    bar: &ProgressBar,
) -> Result<(Answer, Result<(), Failure>), Failure> {
    let swarm = &started.swarm;
    let target = started.result.until_step;
    let what = target.map_or_else(|| "phase=paused".into(), |step| format!("step={step}"));
    let mut epoch = started.epoch;
    let (mut lost, mut missing): (Option<Instant>, Option<Instant>) = (None, None);
    loop {
        let asked = Instant::now();
        match bus.wait(swarm, &what, HELD).await {
            Ok(answer) => {
                let reply: Reply<Status> = answer.read()?;
                if lost.is_some() || bus.lost() != lost_before {
                    epoch = epoch_after_a_loss(epoch, &reply);
                }
                if let Some(verdict) = verdict(started, epoch, &reply) {
                    return Ok((answer, verdict));
                }
                (lost, missing, lost_before) = (None, None, bus.lost());
            }
            Err(Failure::Refused { error, .. }) if error.code == ErrorCode::DeadlineExceeded => {
                (lost, missing) = (None, None);
                // Early if too many wait for the swarm: then others wait, too, and ask again.
                if asked.elapsed() >= HELD {
                    continue;
                }
            }
            Err(failure) if failure.is_passing() => {
                let since = *lost.get_or_insert_with(|| {
                    bar.suspend(|| output.note(&waiting(&failure)));
                    Instant::now()
                });
                if since.elapsed() > PATIENCE {
                    return Err(failure);
                }
            }
            Err(failure) if failure.code() == "not_found" => {
                // One look is too few: a swarm is known a moment later than the daemon that
                // hosts it.
                let was_lost = lost.is_some() || bus.lost() != lost_before;
                let since = *missing.get_or_insert_with(Instant::now);
                if since.elapsed() >= if was_lost { RISE } else { REST } {
                    let swarm = swarm.clone();
                    return Err(match lost {
                        Some(_) => Failure::LeftBehind { swarm },
                        None => Failure::Deleted { swarm },
                    });
                }
            }
            Err(failure) => return Err(failure),
        }
        tokio::time::sleep(REST).await;
    }
}

/// What people are told once when the answers stop coming.
fn waiting(failure: &Failure) -> String {
    let secs = PATIENCE.as_secs();
    match failure {
        Failure::NoDaemon { .. } | Failure::NoNode { .. } => {
            format!("the daemon is gone; waiting up to {secs} s for it to come back, Ctrl-C ends")
        }
        _ => format!("{failure}; asking again for up to {secs} s, Ctrl-C ends"),
    }
}

/// The epoch that is waited in after the daemon was away: a swarm that comes back with it has a new
/// one, and goes on.
fn epoch_after_a_loss(epoch: u64, reply: &Reply<Status>) -> u64 {
    let is_reset = reply.result.reason.as_deref() == Some("reset");
    if reply.epoch > epoch && !is_reset {
        reply.epoch
    } else {
        epoch
    }
}

/// What a status says about a wait in `epoch`; nothing if the swarm is still on its way.
fn verdict(
    started: &Reply<RunResult>,
    epoch: u64,
    reply: &Reply<Status>,
) -> Option<Result<(), Failure>> {
    let (swarm, step) = (reply.swarm.clone(), reply.step);
    let reason = reply.result.reason.clone();
    let target = started.result.until_step;
    if reply.epoch != epoch {
        let epoch = reply.epoch;
        return Some(Err(Failure::StartedAnew { swarm, step, epoch }));
    }
    if target.is_some_and(|target| step >= target) {
        return Some(Ok(()));
    }
    match reply.phase {
        Phase::Running => None,
        Phase::Faulted => Some(Err(Failure::Faulted {
            swarm,
            step,
            reason,
        })),
        Phase::Paused if target.is_none() => Some(Ok(())),
        Phase::Paused => Some(Err(Failure::Stopped {
            swarm,
            step,
            target,
            reason,
        })),
    }
}

/// Moves the bar along with the swarm; never ends.
async fn advance(bus: &Bus, swarm: &str, started: &Reply<RunResult>, bar: &ProgressBar) {
    if !bar.is_hidden() {
        let key = keys::order(bus.prefix(), swarm);
        if let Ok(samples) = bus.subscribe(&key, 1).await {
            while let Ok(sample) = samples.recv_async().await {
                let Ok(sample) = Answer::from(&sample).read::<OrderSample>() else {
                    continue;
                };
                bar.set_position(sample.step.saturating_sub(started.step));
                bar.set_message(format!(
                    "time {}, order {}, rate {}",
                    format::time(sample.time),
                    format::share(Some(sample.order.order)),
                    format::factor(sample.real_time_factor),
                ));
            }
        }
    }
    std::future::pending::<()>().await;
}

/// A bar over the steps still to go; hidden unless stderr is a terminal.
fn bar(output: Output, started: &Reply<RunResult>) -> ProgressBar {
    if output.json {
        return ProgressBar::hidden();
    }
    let steps = started
        .result
        .until_step
        .map(|target| target.saturating_sub(started.step));
    let template = match steps {
        Some(_) => "{prefix} {bar:20} {percent:>3}%  {wide_msg} {eta} left",
        None => "{prefix} {spinner} {msg}",
    };
    let bar = ProgressBar::with_draw_target(steps, ProgressDrawTarget::stderr());
    bar.set_style(ProgressStyle::with_template(template).expect("a constant"));
    bar.set_prefix(started.swarm.clone());
    bar.set_message(format!("step {}", started.step));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde_json::{Value, json};

    use super::*;

    fn reply(step: u64, phase: &str, epoch: u64, result: &Value) -> Value {
        json!({
            "swarm": "demo", "epoch": epoch, "step": step, "time": 0.0, "phase": phase, "seq": 1,
            "result": result,
        })
    }

    fn started(until_step: Option<u64>) -> Reply<RunResult> {
        let result = json!({"until_step": until_step, "rate": 1.0});
        serde_json::from_value(reply(10, "running", 1, &result)).unwrap()
    }

    fn status(step: u64, phase: &str, epoch: u64) -> Reply<Status> {
        let result = json!({
            "reason": "because", "until_step": null, "rate": 1.0, "real_time_factor": null,
            "n": 3, "informed": 0, "seed": 0, "dt": 0.02,
            "parameters": {
                "pi1": 4.0, "pi2": 0.5, "pi3": 1.0, "pi4": 10.0, "contacts": "endpoints",
                "stepping": "position", "relinearise": 0, "attraction": {"kind": "all"},
                "noise": 0.0, "publish_every": 5,
            },
            "scheduled": 0, "state_hash": "",
            "order": {
                "order": 0.0, "mean_order": null, "velocity": [0.0, 0.0], "mean_velocity": null,
                "direction": null, "drift": null, "mean_drift": null,
            },
            "certificate": {
                "worst_gap": null, "residual": 0.0, "degraded": 0, "crossed": 0, "contacts": 0,
                "iterations": 0,
            },
        });
        serde_json::from_value(reply(step, phase, epoch, &result)).unwrap()
    }

    fn exit_code(target: Option<u64>, status: &Reply<Status>) -> Option<u8> {
        verdict(&started(target), 1, status)
            .map(|outcome| outcome.map_or_else(|failure| failure.exit_code(), |()| 0))
    }

    #[test]
    fn a_wait_ends_when_the_step_is_reached_and_goes_on_until_then() {
        assert_eq!(exit_code(Some(20), &status(20, "paused", 1)), Some(0));
        assert_eq!(exit_code(Some(20), &status(25, "running", 1)), Some(0));
        assert_eq!(exit_code(Some(20), &status(19, "running", 1)), None);
    }

    #[test]
    fn a_wait_without_an_end_ends_with_a_pause() {
        assert_eq!(exit_code(None, &status(12, "paused", 1)), Some(0));
        assert_eq!(exit_code(None, &status(12, "running", 1)), None);
    }

    #[test]
    fn a_swarm_that_cannot_get_there_by_itself_ends_the_wait_with_its_kind() {
        assert_eq!(exit_code(Some(20), &status(12, "paused", 1)), Some(4));
        assert_eq!(exit_code(Some(20), &status(12, "faulted", 1)), Some(1));
        assert_eq!(exit_code(Some(20), &status(25, "running", 2)), Some(4));
    }

    #[test]
    fn a_swarm_that_comes_back_with_its_daemon_is_waited_for_and_one_that_was_reset_is_not() {
        assert_eq!(epoch_after_a_loss(1, &status(12, "running", 2)), 2);
        assert_eq!(epoch_after_a_loss(2, &status(12, "running", 1)), 2);
        let mut reset = status(0, "paused", 2);
        reset.result.reason = Some("reset".into());
        assert_eq!(epoch_after_a_loss(1, &reset), 1);
    }
}
