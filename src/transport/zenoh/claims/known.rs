//! The claims that a daemon knows, and what follows from them.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::{Duration, Instant};

use jostle_proto::{Claimant, Standing};
use tracing::warn;

use super::types::{Action, Name};
use super::verdict::{Others, Verdict, judge};
use crate::suspension;

/// The time that claims of other daemons may take to arrive. zenoh's routers compute their routes
/// 100 ms after a connection and then forward claims, so this leaves 300 ms for the network.
pub const SETTLING: Duration = Duration::from_millis(400);

/// The most router connections within [`HOLD_WINDOW`] that hold commands. A client can connect as
/// a router, and must not delay the commands of all clients indefinitely.
const MAX_HOLDS: usize = 5;
const HOLD_WINDOW: Duration = Duration::from_secs(60);

/// All claims that this daemon knows.
pub(super) struct Known {
    /// The names that this daemon claims.
    pub(super) own: BTreeMap<Name, Own>,
    /// The claims of other daemons.
    pub(super) others: BTreeMap<Name, Others>,
    /// The connected routers.
    pub(super) routers: BTreeSet<String>,
    /// Commands are held until then.
    pub(super) held_until: Instant,
    /// The recent router connections that held commands.
    holds: VecDeque<Instant>,
    /// Held while a router is connected, so that a suspension is detected.
    pub(super) watch: Option<suspension::Watch>,
    /// The end of the last suspension that is known here.
    resumed: Option<Instant>,
    /// Commands are rejected until then, after a suspension: other daemons may have served the names of this
    /// one meanwhile.
    pub(super) stale_until: Instant,
    /// The names whose claims changed since the last `reconcile`.
    pub(super) changed: BTreeSet<Name>,
    /// When to judge all names again.
    pub(super) due: Option<Instant>,
}

/// A name that this daemon claims.
pub(super) struct Own {
    pub(super) standing: Standing,
    /// The name must not be served before this instant.
    pub(super) serve_after: Instant,
    /// When the name was reserved for a swarm that is still being built; `None` once it is built.
    pub(super) reserved: Option<Instant>,
    /// Whether its keys are open.
    pub(super) is_open: bool,
    /// Whether it rejects everything.
    pub(super) is_rejecting: bool,
    /// Whether another daemon held it when it was judged last.
    is_contested: bool,
}

impl Known {
    pub(super) fn new(now: Instant) -> Self {
        Known {
            own: BTreeMap::new(),
            others: BTreeMap::new(),
            routers: BTreeSet::new(),
            held_until: now,
            holds: VecDeque::new(),
            watch: None,
            resumed: suspension::resumed(),
            stale_until: now,
            changed: BTreeSet::new(),
            due: None,
        }
    }

    /// The verdict on a name of this daemon. A swarm waits if the daemon's own name waits.
    pub(super) fn verdict(&self, name: &Name, claimant: &Claimant) -> Option<(Verdict, &Own)> {
        let own = self.own.get(name)?;
        // Without a router, a claim can only come from a client: ignore it.
        if self.routers.is_empty() {
            return Some((Verdict::Serve, own));
        }
        if *name != Name::Node
            && let Some((Verdict::Wait(other), _)) = self.verdict(&Name::Node, claimant)
        {
            return Some((Verdict::Wait(other), own));
        }
        let none = Others::new();
        let others = self.others.get(name).unwrap_or(&none);
        Some((judge(own.standing, claimant, others), own))
    }

    /// Holds commands until the claims that a new router knows have arrived.
    pub(super) fn hold(&mut self, now: Instant) {
        self.holds
            .retain(|at| now.duration_since(*at) < HOLD_WINDOW);
        if self.holds.len() >= MAX_HOLDS {
            return warn!("too many router connections: commands are not held for this one");
        }
        self.holds.push_back(now);
        self.held_until = now + SETTLING;
    }

    /// Removes a router whose connection was closed.
    ///
    /// After a suspension its lease has expired, so it may be removed before a command that arrived
    /// from it meanwhile is handled. Without a router that command would be executed.
    pub(super) fn remove_router(&mut self, router: &str, resumed: Option<Instant>) {
        self.note_suspension(resumed);
        self.routers.remove(router);
        if self.routers.is_empty() {
            self.watch = None;
        }
    }

    /// Notes when the daemon resumed after its last suspension: others may serve its names.
    pub(super) fn note_suspension(&mut self, resumed: Option<Instant>) {
        if resumed == self.resumed {
            return;
        }
        self.resumed = resumed;
        let Some(resumed) = resumed.filter(|_| !self.routers.is_empty()) else {
            return;
        };
        warn!("rejecting commands that arrived while the daemon was suspended");
        self.stale_until = resumed + SETTLING;
        self.changed.insert(Name::Node);
    }
}

impl Own {
    pub(super) fn new(standing: Standing, serve_after: Instant, reserved: Option<Instant>) -> Self {
        Own {
            standing,
            serve_after,
            reserved,
            is_open: false,
            is_rejecting: false,
            is_contested: false,
        }
    }

    /// Applies a verdict and returns what to change.
    pub(super) fn apply(&mut self, name: &Name, verdict: &Verdict, now: Instant) -> Vec<Action> {
        let mut actions = Vec::new();
        match verdict {
            Verdict::Serve => {
                if std::mem::take(&mut self.is_contested) {
                    self.serve_after = now + SETTLING;
                }
                if now < self.serve_after {
                    return actions;
                }
                self.standing = self.standing.max(Standing::Serving);
                if !std::mem::replace(&mut self.is_open, true) {
                    actions.push(Action::Open(name.clone()));
                } else if std::mem::take(&mut self.is_rejecting) {
                    actions.push(Action::Resume(name.clone()));
                }
            }
            Verdict::Wait(other) => {
                self.contested(name, other, "another daemon serves it");
                self.standing = Standing::Waiting;
                self.is_rejecting = false;
                if std::mem::take(&mut self.is_open) {
                    actions.push(Action::Close(name.clone()));
                }
            }
            Verdict::Reject(other) => {
                let problem = "rejecting everything, both daemons executed commands";
                self.contested(name, other, problem);
                if !std::mem::replace(&mut self.is_open, true) {
                    actions.push(Action::Open(name.clone()));
                }
                if !std::mem::replace(&mut self.is_rejecting, true) {
                    actions.push(Action::Reject(name.clone()));
                }
            }
        }
        actions
    }

    fn contested(&mut self, name: &Name, other: &Claimant, problem: &str) {
        if !std::mem::replace(&mut self.is_contested, true) {
            let Claimant { node, instance } = other;
            warn!(name = name.swarm(), node, instance, "contested: {problem}");
        }
    }

    /// Whether the name must be judged again at `serve_after`.
    pub(super) fn must_judge_again(&self) -> bool {
        !self.is_contested && (!self.is_open || self.is_rejecting)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_suspension_is_detected_when_the_router_is_removed_first() {
        let began = Instant::now();
        let now = began + Duration::from_secs(3);
        for (resumed, is_stale) in [(Some(now), true), (None, false)] {
            let mut known = Known::new(began);
            known.routers.insert("router".to_owned());
            known.remove_router("router", resumed);
            assert!(known.routers.is_empty());
            assert_eq!(now < known.stale_until, is_stale, "{resumed:?}");
            // The command that arrived meanwhile is handled afterwards.
            known.note_suspension(resumed);
            assert_eq!(now < known.stale_until, is_stale, "{resumed:?}");
        }
    }
}
