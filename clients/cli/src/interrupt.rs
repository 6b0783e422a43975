//! Ctrl-C: ends the command line, never the swarm.

use std::pin::pin;
use std::sync::{LazyLock, Once};
use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;

use crate::failure::Failure;

/// How long a verb may take for its last words.
pub const GRACE: Duration = Duration::from_millis(500);

/// The signals received so far. A verb that starts to wait after a signal arrived sees it too.
static RECEIVED: LazyLock<watch::Sender<Received>> = LazyLock::new(watch::Sender::default);

/// How many signals were received, by kind.
#[derive(Clone, Copy, Debug, Default)]
struct Received {
    /// SIGINT.
    interrupts: u32,
    /// SIGTERM and SIGHUP.
    endings: u32,
}

impl Received {
    fn is_any(&self) -> bool {
        self.interrupts + self.endings > 0
    }
}

/// Handles Ctrl-C from now on. The caller is inside the runtime.
pub fn catch_interrupts() {
    catch(SignalKind::interrupt(), |received| received.interrupts += 1);
}

/// Handles the signals that close a terminal or end a process, from now on: for verbs that must
/// finish something first. The caller is inside the runtime.
pub fn catch_endings() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        for kind in [SignalKind::terminate(), SignalKind::hangup()] {
            catch(kind, |received| received.endings += 1);
        }
    });
}

/// Installs a handler. If that fails, the signal ends the process as without one.
fn catch(kind: SignalKind, count: fn(&mut Received)) {
    if let Ok(mut signals) = signal(kind) {
        tokio::spawn(async move {
            while signals.recv().await.is_some() {
                RECEIVED.send_modify(count);
            }
        });
    }
}

/// Completes if the user has pressed Ctrl-C, or when they do. If [`catch_endings`] was called, its
/// signals count as Ctrl-C.
pub async fn pressed() {
    until(Received::is_any).await;
}

/// Completes when the user presses Ctrl-C, closes the terminal or asks the process to end.
pub async fn asked_to_end() {
    catch_endings();
    pressed().await;
}

async fn until(holds: impl FnMut(&Received) -> bool) {
    // The sender is static, so the channel is never closed.
    let _ = RECEIVED.subscribe().wait_for(holds).await;
}

/// Completes when Ctrl-C is pressed after the signal for which [`pressed`] completed.
async fn pressed_again() {
    let counted = RECEIVED.borrow().interrupts.min(1);
    until(|received| received.interrupts > counted).await;
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

/// Runs `work`, unless it is interrupted before it began, and for up to `grace` after that: for a
/// request whose effect can only be undone with its reply. `left` says what may go on without it.
///
/// # Errors
///
/// Those of `work`, or [`Failure::Interrupted`].
pub async fn after_grace<T>(
    grace: Duration,
    left: &str,
    work: impl Future<Output = Result<T, Failure>>,
) -> Result<T, Failure> {
    if RECEIVED.borrow().is_any() {
        return Err(Failure::Interrupted { left: None });
    }
    let mut work = pin!(work);
    tokio::select! {
        biased;
        outcome = &mut work => return outcome,
        () = pressed() => {}
    }
    let left = Some(left.to_owned());
    let ended = tokio::time::timeout(grace, work).await;
    ended.unwrap_or(Err(Failure::Interrupted { left }))
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
            () = pressed_again() => None,
        },
    };
    match ended {
        Some(Ok(outcome)) => outcome,
        Some(Err(error)) => Err(Failure::defect(error)),
        None => Err(Failure::Interrupted { left: None }),
    }
}
