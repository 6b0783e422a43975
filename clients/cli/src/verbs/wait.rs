//! `wait`: waits until a condition holds in a swarm, without changing it.
//!
//! The condition waits in the daemon as a `when` with an event. It is removed if this wait ends before.

use std::time::{Duration, Instant};

use jostle_client::{CommandOptions, Error, Payload};
use jostle_proto::verbs::{WhenArgs, WhenResult};
use jostle_proto::{ErrorCode, Phase, Reply, Status};

use crate::arguments::WaitArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format::standing;
use crate::interrupt;
use crate::verbs::outage::{Outage, RETRY_DELAY, wait_for_deadline};

/// How long the daemon holds a query before it is sent again.
const HOLD_TIME: Duration = Duration::from_secs(30);

/// Waits for at most `timeout` seconds, if it is given.
pub async fn wait(
    context: &Context,
    arguments: &WaitArguments,
    timeout: Option<f64>,
) -> Result<(), Failure> {
    let Context { client, output } = context;
    let WaitArguments {
        name: swarm,
        condition,
        event,
        sender,
    } = arguments;
    let began = Instant::now();
    let event = event
        .clone()
        .unwrap_or_else(|| format!("wait-{}", client.new_id()));
    let args = WhenArgs {
        condition: Some(condition.clone()),
        event: Some(event.clone()),
        from_step: Some(0),
        ..WhenArgs::default()
    };
    let sent = client.command(swarm, "when", &args, CommandOptions::from(sender));
    let answer = interrupt::either(sent).await?;
    let reply: Reply<WhenResult> = answer.read()?;
    let describe = |reply: &Reply<Status>| {
        let secs = began.elapsed().as_secs_f64();
        format!("{condition} holds; {}; waited {secs:.1} s", standing(reply))
    };
    if reply.result.holds {
        return output.reply(&client.get(swarm, "status").await?, describe);
    }
    let end = timeout.map(|secs| (began + Duration::from_secs_f64(secs)).into());
    let outcome = tokio::select! {
        biased;
        outcome = held(context, swarm, &event) => outcome,
        () = wait_for_deadline(end) => {
            Err(Failure::not_held(swarm, condition, timeout.unwrap_or_default()))
        }
        () = interrupt::interrupted() => Err(Failure::interrupted()),
    };
    match outcome {
        Ok(answer) => output.reply(&answer, describe),
        Err(failure) => {
            let args = WhenArgs {
                event: Some(event),
                cancel: true,
                ..WhenArgs::default()
            };
            // Without a daemon or a swarm there is nothing to remove.
            let options = CommandOptions {
                request_id: None,
                ..CommandOptions::from(sender)
            };
            let _ = interrupt::either(client.command(swarm, "when", &args, options)).await;
            Err(failure)
        }
    }
}

/// Waits until the condition with this event has held, also while the daemon restarts. Returns the
/// status.
async fn held(context: &Context, swarm: &str, event: &str) -> Result<Payload, Failure> {
    let Context { client, output } = context;
    let mut outage = Outage::default();
    loop {
        let sent = Instant::now();
        match client
            .wait(swarm, &format!("event={event}"), HOLD_TIME)
            .await
        {
            Ok(answer) => {
                let reply: Reply<Status> = answer.read()?;
                return match reply.phase {
                    Phase::Faulted => Err(Failure::faulted(swarm, reply.step, reply.result.reason)),
                    _ => Ok(answer),
                };
            }
            Err(Error::Rejected(error)) if error.code == ErrorCode::DeadlineExceeded => {
                outage.end();
                // The reply is early if too many clients wait for the swarm: let others wait.
                if sent.elapsed() < HOLD_TIME {
                    tokio::time::sleep(RETRY_DELAY).await;
                }
            }
            // The condition was removed; another reason may pass while a daemon restarts.
            Err(Error::Rejected(error)) if error.details.contains_key("field") => {
                return Err(Failure::rejected(*error));
            }
            Err(error) => {
                let note = |text: &str| output.note(text);
                outage.wait_to_retry(error, note).await?;
            }
        }
    }
}
