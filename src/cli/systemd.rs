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
use crate::swarm::registry::SwarmRegistry;

/// The interval between status messages without a watchdog.
const STATUS_INTERVAL: Duration = Duration::from_secs(10);

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
