//! Ctrl-C: ends the command line, never the swarm.

use std::time::Duration;

use crate::failure::Failure;

/// How long a verb may take for its last words.
const GRACE: Duration = Duration::from_millis(500);

/// Completes when the user presses Ctrl-C.
pub async fn pressed() {
    if tokio::signal::ctrl_c().await.is_err() {
        // Without a handler the signal ends the process as it always did.
        std::future::pending::<()>().await;
    }
}

/// Runs `work` until it is done or interrupted.
///
/// # Errors
///
/// Those of `work`, or [`Failure::Interrupted`].
pub async fn either<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    tokio::select! {
        biased;
        outcome = work => outcome,
        () = pressed() => Err(Failure::Interrupted { left: None }),
    }
}

/// Runs a whole verb on a task of its own, so that Ctrl-C works even while nobody reads stdout.
///
/// # Errors
///
/// Those of `verb`, or [`Failure::Interrupted`].
pub async fn watched(
    verb: impl Future<Output = Result<(), Failure>> + Send + 'static,
) -> Result<(), Failure> {
    let mut task = tokio::spawn(verb);
    let ended = tokio::select! {
        biased;
        ended = &mut task => Some(ended),
        () = pressed() => tokio::time::timeout(GRACE, &mut task).await.ok(),
    };
    match ended {
        Some(Ok(outcome)) => outcome,
        Some(Err(error)) => Err(Failure::defect(error)),
        None => Err(Failure::Interrupted { left: None }),
    }
}
