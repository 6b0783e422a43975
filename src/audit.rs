//! The audit log: who sent which commands, with what outcome.
//!
//! A line counts the equal commands of a client within a minute. It is queued for the store before the
//! first of them is executed, so that it is durable no later than what the command changes, and again
//! with the outcome. A line of several commands is written again once a second.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use tracing::info;

use crate::store::{AuditLine, Store, StoreError, Write};

/// How long equal commands are counted on one line.
const LINE: Duration = Duration::from_secs(60);

/// How often lines of several commands are written.
const WRITE_INTERVAL: Duration = Duration::from_secs(1);

/// Lines to which commands may be added; beyond it, new ones are begun. While the store is not writable,
/// at most twice as many wait for it.
const MAX_OPEN: usize = 4096;

/// The outcome of a command that succeeded.
pub const OK: &str = "ok";

/// The outcome of a command that ended because its client was gone.
pub const ABANDONED: &str = "abandoned";

/// What a line counts.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct AuditCommand {
    /// The user of the token; `None` if there is none.
    pub user: Option<String>,
    /// What the client calls itself.
    pub client: Option<String>,
    /// The verb.
    pub verb: String,
    /// What the verb does, for verbs that do several things.
    pub action: Option<String>,
    /// What it concerns.
    pub name: Option<String>,
}

/// The part of a line that the store does not read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditBody {
    /// What the verb does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// The number of commands.
    pub count: u64,
    /// How many ended how.
    pub outcomes: BTreeMap<String, u64>,
}

/// Why the audit log cannot be opened.
#[derive(Debug, Error)]
pub enum AuditError {
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Its thread cannot be started.
    #[error(transparent)]
    Thread(#[from] std::io::Error),
}

/// The audit log of a daemon. Clones are the same log.
#[derive(Clone)]
pub struct AuditLog(Arc<Inner>);

struct Inner {
    store: Store,
    state: Mutex<State>,
}

struct State {
    /// The number of the newest line in the store.
    number: u64,
    /// How many lines have been begun.
    begun: u64,
    /// Those to which commands are added.
    open: HashMap<AuditCommand, u64>,
    /// In the order in which they were begun, those that are open, have a ticket, or are to be written.
    lines: BTreeMap<u64, Line>,
}

struct Line {
    /// In the store; `None` before it is queued.
    number: Option<u64>,
    command: AuditCommand,
    begun: Instant,
    first_ms: u64,
    last_ms: u64,
    body: AuditBody,
    /// Tickets of its commands.
    tickets: u64,
    is_open: bool,
    is_to_be_written: bool,
    /// Whether it is to be written once the store is writable.
    is_behind: bool,
}

/// A command in the audit log whose outcome may change.
pub struct AuditTicket {
    log: AuditLog,
    line: u64,
    outcome: Option<String>,
}

impl AuditLog {
    /// The audit log in a store.
    ///
    /// # Errors
    ///
    /// [`AuditError`].
    pub fn open(store: Store) -> Result<Self, AuditError> {
        let state = Mutex::new(State {
            number: store.newest_audit_line()?,
            begun: 0,
            open: HashMap::new(),
            lines: BTreeMap::new(),
        });
        let inner = Arc::new(Inner { store, state });
        let log = Arc::downgrade(&inner);
        thread::Builder::new().name("audit".into()).spawn(move || {
            while let Some(inner) = log.upgrade() {
                AuditLog(inner).write_changes();
                thread::sleep(WRITE_INTERVAL);
            }
        })?;
        Ok(AuditLog(inner))
    }

    /// Adds a command that is about to be executed.
    #[must_use]
    pub fn begin(&self, command: AuditCommand) -> AuditTicket {
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let now = now.map_or(0, |it| u64::try_from(it.as_millis()).unwrap_or(u64::MAX));
        let mut state = self.0.state.lock();
        let State {
            number,
            begun,
            open,
            lines,
        } = &mut *state;
        let found = open.get(&command).copied();
        let line = match found.and_then(|it| Some((it, lines.get_mut(&it)?))) {
            Some((line, known)) => {
                known.last_ms = known.last_ms.max(now);
                known.body.count += 1;
                known.tickets += 1;
                known.is_to_be_written = true;
                if known.number.is_none() && self.0.store.is_writable() {
                    self.write(known, number);
                }
                line
            }
            None => {
                if open.len() >= MAX_OPEN {
                    open.clear();
                    lines.values_mut().for_each(|line| line.is_open = false);
                    lines.retain(|_, line| line.is_needed());
                }
                *begun += 1;
                let mut line = Line {
                    number: None,
                    begun: Instant::now(),
                    first_ms: now,
                    last_ms: now,
                    body: AuditBody {
                        action: command.action.clone(),
                        count: 1,
                        outcomes: BTreeMap::new(),
                    },
                    tickets: 1,
                    is_open: true,
                    is_to_be_written: false,
                    is_behind: false,
                    command: command.clone(),
                };
                self.write(&mut line, number);
                open.insert(command, *begun);
                lines.insert(*begun, line);
                *begun
            }
        };
        AuditTicket {
            log: self.clone(),
            line,
            outcome: None,
        }
    }

    /// Writes what has changed, and ends lines that are older than a minute.
    pub fn write_changes(&self) {
        let is_writable = self.0.store.is_writable();
        let mut state = self.0.state.lock();
        let State {
            number,
            open,
            lines,
            ..
        } = &mut *state;
        for line in lines.values_mut() {
            if line.is_to_be_written || line.is_behind && is_writable {
                self.write(line, number);
            }
            if line.is_open && line.begun.elapsed() > LINE {
                line.is_open = false;
                open.remove(&line.command);
            }
        }
        lines.retain(|_, line| line.is_needed());
        let mut excess = lines.len().saturating_sub(2 * MAX_OPEN);
        lines.retain(|_, line| {
            let is_kept = excess == 0 || line.is_open || line.tickets > 0;
            excess -= usize::from(!is_kept);
            is_kept
        });
    }

    fn finish(&self, line: u64, before: Option<&str>, outcome: &str) {
        let mut state = self.0.state.lock();
        let State { number, lines, .. } = &mut *state;
        let Some(line) = lines.get_mut(&line) else {
            return;
        };
        if let Some(before) = before
            && let Some(count) = line.body.outcomes.get_mut(before)
        {
            *count -= 1;
        }
        line.body.outcomes.retain(|_, count| *count > 0);
        *line.body.outcomes.entry(outcome.to_owned()).or_default() += 1;
        match line.body.count {
            1 => self.write(line, number),
            _ => line.is_to_be_written = true,
        }
    }

    /// Queues a line for the store, or logs it if that cannot write. The state is locked, so that lines
    /// are queued in the order of their numbers.
    fn write(&self, line: &mut Line, newest: &mut u64) {
        line.is_to_be_written = false;
        line.is_behind = !self.0.store.is_writable();
        let AuditCommand {
            user,
            client,
            verb,
            name,
            ..
        } = &line.command;
        let mut body = Vec::new();
        // Writing to memory does not fail.
        let _ = serde_json::to_writer(&mut body, &line.body);
        if line.is_behind {
            let action = &line.command.action;
            let body = String::from_utf8_lossy(&body);
            let problem = "a command that the audit log lacks until the store is writable";
            info!(user, client, verb, action, name, %body, problem);
            return;
        }
        let number = *line.number.get_or_insert_with(|| {
            *newest += 1;
            *newest
        });
        let line = AuditLine {
            number,
            user: user.clone().unwrap_or_default(),
            client: client.clone(),
            verb: verb.clone(),
            name: name.clone(),
            first_ms: line.first_ms,
            last_ms: line.last_ms,
            body,
        };
        self.0.store.submit(vec![Write::Audit(line)], None);
    }
}

impl Line {
    fn is_needed(&self) -> bool {
        self.is_open || self.tickets > 0 || self.is_to_be_written || self.is_behind
    }
}

impl AuditTicket {
    /// Sets the outcome of the command: [`OK`], [`ABANDONED`], or the code of an error. A later one
    /// replaces it.
    pub fn finish(&mut self, outcome: &str) {
        if self.outcome.as_deref() != Some(outcome) {
            self.log.finish(self.line, self.outcome.as_deref(), outcome);
            self.outcome = Some(outcome.to_owned());
        }
    }
}

impl Drop for AuditTicket {
    fn drop(&mut self) {
        let mut state = self.log.0.state.lock();
        if let Some(line) = state.lines.get_mut(&self.line) {
            line.tickets -= 1;
        }
    }
}
