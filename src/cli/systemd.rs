//! What a supervisor such as systemd is told: that the daemon serves, how it is, and that it stops.
//!
//! Nobody is told anything where `NOTIFY_SOCKET` names nobody. The watchdog is fed by a task of the
//! runtime, so that a runtime that hangs starves it, too.

use std::sync::Arc;
use std::time::Duration;

use jostle_physics::plural::counted;
use sd_notify::NotifyState;
use tokio::time::{MissedTickBehavior, interval};
use tracing::warn;

use crate::health::{Reason, Watch};
use crate::swarm::registry::SwarmRegistry;

/// How often is told how it is, where there is no watchdog.
const PERIOD: Duration = Duration::from_secs(10);

/// Tells that the daemon serves, and from then on how it is; feeds the watchdog at half the time
/// that it allows, as long as no other start is needed. Never ends where somebody listens.
pub async fn keep_informed(watch: Arc<Watch>, host: Arc<SwarmRegistry>) {
    if std::env::var_os("NOTIFY_SOCKET").is_none() {
        return;
    }
    tell(&[NotifyState::Ready]);
    let watchdog = sd_notify::watchdog_enabled();
    let period = watchdog.map_or(PERIOD, |allowed| allowed / 2);
    let mut due = interval(period.max(Duration::from_millis(1)));
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut told = String::new();
    loop {
        due.tick().await;
        let reasons = watch.reasons();
        if watchdog.is_some() && !reasons.iter().any(Reason::asks_for_restart) {
            tell(&[NotifyState::Watchdog]);
        }
        let status = status(host.handles().0.len(), &reasons);
        if status != told {
            tell(&[NotifyState::Status(&status)]);
            told = status;
        }
    }
}

/// Tells that the daemon stops.
pub fn tell_end() {
    tell(&[NotifyState::Stopping]);
}

fn tell(news: &[NotifyState]) {
    if let Err(error) = sd_notify::notify(news) {
        warn!(%error, "the supervisor does not take what it is told");
    }
}

/// How it is, in a line.
fn status(swarms: usize, reasons: &[Reason]) -> String {
    let swarms = counted(swarms, "swarm");
    if reasons.is_empty() {
        return format!("{swarms}, all is well");
    }
    let reasons: Vec<String> = reasons.iter().map(ToString::to_string).collect();
    // A second line would be another piece of news.
    format!("{swarms}, not all is well: {}", reasons.join("; ")).replace('\n', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_is_one_line_whatever_is_wrong() {
        assert_eq!(status(1, &[]), "1 swarm, all is well");
        let deaf = Reason::Deaf {
            endpoint: "tcp/127.0.0.1:1".to_owned(),
            problem: "refused\nWATCHDOG=1".to_owned(),
        };
        assert_eq!(
            status(2, &[Reason::StoreFull, deaf]),
            "2 swarms, not all is well: the disk is full: free some space, and the journal goes on \
             by itself; tcp/127.0.0.1:1 does not answer: refused WATCHDOG=1"
        );
    }
}
