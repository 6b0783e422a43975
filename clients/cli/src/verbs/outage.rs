//! Interruptions of the connection: their notes, and how long a verb that waits tolerates them.

use std::time::Duration;

use jostle_client::Error;
use jostle_proto::ErrorCode;
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
/// How long the daemon holds a query of a wait before it is sent again.
const HOLD_TIME: Duration = Duration::from_secs(30);
/// How long it holds the first one after an error: its reply shows that the daemon is back.
const FIRST_HOLD_TIME: Duration = Duration::from_millis(50);

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

    /// How long the daemon is to hold the next query of a wait.
    pub fn hold_time(&self) -> Duration {
        match self.is_ongoing() {
            true => FIRST_HOLD_TIME,
            false => HOLD_TIME,
        }
    }

    /// A request succeeded. The end of an outage that was noted is noted, too.
    pub fn end(&mut self, note: impl FnOnce(&str)) {
        if std::mem::take(self).is_noted {
            note(DAEMON_BACK);
        }
    }

    /// Waits before a retry, or returns the error if a retry cannot help or the timeout has passed.
    /// The first error of an outage is noted.
    pub async fn wait_to_retry(
        &mut self,
        error: Error,
        note: impl FnOnce(&str),
    ) -> Result<(), Failure> {
        let is_about_a_token = is_about_a_token(&error);
        if !error.is_transient() && !is_missing(&error) && !is_about_a_token {
            return Err(error.into());
        }
        let is_gone = matches!(error, Error::NoDaemon { .. } | Error::NoNode { .. });
        let failure = Failure::from(error);
        if !is_about_a_token && !std::mem::replace(&mut self.is_noted, true) {
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

/// Whether no daemon serves the swarm, such as while its daemon restarts behind a router. A daemon that rejects a
/// request with `not_found` has deleted the swarm.
pub fn is_missing(error: &Error) -> bool {
    let is_rejected = matches!(error, Error::Rejected(error) if error.code == ErrorCode::NotFound);
    error.is_not_found() && !is_rejected
}

/// Whether the daemon has not received the liveliness token of the request, which may arrive after the
/// request once a connection was lost.
fn is_about_a_token(error: &Error) -> bool {
    matches!(error, Error::Rejected(error) if error.details.contains_key("token"))
}

/// Completes at `deadline`, never without one.
pub async fn wait_for_deadline(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => sleep_until(deadline).await,
        None => std::future::pending().await,
    }
}
