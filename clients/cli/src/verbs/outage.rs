//! Interruptions of the connection: their notes, and how long a verb that waits tolerates them.

use std::time::Duration;

use jostle_client::Error;
use tokio::time::{Instant, sleep, sleep_until};

use crate::failure::Failure;

/// The note when the daemon is unreachable.
pub const DAEMON_AWAY: &str = "the daemon is gone; waiting for it to come back, Ctrl-C ends";
/// The note when it is reachable again.
pub const DAEMON_BACK: &str = "the daemon is back";

/// How long a verb that waits for a result tolerates errors.
const TIMEOUT: Duration = Duration::from_secs(60);
/// The pause before a retry.
pub const RETRY_DELAY: Duration = Duration::from_millis(500);

/// Errors that a retry may resolve, since when.
#[derive(Default)]
pub struct Outage {
    since: Option<Instant>,
    is_noted: bool,
}

impl Outage {
    /// Whether the last request failed.
    pub fn is_ongoing(&self) -> bool {
        self.since.is_some()
    }

    /// A request succeeded.
    pub fn end(&mut self) {
        *self = Outage::default();
    }

    /// Waits before a retry, or returns the error if a retry cannot help or the timeout has passed.
    /// The first transient error of an outage is noted.
    pub async fn wait_to_retry(
        &mut self,
        error: Error,
        note: impl FnOnce(&str),
    ) -> Result<(), Failure> {
        if !error.is_transient() && !error.is_not_found() {
            return Err(error.into());
        }
        let is_transient = error.is_transient();
        let is_gone = matches!(error, Error::NoDaemon { .. } | Error::NoNode { .. });
        let failure = Failure::from(error);
        if is_transient && !std::mem::replace(&mut self.is_noted, true) {
            let secs = TIMEOUT.as_secs();
            note(&match is_gone {
                true => format!(
                    "the daemon is gone; waiting up to {secs} s for it to come back, Ctrl-C ends"
                ),
                false => format!("{failure}; retrying for up to {secs} s, Ctrl-C ends"),
            });
        }
        if self.since.get_or_insert_with(Instant::now).elapsed() > TIMEOUT {
            return Err(failure);
        }
        sleep(RETRY_DELAY).await;
        Ok(())
    }
}

/// Completes at `deadline`, never without one.
pub async fn wait_for_deadline(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => sleep_until(deadline).await,
        None => std::future::pending().await,
    }
}
