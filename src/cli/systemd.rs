//! Notifications for a supervisor such as systemd: ready, status, watchdog, stopping.
//!
//! Without `NOTIFY_SOCKET` nothing is sent. The watchdog message is sent by a task of the runtime,
//! so a runtime that hangs misses it too.

use std::sync::Arc;
use std::time::Duration;

use jostle_physics::plural::counted;
use sd_notify::NotifyState;
use tokio::time::{MissedTickBehavior, interval};
use tracing::warn;

use crate::health::{HealthMonitor, Reason};
use crate::swarm::recovery_progress::RecoveryProgress;
use crate::swarm::registry::SwarmRegistry;

/// The interval between status messages without a watchdog.
const STATUS_INTERVAL: Duration = Duration::from_secs(10);

/// While the swarms are recovered: the interval between messages, and how long after the last progress the
/// supervisor is to wait for more, as `TimeoutStartSec` in `jostled.service`.
const RECOVERY_INTERVAL: Duration = Duration::from_secs(1);
const RECOVERY_TIMEOUT: Duration = Duration::from_secs(300);

/// Sends how many swarms are not recovered yet, and extends the timeout of the start, whenever a swarm was
/// recovered or a step or line was replayed, also if the replay of one swarm takes long: ready is sent when all are recovered, so that units that are ordered after the daemon find its
/// swarms. Does not return if there is a supervisor.
pub async fn notify_recovery(recovery: Arc<RecoveryProgress>) {
    if std::env::var_os("NOTIFY_SOCKET").is_none() {
        return;
    }
    let mut sent = None;
    loop {
        tokio::time::sleep(RECOVERY_INTERVAL).await;
        let progress = recovery.swarms_left().zip(Some(recovery.work()));
        if let Some((swarms_left, _)) = progress
            && progress != sent
        {
            let status = Reason::Recovering { swarms_left }.to_string();
            let micros = u32::try_from(RECOVERY_TIMEOUT.as_micros()).unwrap_or(u32::MAX);
            notify(&[
                NotifyState::ExtendTimeoutUsec(micros),
                NotifyState::Status(&status),
            ]);
        }
        sent = progress;
    }
}

/// Sends ready, then the status whenever it changes, and a watchdog message at half the allowed
/// interval unless the daemon needs a restart. Does not return if there is a supervisor.
pub async fn notify_status(watch: Arc<HealthMonitor>, registry: Arc<SwarmRegistry>) {
    if std::env::var_os("NOTIFY_SOCKET").is_none() {
        return;
    }
    notify(&[NotifyState::Ready]);
    let watchdog = sd_notify::watchdog_enabled();
    let period = watchdog.map_or(STATUS_INTERVAL, |allowed| allowed / 2);
    let mut due = interval(period.max(Duration::from_millis(1)));
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut sent = String::new();
    loop {
        due.tick().await;
        let reasons = watch.reasons();
        if watchdog.is_some() && !reasons.iter().any(Reason::needs_restart) {
            notify(&[NotifyState::Watchdog]);
        }
        let status = status(registry.handles().0.len(), &reasons);
        if status != sent {
            notify(&[NotifyState::Status(&status)]);
            sent = status;
        }
    }
}

pub fn notify_stopping() {
    notify(&[NotifyState::Stopping]);
}

fn notify(messages: &[NotifyState]) {
    if let Err(error) = sd_notify::notify(messages) {
        warn!(%error, "sd_notify failed");
    }
}

/// The status, in one line.
fn status(swarms: usize, reasons: &[Reason]) -> String {
    let swarms = counted(swarms, "swarm");
    if reasons.is_empty() {
        return format!("{swarms}, healthy");
    }
    let reasons: Vec<String> = reasons.iter().map(ToString::to_string).collect();
    // A second line would be another message.
    format!("{swarms}, unhealthy: {}", reasons.join("; ")).replace('\n', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_is_one_line_whatever_is_wrong() {
        assert_eq!(status(1, &[]), "1 swarm, healthy");
        let unresponsive = Reason::Unresponsive {
            endpoint: "tcp/127.0.0.1:1".to_owned(),
            problem: "refused\nWATCHDOG=1".to_owned(),
        };
        assert_eq!(
            status(2, &[Reason::StoreFull, unresponsive]),
            "2 swarms, unhealthy: the disk is full: free some space, and the journal goes on by \
             itself; tcp/127.0.0.1:1 does not answer: refused WATCHDOG=1"
        );
    }
}
