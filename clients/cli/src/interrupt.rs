//! Ctrl-C: ends the command line, never the swarm.

use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};

use crate::failure::Failure;

/// How long a verb may take for its last words.
pub const GRACE: Duration = Duration::from_millis(500);

/// Completes when the user presses Ctrl-C.
pub async fn pressed() {
    if tokio::signal::ctrl_c().await.is_err() {
        // Without a handler the signal ends the process as it always did.
        std::future::pending::<()>().await;
    }
}

/// Completes when the user presses Ctrl-C, closes the terminal or asks the process to end: for
/// those who have something to put in order first.
pub async fn asked_to_end() {
    let came = |kind| async move {
        match signal(kind) {
            Ok(mut signals) => drop(signals.recv().await),
            // As above.
            Err(_) => std::future::pending().await,
        }
    };
    tokio::select! {
        () = pressed() => {}
        () = came(SignalKind::terminate()) => {}
        () = came(SignalKind::hangup()) => {}
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
/// Then it has `grace` to end, unless Ctrl-C is pressed again.
///
/// # Errors
///
/// Those of `verb`, or [`Failure::Interrupted`].
pub async fn watched(
    grace: Duration,
    verb: impl Future<Output = Result<(), Failure>> + Send + 'static,
) -> Result<(), Failure> {
    let mut task = tokio::spawn(verb);
    let ended = tokio::select! {
        biased;
        ended = &mut task => Some(ended),
        () = pressed() => tokio::select! {
            biased;
            ended = tokio::time::timeout(grace, &mut task) => ended.ok(),
            () = pressed() => None,
        },
    };
    match ended {
        Some(Ok(outcome)) => outcome,
        Some(Err(error)) => Err(Failure::defect(error)),
        None => Err(Failure::Interrupted { left: None }),
    }
}
