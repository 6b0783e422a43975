//! Why the daemon is unhealthy, and its warnings.

use std::time::Duration;

use thiserror::Error;

use crate::lanes;
use crate::swarm::frame::Summary;
use crate::swarm::recovery_progress::still_left;

/// Why the daemon is unhealthy.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Reason {
    /// The thread of a swarm executes one step or command for too long.
    #[error("swarm {swarm} has been in one step or command for {secs:.0} s")]
    SwarmStuck {
        /// The swarm.
        swarm: String,
        /// For how long.
        secs: f64,
    },
    /// Another thread executes one task for too long.
    #[error("thread {thread} has been executing one task for {secs:.0} s")]
    ThreadStuck {
        /// The thread.
        thread: &'static str,
        /// For how long.
        secs: f64,
    },
    /// The swarms of the previous run are being recovered.
    #[error("recovering the swarms{}: they can be reached once that is done", still_left(*.swarms_left))]
    Recovering {
        /// How many are not recovered yet.
        swarms_left: usize,
    },
    /// The disk is full.
    #[error("the disk is full: free some space, and the journal goes on by itself")]
    StoreFull,
    /// Writing to the journal fails for another reason.
    #[error("the journal cannot be written; see the log")]
    StoreFailing,
    /// The queue of writes exceeds its limit.
    #[error("the queue of the journal exceeds its limit")]
    StoreOverrun,
    /// A listener of the daemon does not respond.
    #[error("{endpoint} does not answer: {problem}")]
    Unresponsive {
        /// The endpoint.
        endpoint: String,
        /// The error.
        problem: String,
    },
    /// zenoh is blocked.
    #[error(
        "commands and queries have been blocked for {secs:.0} s{}: this ends by itself; see \
         docs/security.md on what the subscriptions of a session can block",
        while_closing(closing)
    )]
    BusBlocked {
        /// For how long.
        secs: f64,
        /// The clients whose sessions zenoh is closing; may be empty.
        closing: String,
    },
    /// Another daemon uses the same name.
    #[error("{0}")]
    Contested(Contested),
    /// The certificate of the daemon has expired: its last day.
    #[error(
        "the daemon's certificate expired on {0}: run `jostled auth address --auth-dir FOLDER` with a \
         `--host NAME` for each of its names, then restart the daemon"
    )]
    CertificateEnded(String),
    /// `people.json` cannot be reloaded.
    #[error(
        "people.json cannot be reloaded: the rights loaded last stay in force, and `jostled auth add` \
         and `remove` have no effect; see the log"
    )]
    PeopleUnreadable,
    /// The health thread itself is blocked, for so many seconds.
    #[error("the health checks have not run for {0:.0} s")]
    WatchStuck(f64),
}

impl Reason {
    /// Its code in `/healthz`.
    pub fn code(&self) -> &'static str {
        match self {
            Reason::SwarmStuck { .. } => "swarm_stuck",
            Reason::ThreadStuck { .. } => "thread_stuck",
            Reason::Recovering { .. } => "recovering",
            Reason::StoreFull => "store_full",
            Reason::StoreFailing => "store_failing",
            Reason::StoreOverrun => "store_overrun",
            Reason::Unresponsive { .. } => "listener_deaf",
            Reason::BusBlocked { .. } => "bus_blocked",
            Reason::Contested(_) => "contested",
            Reason::CertificateEnded(_) => "certificate_ended",
            Reason::PeopleUnreadable => "people_unreadable",
            Reason::WatchStuck(_) => "watch_stuck",
        }
    }

    /// Whether a restart is the remedy: of a blocked thread it is, of a full disk it is not.
    pub fn needs_restart(&self) -> bool {
        matches!(
            self,
            Reason::SwarmStuck { .. }
                | Reason::ThreadStuck { .. }
                | Reason::Unresponsive { .. }
                | Reason::WatchStuck(_)
        )
    }
}

/// A name that another daemon uses too.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{}", contested(self))]
pub struct Contested {
    /// The swarm; `None` for the daemon's own name.
    pub swarm: Option<String>,
    /// The other daemon's name.
    pub node: String,
    /// Its instance.
    pub instance: String,
    /// Whether the other daemon serves the name and this one waits.
    pub waits: bool,
}

fn contested(it: &Contested) -> String {
    let node = &it.node;
    let what = match &it.swarm {
        Some(swarm) => format!("daemon {node} has a swarm {swarm}, too"),
        None => format!("another daemon is named {node}, too ({})", it.instance),
    };
    let outcome = match it.waits {
        true => "the other daemon serves it, and this one waits",
        false => "both created it or executed commands on it, so both reject everything",
    };
    let end = match it.swarm {
        Some(_) => "until one is stopped or deletes it",
        None => "until one is stopped",
    };
    format!("contested: {what}; {outcome}, {end}")
}

/// How many recordings, experiments or swarms a warning names.
const MAX_NAMED: usize = 5;

/// The share of its rate below which a swarm causes a warning: a busy moment does not.
const MAX_SHARE: f64 = 0.9;

/// The warning about failed recordings, by their names and reasons.
pub(super) fn recordings_failed(failed: &[(String, String)]) -> String {
    format!(
        "recordings failed: {}; `jostle record --list` lists them, \
         `jostle record --delete NAME` removes one with its files",
        named(failed)
    )
}

/// The warning about experiments that the daemon has paused, by their names and reasons.
pub(super) fn experiments_paused(paused: &[(String, String)]) -> String {
    format!(
        "experiments are paused: {}; `jostle experiment resume NAME` continues one",
        named(paused)
    )
}

/// The name of a swarm that is behind its rate, and by how much.
pub(super) fn shortfall(name: String, summary: &Summary) -> Option<(String, String)> {
    let rate = summary.rate?;
    let reached = summary.real_time_factor.filter(|_| summary.is_behind)?;
    let is_much = reached < MAX_SHARE * rate;
    is_much.then(|| (name, format!("{reached:.2} of {rate}")))
}

/// The warning about swarms that are behind their rates, by their names and what they reach.
pub(super) fn swarms_behind(behind: &[(String, String)]) -> String {
    format!(
        "swarms are behind their rates: {}; `jostle run NAME --rate RATE` sets a lower one, \
         `jostle pause NAME` pauses others",
        named(behind)
    )
}

/// The first names, each with its reason, and the number of the others.
fn named(all: &[(String, String)]) -> String {
    let first = all.iter().take(MAX_NAMED);
    let first: Vec<String> = first
        .map(|(name, reason)| format!("{name} ({reason})"))
        .collect();
    let others = match all.len().saturating_sub(MAX_NAMED) {
        0 => String::new(),
        others => format!(" and {others} more"),
    };
    format!("{}{others}", first.join(", "))
}

/// The warning about a lane whose tasks wait too long.
pub(super) fn lane_behind(lane: &lanes::Status) -> String {
    let lanes::Status {
        lane,
        queued,
        waiting,
        ..
    } = lane;
    format!(
        "requests in the lane {} wait for {:.0} s ({queued} are queued): clients send more than the \
         daemon can execute; `jostle_lane_` in /metrics shows what of each lane",
        lane.name(),
        waiting.as_secs_f64()
    )
}

/// The warning about damaged records of the journal.
pub(super) fn journal_damaged(records: u64) -> String {
    let records = match records {
        1 => "1 damaged or missing record was".to_owned(),
        records => format!("{records} damaged or missing records were"),
    };
    format!(
        "{records} read from the journal: check the disk, take a backup with `jostled backup`, then \
         `jostle verify SWARM` for each swarm"
    )
}

/// The number of the daemon's recordings by phase.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordingCounts {
    /// Being recorded.
    pub recording: u64,
    /// Ended.
    pub ended: u64,
    /// The names of failed ones, with the reasons.
    pub failed: Vec<(String, String)>,
}

fn while_closing(closing: &str) -> String {
    match closing {
        "" => String::new(),
        closing => format!(" while zenoh closes the session of {closing}"),
    }
}

/// Whether zenoh is blocked.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bus {
    /// For how long it has been blocked, if that is longer than the limit.
    pub blocked: Option<Duration>,
    /// The clients whose sessions it is closing.
    pub closing: String,
    /// The number of blocks longer than the limit.
    pub blocks: u64,
}
