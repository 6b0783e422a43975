//! `run`: runs a swarm and, with `--wait`, waits for its end, which may take hours.

use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use jostle_client::{Client, Error, FollowOptions, Payload, Update};
use jostle_proto::verbs::{RunArgs, RunResult, WhenResult};
use jostle_proto::{ErrorCode, Phase, Reply, Status};

use crate::arguments::RunArguments;
use crate::context::Context;
use crate::failure::{Failure, RunEnd};
use crate::format;
use crate::interrupt;
use crate::output::Output;
use crate::progress;
use crate::values::{End, Rate};
use crate::verbs::outage::{Outage, RETRY_DELAY, is_missing, wait_for_deadline};
use crate::verbs::when;
use crate::verbs::which;

/// Runs swarms; waits for the end of one for at most `timeout` seconds, if it is given.
pub async fn run(
    context: &Context,
    arguments: &RunArguments,
    timeout: Option<f64>,
) -> Result<(), Failure> {
    let swarms = interrupt::either(which::chosen(context, "run", &arguments.swarms)).await?;
    if arguments.wait && swarms.len() > 1 {
        let problem =
            "waits for one swarm: leave it out, and wait for each with `jostle run NAME --wait`";
        return Err(Failure::argument("--wait", problem));
    }
    let run = async |swarm: &str| run_one(context, arguments, swarm, timeout).await;
    which::each(context.output, "run", &swarms, run).await
}

async fn run_one(
    context: &Context,
    arguments: &RunArguments,
    name: &str,
    timeout: Option<f64>,
) -> Result<(), Failure> {
    let Context { client, output } = context;
    let sending = &arguments.swarms.sending;
    let (until_time, condition) = match &arguments.until {
        Some(End::Time(time)) => (Some(*time), None),
        Some(End::Condition(condition)) => (None, Some(condition)),
        None => (None, None),
    };
    let mut watched = None;
    if let Some(condition) = condition {
        if sending.sender.request_id.is_some() {
            let problem = "names one request, and a run until a condition sends two: leave it out";
            return Err(Failure::argument("--request-id", problem));
        }
        let answer = interrupt::either(when::pause_when(context, name, condition, sending)).await?;
        // A condition for a later step has no id yet.
        let reply = answer.read::<Reply<WhenResult>>().ok();
        watched = Some(RunEnd::Condition {
            text: condition.clone(),
            id: reply.and_then(|it| it.result.id),
        });
    }
    let args = RunArgs {
        until_step: arguments.until_step,
        until_time,
        rate: arguments.rate.map(|Rate(rate)| rate),
    };
    // A connection may be lost and restored between the reply and the first query.
    let lost_before = client.connections_lost();
    let began = Instant::now();
    let answer = match interrupt::either(client.command(name, "run", &args, sending)).await {
        Ok(answer) => answer,
        Err(error) => return Err(without_condition(context, name, watched, error).await),
    };
    if !arguments.wait {
        return output.outcome(&answer, "run", describe);
    }
    let reply: Reply<RunResult> = answer.read()?;
    let end = timeout.map(|secs| (began + Duration::from_secs_f64(secs)).into());
    let run_end = watched.unwrap_or(match reply.result.until_step {
        Some(step) => RunEnd::Step(step),
        None => RunEnd::Pause,
    });
    let bar = bar(*output, &reply);
    let outcome = tokio::select! {
        biased;
        outcome = reached(context, &reply, &run_end, lost_before, &bar) => outcome,
        failure = follow(client, &reply, &bar) => Err(failure),
        () = wait_for_deadline(end) => {
            Err(Failure::not_reached(name, &run_end, timeout.unwrap_or_default()))
        }
        () = interrupt::interrupted() => {
            Err(Failure::interrupted_leaving(run_end.runs_on(name)))
        }
    };
    bar.finish_and_clear();
    let (answer, reached) = outcome?;
    // Prints the status also if the swarm did not reach its end.
    output.reply(&answer, |reply: &Reply<Status>| {
        let secs = began.elapsed().as_secs_f64();
        format!("{}; waited {secs:.1} s", format::standing(reply))
    })?;
    reached
}

/// The reply to a `run` without `--wait`.
fn describe(reply: &Reply<RunResult>) -> String {
    let RunResult { until_step, rate } = reply.result;
    let mut text = format::standing(reply);
    if let Some(step) = until_step {
        text.push_str(&format!(", until step {step}"));
    }
    text.push_str(&format!(", rate {}", format::rate(rate)));
    text
}

/// The failure of a `run`; if it was rejected, the condition for its end is removed.
async fn without_condition(
    context: &Context,
    swarm: &str,
    watched: Option<RunEnd>,
    failure: Failure,
) -> Failure {
    let Some(RunEnd::Condition { id: Some(id), .. }) = watched else {
        return failure;
    };
    if failure.rejection().is_some() && when::cancel(context, swarm, &id).await.is_ok() {
        return failure;
    }
    let left = format!("its condition may remain: `jostle when {swarm} --cancel {id}` removes it");
    failure.leaving(left)
}

/// Waits until the swarm has reached its end or can no longer reach it; the last reply, and whether
/// it is the one waited for.
async fn reached(
    context: &Context,
    started: &Reply<RunResult>,
    end: &RunEnd,
    mut lost_before: u64,
    bar: &ProgressBar,
) -> Result<(Payload, Result<(), Failure>), Failure> {
    let Context { client, output } = context;
    let target = started.result.until_step;
    let condition = target.map_or_else(|| "phase=paused".into(), |step| format!("step={step}"));
    let mut epoch = started.epoch;
    let mut outage = Outage::default();
    // Whether a query has failed since the last status: the daemon may have been restarted.
    let mut was_interrupted = false;
    loop {
        let (sent, held) = (Instant::now(), outage.hold_time());
        let note = |text: &str| bar.suspend(|| output.note(text));
        match client.wait(&started.swarm, &condition, held).await {
            Ok(answer) => {
                let reply: Reply<Status> = answer.read()?;
                if was_interrupted || client.connections_lost() != lost_before {
                    epoch = epoch_after_a_loss(epoch, &reply);
                }
                outage.end(note);
                if let Some(verdict) = verdict(end, epoch, &reply) {
                    return Ok((answer, verdict));
                }
                lost_before = client.connections_lost();
                was_interrupted = false;
                tokio::time::sleep(RETRY_DELAY).await;
            }
            Err(Error::Rejected(error)) if error.code == ErrorCode::DeadlineExceeded => {
                outage.end(note);
                // The reply is early if too many clients wait for the swarm: let others wait.
                if sent.elapsed() < held {
                    tokio::time::sleep(RETRY_DELAY).await;
                }
            }
            Err(error) => {
                was_interrupted = true;
                outage.wait_to_retry(error, note).await?;
            }
        }
    }
}

/// The epoch to wait in after a restart of the daemon: a recovered swarm has a new epoch and
/// continues.
fn epoch_after_a_loss(epoch: u64, reply: &Reply<Status>) -> u64 {
    let is_reset = reply.result.reason.as_deref() == Some("reset");
    if reply.epoch > epoch && !is_reset {
        reply.epoch
    } else {
        epoch
    }
}

/// The verdict of a status on a wait in `epoch`; `None` if the swarm still runs.
fn verdict(end: &RunEnd, epoch: u64, reply: &Reply<Status>) -> Option<Result<(), Failure>> {
    let (swarm, step) = (&reply.swarm, reply.step);
    let reason = reply.result.reason.clone();
    if reply.epoch != epoch {
        let epoch = reply.epoch;
        return Some(Err(Failure::was_reset(swarm, step, epoch)));
    }
    let is_paused = reply.phase == Phase::Paused;
    let is_reached = match end {
        RunEnd::Pause => is_paused,
        RunEnd::Step(target) => step >= *target,
        RunEnd::Condition { id, .. } => {
            let mut waiting = reply.result.conditions.iter();
            let is_waiting = waiting.any(|it| id.as_ref() == Some(&it.id));
            is_paused && reason.as_deref() == Some("condition") && !is_waiting
        }
    };
    match reply.phase {
        _ if is_reached => Some(Ok(())),
        Phase::Running => None,
        Phase::Faulted => Some(Err(Failure::faulted(swarm, step, reason))),
        Phase::Paused => Some(Err(Failure::stopped(swarm, step, end, reason))),
    }
}

/// Moves the bar with the swarm; returns only if the swarm is deleted.
async fn follow(client: &Client, started: &Reply<RunResult>, bar: &ProgressBar) -> Failure {
    let swarm = &started.swarm;
    let mut updates = loop {
        let options = FollowOptions {
            order: (!bar.is_hidden()).then_some(1),
            ..FollowOptions::default()
        };
        match client.follow(swarm, options).await {
            Ok(updates) => break updates,
            // `reached` reports the outage, and ends the verb if it lasts.
            Err(error) if error.is_transient() || is_missing(&error) => {
                tokio::time::sleep(RETRY_DELAY).await;
            }
            Err(error) => return error.into(),
        }
    };
    loop {
        match updates.next().await {
            Some(Ok(Update::Order(sample))) => {
                bar.set_position(sample.step.saturating_sub(started.step));
                bar.set_message(format!(
                    "time {}, order {}, rate {}",
                    format::time(sample.time),
                    format::share(Some(sample.order.order)),
                    format::factor(sample.real_time_factor),
                ));
            }
            Some(Ok(Update::Deleted)) | None => {
                return Failure::deleted(swarm);
            }
            Some(Ok(_) | Err(Error::Decode { .. })) => {}
            Some(Err(error)) => return error.into(),
        }
    }
}

/// A bar over the remaining steps.
fn bar(output: Output, started: &Reply<RunResult>) -> ProgressBar {
    let target = started.result.until_step;
    let steps = target.map(|target| target.saturating_sub(started.step));
    let template = match steps {
        Some(_) => progress::STEPS,
        None => "{prefix} {spinner} {msg}",
    };
    let bar = progress::bar(output, steps, template, &started.swarm);
    bar.set_message(format!("step {}", started.step));
    bar
}

#[cfg(test)]
mod tests {
    use jostle_proto::{WaitingAction, WaitingCondition};

    use super::*;
    use crate::fixtures;

    fn status(step: u64, phase: Phase, epoch: u64) -> Reply<Status> {
        Reply {
            step,
            phase,
            epoch,
            ..fixtures::status()
        }
    }

    fn exit_code(target: Option<u64>, status: &Reply<Status>) -> Option<u8> {
        let end = target.map_or(RunEnd::Pause, RunEnd::Step);
        verdict(&end, 1, status)
            .map(|outcome| outcome.map_or_else(|failure| failure.exit_code(), |()| 0))
    }

    #[test]
    fn a_wait_ends_when_the_step_is_reached_and_not_before() {
        assert_eq!(exit_code(Some(20), &status(20, Phase::Paused, 1)), Some(0));
        assert_eq!(exit_code(Some(20), &status(25, Phase::Running, 1)), Some(0));
        assert_eq!(exit_code(Some(20), &status(19, Phase::Running, 1)), None);
    }

    #[test]
    fn a_wait_without_an_end_ends_with_a_pause() {
        assert_eq!(exit_code(None, &status(12, Phase::Paused, 1)), Some(0));
        assert_eq!(exit_code(None, &status(12, Phase::Running, 1)), None);
    }

    #[test]
    fn a_run_until_a_condition_is_over_when_that_has_paused_the_swarm_and_does_not_wait_any_more() {
        let waiting = |id: &str| WaitingCondition {
            id: id.to_owned(),
            condition: "order > 0.9".to_owned(),
            action: WaitingAction::Pause,
            event: None,
            client: None,
            evaluated: true,
        };
        let exit_code = |id: Option<&str>, reason: &str, others: &[&str]| {
            let end = RunEnd::Condition {
                text: "order > 0.9".to_owned(),
                id: id.map(str::to_owned),
            };
            let mut status = status(12, Phase::Paused, 1);
            status.result.reason = Some(reason.to_owned());
            status.result.conditions = others.iter().map(|it| waiting(it)).collect();
            verdict(&end, 1, &status)
                .map(|outcome| outcome.map_or_else(|failure| failure.exit_code(), |()| 0))
        };
        assert_eq!(exit_code(Some("0a"), "condition", &[]), Some(0));
        assert_eq!(exit_code(Some("0a"), "condition", &["0b"]), Some(0));
        assert_eq!(exit_code(None, "condition", &["0b"]), Some(0));
        // Another condition has paused it, or a client.
        assert_eq!(exit_code(Some("0a"), "condition", &["0a"]), Some(4));
        assert_eq!(exit_code(Some("0a"), "requested", &["0a"]), Some(4));
        assert_eq!(exit_code(Some("0a"), "lockstep", &["0a"]), Some(4));
        // A client has removed the condition.
        assert_eq!(exit_code(Some("0a"), "requested", &[]), Some(4));
    }

    #[test]
    fn a_swarm_that_cannot_get_there_by_itself_ends_the_wait_with_its_kind() {
        assert_eq!(exit_code(Some(20), &status(12, Phase::Paused, 1)), Some(4));
        assert_eq!(exit_code(Some(20), &status(12, Phase::Faulted, 1)), Some(1));
        assert_eq!(exit_code(Some(20), &status(25, Phase::Running, 2)), Some(4));
    }

    #[test]
    fn a_swarm_that_comes_back_with_its_daemon_is_waited_for_and_one_that_was_reset_is_not() {
        assert_eq!(epoch_after_a_loss(1, &status(12, Phase::Running, 2)), 2);
        assert_eq!(epoch_after_a_loss(2, &status(12, Phase::Running, 1)), 2);
        let mut reset = status(0, Phase::Paused, 2);
        reset.result.reason = Some("reset".into());
        assert_eq!(epoch_after_a_loss(1, &reset), 1);
    }
}
