//! `verify`: replays the history of a swarm and compares hashes.

use std::time::Duration;

use indicatif::ProgressBar;
use jostle_client::{Client, Target};
use jostle_proto::{Reply, Verified, keys};

use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::progress::{self, THOUSANDTHS};

/// The timeout: longer than the daemon's own.
const VERIFY_TIMEOUT: Duration = Duration::from_secs(3600 + 10);

/// How often the progress is queried.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(300);

pub async fn verify(context: &Context, swarm: &str) -> Result<(), Failure> {
    let Context { client, output } = context;
    let key = keys::get(client.prefix(), swarm, "verify");
    // Sent once: each query replays from the beginning.
    let verified = client.query_once(Target::Swarm(swarm), &key, None, VERIFY_TIMEOUT);
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
