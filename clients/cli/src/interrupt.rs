//! Ctrl-C: ends the command line, never the swarm.

use std::pin::pin;
use std::sync::{LazyLock, Mutex, MutexGuard, Once, PoisonError};
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;

use crate::failure::Failure;

/// How long a verb may take to end after Ctrl-C.
const GRACE: Duration = Duration::from_millis(500);

/// How long it may take if it has begun a file: the whole file must be written, however slow the disk is.
const FILE_GRACE: Duration = Duration::from_secs(3600);

/// If the verb has begun a file, which it completes before it ends: what is left without that.
static LEFT: Mutex<Option<String>> = Mutex::new(None);

/// Has the first Ctrl-C leave the verb the time to complete what it has begun; a second one ends it,
/// and prints what is `left`.
pub fn complete_first(left: impl Into<String>) {
    *left_now() = Some(left.into());
}

fn left_now() -> MutexGuard<'static, Option<String>> {
    LEFT.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The signals received so far. A verb that starts to wait after a signal arrived sees it too.
static RECEIVED: LazyLock<watch::Sender<Received>> = LazyLock::new(watch::Sender::default);

/// How many signals were received, by kind.
#[derive(Clone, Copy, Debug, Default)]
struct Received {
    interrupts: u32,
    terminations: u32,
}

impl Received {
    fn is_any(&self) -> bool {
        self.interrupts + self.terminations > 0
    }
}

/// Handles Ctrl-C from now on. The caller is inside the runtime.
pub fn catch_interrupts() {
    catch(SignalKind::interrupt(), |received| received.interrupts += 1);
}

/// Handles the signals that close a terminal or end a process, from now on: for verbs that must
/// finish something first. The caller is inside the runtime.
pub fn catch_termination() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        for kind in [SignalKind::terminate(), SignalKind::hangup()] {
            if !is_ignored(kind) {
                catch(kind, |received| received.terminations += 1);
            }
        }
    });
}

/// Whether the process was started with a signal ignored, as `nohup` does with that of a closed terminal.
fn is_ignored(kind: SignalKind) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mut masks = status
        .lines()
        .filter_map(|line| line.strip_prefix("SigIgn:"));
    let mask = masks.find_map(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (kind.as_raw_value() - 1) & 1 == 1)
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

/// Completes if the user has pressed Ctrl-C, or when they do. If [`catch_termination`] was called, its
/// signals count as Ctrl-C.
pub async fn interrupted() {
    wait_until(Received::is_any).await;
}

/// Completes when the user presses Ctrl-C, closes the terminal or terminates the process.
pub async fn interrupted_or_terminated() {
    catch_termination();
    interrupted().await;
}

async fn wait_until(holds: impl FnMut(&Received) -> bool) {
    // The sender is static, so the channel is never closed.
    let _ = RECEIVED.subscribe().wait_for(holds).await;
}

/// Completes when Ctrl-C is pressed after the signal for which [`interrupted`] completed.
async fn interrupted_again() {
    let counted = RECEIVED.borrow().interrupts.min(1);
    wait_until(|received| received.interrupts > counted).await;
}

/// Runs `work` until it is done or interrupted.
pub async fn either<T, E>(work: impl Future<Output = Result<T, E>>) -> Result<T, Failure>
where
    Failure: From<E>,
{
    tokio::select! {
        biased;
        outcome = work => Ok(outcome?),
        () = interrupted() => Err(Failure::interrupted()),
    }
}

/// Runs `work` until it is done, or until `grace` after an interruption; does not start it
/// if it was interrupted before. For a request whose effect can only be undone with its
/// reply; `left` describes what may continue.
pub async fn after_grace<T, E>(
    grace: Duration,
    left: &str,
    work: impl Future<Output = Result<T, E>>,
) -> Result<T, Failure>
where
    Failure: From<E>,
{
    if RECEIVED.borrow().is_any() {
        return Err(Failure::interrupted());
    }
    let mut work = pin!(work);
    tokio::select! {
        biased;
        outcome = &mut work => return Ok(outcome?),
        () = interrupted() => {}
    }
    match tokio::time::timeout(grace, work).await {
        Ok(outcome) => Ok(outcome?),
        Err(_) => Err(Failure::interrupted_leaving(left)),
    }
}

fn grace() -> Duration {
    match left_now().is_some() {
        true => FILE_GRACE,
        false => GRACE,
    }
}

/// Runs a verb on its own thread, so that Ctrl-C works even while stdout blocks.
/// Then it has a moment to end, or the time to complete its file unless Ctrl-C is pressed again.
pub async fn run_interruptible<V>(verb: impl FnOnce() -> V + Send + 'static) -> Result<(), Failure>
where
    V: Future<Output = Result<(), Failure>>,
{
    let runtime = Handle::current();
    let mut task = tokio::task::spawn_blocking(move || runtime.block_on(verb()));
    let ended = tokio::select! {
        biased;
        ended = &mut task => Some(ended),
        () = interrupted() => tokio::select! {
            biased;
            ended = tokio::time::timeout(grace(), &mut task) => ended.ok(),
            () = interrupted_again() => None,
        },
    };
    match ended {
        Some(Ok(outcome)) => outcome,
        Some(Err(error)) => Err(Failure::defect(error)),
        None => Err(left_now()
            .take()
            .map_or_else(Failure::interrupted, Failure::interrupted_leaving)),
    }
}
