//! `wait`: waits until a condition holds in a swarm, without changing it.

use std::time::{Duration, Instant};

use jostle_client::{Error, Payload};
use jostle_proto::{ErrorCode, Phase, Reply, Status};

use crate::arguments::WaitArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format::standing;
use crate::interrupt;
use crate::verbs::outage::{Outage, RETRY_DELAY, wait_for_deadline};

/// Waits for at most `timeout` seconds, if it is given.
pub async fn wait(
    context: &Context,
    arguments: &WaitArguments,
    timeout: Option<f64>,
) -> Result<(), Failure> {
    let WaitArguments {
        name: swarm,
        condition,
    } = arguments;
    if condition.contains(';') {
        return Err(Failure::argument(
            "CONDITION",
            "contains a `;`, which no condition does",
        ));
    }
    // Fails if there is no such swarm; later there may be no reply because of an outage.
    tokio::select! {
        biased;
        status = context.client.status(swarm) => drop(status?),
        () = interrupt::interrupted() => return Err(Failure::interrupted()),
    }
    let began = Instant::now();
    let end = timeout.map(|secs| (began + Duration::from_secs_f64(secs)).into());
    let answer = tokio::select! {
        biased;
        outcome = held(context, swarm, condition) => outcome,
        () = wait_for_deadline(end) => {
            Err(Failure::not_held(swarm, condition, timeout.unwrap_or_default()))
        }
        () = interrupt::interrupted() => Err(Failure::interrupted()),
    }?;
    context.output.reply(&answer, |reply: &Reply<Status>| {
        let secs = began.elapsed().as_secs_f64();
        format!("{condition} holds; {}; waited {secs:.1} s", standing(reply))
    })
}

/// Waits until the condition holds, also while the daemon restarts. Returns the status.
async fn held(context: &Context, swarm: &str, condition: &str) -> Result<Payload, Failure> {
    let Context { client, output } = context;
    let wait = client.wait_for(swarm, condition).await?;
    let mut outage = Outage::default();
    loop {
        let (sent, held) = (Instant::now(), outage.hold_time());
        let note = |text: &str| output.note(text);
        match wait.query(held).await {
            Ok(answer) => {
                outage.end(note);
                let reply: Reply<Status> = answer.read()?;
                return match reply.phase {
                    Phase::Faulted => Err(Failure::faulted(swarm, reply.step, reply.result.reason)),
                    _ => Ok(answer),
                };
            }
            Err(Error::Rejected(error)) if error.code == ErrorCode::DeadlineExceeded => {
                outage.end(note);
                // The reply is early if too many requests wait: send the next one later.
                if sent.elapsed() < held {
                    tokio::time::sleep(RETRY_DELAY).await;
                }
            }
            // Of a daemon that has recovered its swarms: this one was deleted. During an outage there is no reply.
            Err(Error::Rejected(error)) if error.code == ErrorCode::NotFound => {
                return Err(Error::Rejected(error).into());
            }
            Err(error) => {
                outage.wait_to_retry(error, note).await?;
            }
        }
    }
}
