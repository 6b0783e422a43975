//! `verify`: whether a swarm's past comes out the same when it is told again.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use jostle_proto::{Reply, Status, Verified, keys};

use crate::arguments::VerifyArguments;
use crate::bus::{Bus, Whom};
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::verbs::print;

/// How long a past may take to tell: as long as the daemon tells it.
const PATIENCE: Duration = Duration::from_secs(3600 + 10);

/// How often the progress is asked for.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(300);
/// The bar's length: a share in thousandths.
const WHOLE: f64 = 1000.0;

/// Verifies a swarm.
///
/// # Errors
///
/// [`Failure::Mismatch`] when a step comes out otherwise, or why it is not known.
pub async fn verify(bus: &Bus, output: Output, arguments: &VerifyArguments) -> Result<(), Failure> {
    let swarm = &arguments.name;
    let key = keys::get(bus.prefix(), swarm, "verify");
    // It is asked once: each time it would be told from the beginning.
    let asked = bus.ask(Whom::Swarm(swarm), &key, None, PATIENCE);
    let bar = bar(output, swarm);
    let answer = tokio::select! {
        biased;
        answer = asked => answer,
        () = show_progress(bus, swarm, &bar), if !bar.is_hidden() => unreachable!("it goes on"),
    };
    bar.finish_and_clear();
    let answer = answer?;
    print(output, &answer, words)?;
    let reply: Reply<Verified> = answer.read()?;
    match reply.result.differs_at {
        Some(step) => Err(Failure::Mismatch {
            swarm: reply.swarm,
            step,
        }),
        None => Ok(()),
    }
}

/// Moves the bar on as the daemon reports it; never ends.
async fn show_progress(bus: &Bus, swarm: &str, bar: &ProgressBar) {
    loop {
        tokio::time::sleep(PROGRESS_INTERVAL).await;
        // If a reply is lost, skip one update of the bar.
        let Ok(answer) = bus.get(swarm, "status").await else {
            continue;
        };
        if let Ok(Reply { result, .. }) = answer.read::<Reply<Status>>()
            && let Some(share) = result.verifying
        {
            bar.set_position(of_whole(share));
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a share is from 0 to 1"
)]
fn of_whole(share: f64) -> u64 {
    (share * WHOLE) as u64
}

/// How much of the history is replayed; hidden unless stderr is a terminal.
fn bar(output: Output, swarm: &str) -> ProgressBar {
    if output.json {
        return ProgressBar::hidden();
    }
    let target = ProgressDrawTarget::stderr();
    let bar = ProgressBar::with_draw_target(Some(of_whole(1.0)), target);
    let template = "verifying {prefix} {bar:30} {percent:>3}%  {elapsed}";
    bar.set_style(ProgressStyle::with_template(template).expect("a constant"));
    bar.set_prefix(swarm.to_owned());
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

fn words(reply: &Reply<Verified>) -> String {
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
    let told = format!("told again from step {from_step} to step {to_step}{since}");
    let compared = format::count(hashes, "hash").replace("hashs", "hashes");
    match (hashes, differs_at) {
        (_, Some((step, epoch))) => {
            format!(
                "{swarm} differs first at step {step} of epoch {epoch}: {told}, {compared} compared"
            )
        }
        (0, None) => format!(
            "{swarm} runs and has written down no hash yet after step {from_step}: pause it, and what \
             it is now can be compared"
        ),
        (_, None) => format!("{swarm} is the same: {told}, {compared} compared"),
    }
}

#[cfg(test)]
mod tests {
    use jostle_proto::Phase;

    use super::*;

    fn said(hashes: u64, differs_at: Option<u64>) -> String {
        words(&Reply {
            swarm: "demo".into(),
            epoch: 1,
            step: 900,
            time: 18.0,
            phase: Phase::Paused,
            seq: 3,
            result: Verified {
                from_step: 0,
                to_step: 800,
                hashes,
                differs_at,
                differs_in_epoch: differs_at.map(|_| 2),
            },
        })
    }

    #[test]
    fn what_was_compared_is_told_and_nothing_is_not_the_same() {
        assert_eq!(
            said(1, None),
            "demo is the same: told again from step 0 to step 800, not the 100 steps since, \
             1 hash compared"
        );
        assert!(said(9, Some(800)).starts_with("demo differs first at step 800 of epoch 2: "));
        assert!(said(9, Some(800)).ends_with("9 hashes compared"));
        assert!(said(0, None).contains("no hash yet"));
    }
}
