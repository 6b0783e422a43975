//! Names, what may be done with them, and contests.

use std::time::Instant;

use jostle_proto::{Claim, Claimant};

use crate::convert::commands::CommandError;
use crate::health::Contested;

/// What a daemon claims.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Name {
    /// Its own name.
    Node,
    /// The name of a swarm.
    Swarm(String),
}

impl Name {
    /// The swarm's name; `None` for the daemon's own name.
    pub(super) fn swarm(&self) -> Option<String> {
        match self {
            Name::Node => None,
            Name::Swarm(swarm) => Some(swarm.clone()),
        }
    }

    pub(super) fn of(claim: &Claim, node: &str) -> Option<Self> {
        match &claim.swarm {
            Some(swarm) => Some(Name::Swarm(swarm.clone())),
            None => (claim.claimant.node == node).then_some(Name::Node),
        }
    }
}

/// Two daemons that claim one name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Contest {
    /// The swarm; `None` for the daemon's own name.
    pub swarm: Option<String>,
    /// Both daemons, this one first.
    pub claimants: [Claimant; 2],
    /// Whether the other daemon serves the name; otherwise both reject every request.
    pub waits: bool,
}

impl Contest {
    /// Converts it to the type of the health report.
    pub fn for_health(&self) -> Contested {
        Contested {
            swarm: self.swarm.clone(),
            node: self.claimants[1].node.clone(),
            instance: self.claimants[1].instance.clone(),
            waits: self.waits,
        }
    }
}

impl From<Contest> for CommandError {
    fn from(contest: Contest) -> Self {
        CommandError::Contested {
            swarm: contest.swarm,
            claimants: contest.claimants,
        }
    }
}

/// How to handle a query.
#[derive(Debug, PartialEq, Eq)]
pub enum Gate {
    /// It is executed.
    Open,
    /// It is the first command since this daemon began to serve the name: call
    /// [`change`](super::Claims::change), then execute it.
    First,
    /// It is held until this instant.
    Hold(Instant),
    /// It gets no reply: another daemon replies.
    Drop,
    /// It is rejected with `busy`: either it arrived while the daemon was suspended, so that its
    /// client may have retried it on another daemon, or the name is about to be served.
    Busy,
    /// It is rejected.
    Reject(Box<Contest>),
}

/// Whether a name may be given to a new swarm.
#[derive(Debug, PartialEq, Eq)]
pub enum Reserved {
    /// It may.
    Now,
    /// Unknown until this instant: call [`reserve`](super::Claims::reserve) again then.
    At(Instant),
    /// No: the daemon of this name claims it.
    ClaimedBy(String),
}

/// A change to whether this daemon serves a name.
#[derive(Debug, PartialEq, Eq)]
pub enum Action {
    /// Its keys open.
    Open(Name),
    /// Its keys close at once: another daemon serves it.
    Close(Name),
    /// Its keys stay and reject everything; nothing is published.
    Reject(Name),
    /// It is served again.
    Resume(Name),
}
