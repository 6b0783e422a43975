//! `verify`: replays the history of a swarm and compares hashes.

use std::time::Duration;

use indicatif::ProgressBar;
use jostle_client::{Client, Error, Payload, Target};
use jostle_proto::{ErrorCode, Reply, Verified, keys};

use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::progress::{self, THOUSANDTHS};

/// How long it may take, in seconds: the most that the daemon accepts.
const MAX_SECS: f64 = 3600.0;

/// How much longer than the daemon the client waits, so that it receives the daemon's error.
const MARGIN: Duration = Duration::from_secs(1);

/// How often the progress is queried.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(300);

/// Verifies a swarm, for at most `timeout` seconds if it is given.
pub async fn verify(context: &Context, swarm: &str, timeout: Option<f64>) -> Result<(), Failure> {
    let Context { client, output } = context;
    let verified = verified(client, swarm, timeout.unwrap_or(MAX_SECS).min(MAX_SECS));
    let template = "verifying {prefix} {bar:30} {percent:>3}%  {elapsed}";
    let bar = progress::bar(*output, Some(THOUSANDTHS), template, swarm);
    let answer = tokio::select! {
        biased;
        answer = verified => answer,
        () = show_progress(client, swarm, &bar), if !bar.is_hidden() => unreachable!("it never ends"),
    };
    bar.finish_and_clear();
    let answer = answer?;
    output.reply(&answer, describe)?;
    let reply: Reply<Verified> = answer.read()?;
    match reply.result.differs_at {
        Some(step) => {
            let message = format!(
                "{} replays differently from step {step} on: another version stepped it, or the \
                 machine erred; please report it",
                reply.swarm
            );
            Err(Failure::new("mismatch", message).at_step(step))
        }
        None => Ok(()),
    }
}

/// Queries the result. The query is sent once: each replays from the beginning.
async fn verified(client: &Client, swarm: &str, secs: f64) -> Result<Payload, Error> {
    let key = keys::get(client.prefix(), swarm, "verify");
    let (target, timeout) = (Target::Swarm(swarm), Duration::from_secs_f64(secs) + MARGIN);
    let selector = format!("{key}?timeout_secs={secs}");
    match client.query_once(target, &selector, None, timeout).await {
        // A daemon of an earlier version has no such parameter, and replays for up to an hour.
        Err(Error::Rejected(error))
            if error.code == ErrorCode::InvalidArgument && error.details.contains_key("known") =>
        {
            client.query_once(target, &key, None, timeout).await
        }
        replied => replied,
    }
}

/// Moves the bar on as the daemon reports it; never ends.
async fn show_progress(client: &Client, swarm: &str, bar: &ProgressBar) {
    loop {
        tokio::time::sleep(PROGRESS_INTERVAL).await;
        // If a reply is lost, skip one update of the bar.
        if let Ok(status) = client.status(swarm).await
            && let Some(share) = status.result.verifying
        {
            bar.set_position(progress::thousandths(share));
        }
    }
}

fn describe(reply: &Reply<Verified>) -> String {
    let Verified {
        from_step,
        to_step,
        hashes,
        differs_at,
        differs_in_epoch,
    } = reply.result;
    let differs_at = differs_at.zip(differs_in_epoch);
    let swarm = &reply.swarm;
    let since = match reply.step.saturating_sub(to_step) {
        0 => String::new(),
        steps => format!(", not the {} since", format::count(steps, "step")),
    };
    let replayed = format!("replayed from step {from_step} to step {to_step}{since}");
    let compared = format::count(hashes, "hash").replace("hashs", "hashes");
    match (hashes, differs_at) {
        (_, Some((step, epoch))) => {
            format!(
                "{swarm} differs first at step {step} of epoch {epoch}: {replayed}, {compared} compared"
            )
        }
        (0, None) => format!(
            "{swarm} runs and has journaled no hash yet after step {from_step}: pause it to compare \
             its current state"
        ),
        (_, None) => format!("{swarm} is the same: {replayed}, {compared} compared"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn described(hashes: u64, differs_at: Option<u64>) -> String {
        let mut reply = fixtures::reply(Verified {
            from_step: 0,
            to_step: 800,
            hashes,
            differs_at,
            differs_in_epoch: differs_at.map(|_| 2),
        });
        reply.step = 900;
        describe(&reply)
    }

    #[test]
    fn the_output_has_the_number_of_compared_hashes() {
        assert_eq!(
            described(1, None),
            "demo is the same: replayed from step 0 to step 800, not the 100 steps since, \
             1 hash compared"
        );
        assert!(described(9, Some(800)).starts_with("demo differs first at step 800 of epoch 2: "));
        assert!(described(9, Some(800)).ends_with("9 hashes compared"));
        assert!(described(0, None).contains("no hash yet"));
    }
}
