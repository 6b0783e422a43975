//! What clients wait for, what holds their waits, and what the status of a swarm has of waits and conditions.

use std::sync::Arc;
use std::time::Instant;

use jostle_conditions::Condition;
use parking_lot::Mutex;

/// What shows that the client of a wait still exists: its liveliness token, or its HTTP connection.
#[derive(Debug)]
pub struct Holder {
    /// The key of the token; empty for a connection.
    pub(super) key: String,
    presence: Mutex<Presence>,
}

#[derive(Clone, Copy, Debug)]
struct Presence {
    /// Since when it is not found; `None` while it exists.
    gone_since: Option<Instant>,
    /// Whether it has existed since the wait began.
    has_existed: bool,
}

impl Holder {
    /// A token that has not been found yet.
    pub fn token(key: String) -> Self {
        Holder {
            key,
            presence: Mutex::new(Presence {
                gone_since: Some(Instant::now()),
                has_existed: false,
            }),
        }
    }

    /// A connection.
    pub fn connection(is_open: bool) -> Self {
        Holder {
            key: String::new(),
            presence: Mutex::new(Presence {
                gone_since: (!is_open).then(Instant::now),
                has_existed: true,
            }),
        }
    }

    /// Notes whether it exists.
    pub fn set(&self, exists: bool) {
        let mut presence = self.presence.lock();
        match exists {
            true => {
                presence.gone_since = None;
                presence.has_existed = true;
            }
            false => {
                presence.gone_since.get_or_insert_with(Instant::now);
            }
        }
    }

    /// Notes that it was undeclared, perhaps by one of several sessions, before it was looked for.
    pub fn note_undeclared(&self) {
        self.presence.lock().has_existed = true;
    }

    /// Notes that a wait begins: another one of the same id may have ended with the token, which the client
    /// may declare again just now. A connection that is closed stays so.
    pub(super) fn begin(&self) {
        let mut presence = self.presence.lock();
        if !self.key.is_empty() && presence.gone_since.is_some() {
            presence.gone_since = Some(Instant::now());
            presence.has_existed = false;
        }
    }

    /// Since when it is gone; `None` while it exists.
    pub fn gone_since(&self) -> Option<Instant> {
        self.presence.lock().gone_since
    }

    /// Whether it has existed, and is gone.
    pub(super) fn is_lost(&self) -> bool {
        let presence = self.presence.lock();
        presence.has_existed && presence.gone_since.is_some()
    }
}

/// What a client waits for.
#[derive(Clone, Debug)]
pub struct Awaited {
    /// The id that the client gave the wait.
    pub id: Arc<str>,
    /// The user; `None` without users.
    pub user: Option<Arc<str>>,
    /// Whether the user is an operator; without users everyone is.
    pub is_operator: bool,
    /// The condition.
    pub condition: Condition,
    /// What shows that the client exists.
    pub holder: Arc<Holder>,
}

impl Awaited {
    /// Whether it is the same wait: of the same user and id.
    pub fn is_same(&self, other: &Awaited) -> bool {
        self.id == other.id && self.user == other.user
    }
}

/// A wait, for the status of its swarm.
#[derive(Clone, Debug)]
pub struct WaitSummary {
    /// The condition.
    pub condition: String,
    /// The user; `None` without users.
    pub user: Option<Arc<str>>,
}

/// A condition that waits, for the status of its swarm.
#[derive(Debug)]
pub struct WatchSummary {
    /// Differs between conditions that differ, and is the same in forks and after a restart.
    pub id: String,
    /// The text of the condition.
    pub condition: String,
    /// What is executed when it holds.
    pub action: WatchAction,
    /// The name of its event.
    pub event: Option<Arc<str>>,
    /// The client that sent it.
    pub client: Option<String>,
}

/// A condition in the status of its swarm.
#[derive(Clone, Debug)]
pub struct WatchStatus {
    /// What does not change.
    pub summary: Arc<WatchSummary>,
    /// Whether it is evaluated: of a group that is too large, or beside others that cost too much, it is not.
    pub is_evaluated: bool,
}

/// The kind of an [`Action`](crate::swarm::watch::Action).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WatchAction {
    /// Pause, with or without an end of the protocol.
    Pause,
    /// Changes.
    Commands,
    /// An event.
    Event,
}
