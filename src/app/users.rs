//! The users and their roles: read at the start, and again while the daemon runs.

use std::sync::{Arc, OnceLock};
use std::time::Duration;

use tokio::time::MissedTickBehavior;
use tracing::{error, info, warn};

use crate::audit::{self, AuditCommand, AuditLog};
use crate::auth::folder::Folder;
use crate::auth::live::{Changes, LiveRights};
use crate::auth::{AuthError, EXPIRY_WARNING_DAYS, Rights};
use crate::config::Config;

const EXPIRY_CHECK_INTERVAL: Duration = Duration::from_secs(24 * 60 * 60);

/// How often the users are read again: a removed user's token is rejected within 5 s.
const RELOAD_INTERVAL: Duration = Duration::from_secs(1);

/// Reads the users of `auth_dir`, and starts the tasks that reload and check them.
/// `audit` is set once the audit log is open.
pub fn open(
    config: &Config,
    audit: &Arc<OnceLock<AuditLog>>,
) -> Result<Arc<LiveRights>, AuthError> {
    let rights = match &config.auth_dir {
        Some(path) => Rights::read(Folder::new(path.clone()))?,
        None => Rights::Open,
    };
    let has_users = rights.users().is_some();
    let rights = Arc::new(LiveRights::new(rights));
    if has_users {
        tokio::spawn(warn_of_expiry(rights.clone()));
        tokio::spawn(reload(rights.clone(), audit.clone()));
    }
    Ok(rights)
}

/// Logs certificates that expire soon and passwords without a user, at once and then every day.
async fn warn_of_expiry(rights: Arc<LiveRights>) {
    let mut ticks = tokio::time::interval(EXPIRY_CHECK_INTERVAL);
    loop {
        ticks.tick().await;
        match rights.current().expiry_warnings(EXPIRY_WARNING_DAYS) {
            Ok(notices) => notices.iter().for_each(|line| warn!("{line}")),
            Err(error) => warn!(%error, "failed to check the certificates and passwords"),
        }
    }
}

/// Reads the users again every second, so that `jostled auth add` and `remove` take effect without a
/// restart.
async fn reload(rights: Arc<LiveRights>, audit: Arc<OnceLock<AuditLog>>) {
    let mut ticks = tokio::time::interval(RELOAD_INTERVAL);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut last_problem = None;
    loop {
        ticks.tick().await;
        let reloaded = tokio::task::spawn_blocking({
            let rights = rights.clone();
            move || rights.reload()
        });
        match reloaded.await {
            Ok(Ok(changes)) => {
                if changes != Changes::default() {
                    let Changes { added, removed } = changes;
                    if let Some(log) = audit.get() {
                        record(log, "remove", &removed);
                        record(log, "add", &added);
                    }
                    let (added, removed) = (added.join(" "), removed.join(" "));
                    info!(added, removed, "users changed");
                }
            }
            Ok(Err(error)) => {
                let problem = Some(error.to_string());
                if problem != last_problem {
                    warn!(%error, "failed to reload the users; roles stay as they were");
                }
            }
            Err(error) => error!(%error, "a defect: reloading the users panicked"),
        }
        last_problem = rights.problem();
    }
}

/// Adds changes by `jostled auth` to the audit log. Whoever may change the file is no user.
fn record(log: &AuditLog, action: &str, names: &[String]) {
    for name in names {
        let command = AuditCommand {
            verb: "auth".to_owned(),
            action: Some(action.to_owned()),
            name: Some(name.clone()),
            ..AuditCommand::default()
        };
        log.begin(command).finish(audit::OK);
    }
}
