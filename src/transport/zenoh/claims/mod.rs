//! Claims: of two daemons that can reach each other, at most one serves a name.
//!
//! A daemon holds a liveliness token for each of its names, its own and those of its swarms, and
//! reads the tokens of all others. zenoh routers forward them, so each daemon receives the claims of
//! the other shortly after a connection, and `judge` gives both the same verdict. Until then the
//! daemon waits: it holds commands that arrive within `SETTLING` after a router has connected,
//! because the other daemon may execute them.
//!
//! Without a router, clients reach this daemon only, and no command is held.

mod known;
mod types;
mod verdict;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use jostle_proto::{Claim, Claimant, Standing};
use parking_lot::Mutex;
use tracing::{debug, warn};
use zenoh::config::WhatAmI;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

use self::known::{Known, Own, SETTLING};
use self::verdict::{Verdict, judge};
use crate::suspension;

pub use self::types::{Action, Contest, Gate, Name, Reserved};

/// How long a name is reserved for a swarm that is being built, on a daemon that is connected to
/// routers.
const MAX_RESERVATION: Duration = Duration::from_secs(60);

/// The claims of this daemon, and those that it knows of others.
pub struct Claims {
    session: Session,
    prefix: String,
    claimant: Claimant,
    /// Every change is an assignment, so a panic leaves it whole.
    known: Mutex<Known>,
    /// Only the dispatcher thread declares tokens. It holds no other lock while it does, because
    /// zenoh may run a callback that locks `known`.
    tokens: Mutex<BTreeMap<Name, LivelinessToken>>,
}

/// The subscribers that keep [`Claims`] up to date.
pub type ClaimSubscribers = [Subscriber<()>; 2];

impl Claims {
    /// Subscribes to the claims of other daemons. `wake` is called after each change.
    pub fn watch(
        session: &Session,
        prefix: &str,
        node: &str,
        wake: impl Fn() + Clone + Send + Sync + 'static,
    ) -> zenoh::Result<(Arc<Self>, ClaimSubscribers)> {
        let unix = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let started = unix.unwrap_or_default().as_millis();
        let claims = Arc::new(Claims {
            session: session.clone(),
            prefix: prefix.to_owned(),
            claimant: Claimant {
                instance: format!("{started:012x}-{}", session.zid()),
                node: node.to_owned(),
            },
            known: Mutex::new(Known::new(Instant::now())),
            tokens: Mutex::default(),
        });
        let (watching, woken) = (claims.clone(), wake.clone());
        // zenoh calls this before it reads anything from the router.
        session
            .info()
            .transport_events_listener()
            .history(true)
            .callback(move |event| {
                let transport = event.transport();
                if transport.whatami() == WhatAmI::Router {
                    let router = transport.zid().to_string();
                    watching.router(router, event.kind() == SampleKind::Put);
                    woken();
                }
            })
            .background()
            .wait()?;
        let subscribe = |key: String| {
            let (claims, wake) = (claims.clone(), wake.clone());
            let tokens = session.liveliness().declare_subscriber(key);
            tokens
                .history(true)
                .callback(move |sample| {
                    let stands = sample.kind() == SampleKind::Put;
                    if claims.other(sample.key_expr().as_str(), stands) {
                        wake();
                    }
                })
                .wait()
        };
        let watching = [
            subscribe(format!("{prefix}/*/claim/**"))?,
            subscribe(format!("{prefix}/@node/*/claim/**"))?,
        ];
        Ok((claims, watching))
    }

    /// Claims a name of this daemon. [`Claims::reconcile`] returns [`Action::Open`] when the
    /// name may be served. `has_changed` is true if commands were executed on it, and for a swarm
    /// that was just created.
    pub fn begin(&self, name: &Name, has_changed: bool) {
        let now = Instant::now();
        let standing = match has_changed {
            true => Standing::Changed,
            false => Standing::Waiting,
        };
        let mut known = self.known.lock();
        known.changed.insert(name.clone());
        let serve_after = match known.routers.is_empty() || has_changed {
            true => now,
            false => now + SETTLING,
        };
        let own = Own::new(standing, serve_after, None);
        known.own.insert(name.clone(), own);
        drop(known);
        // Without a router no daemon can contest the name: `reconcile` declares `serving` first.
        if has_changed || serve_after > now {
            self.declare(name, standing);
        }
    }

    /// Whether the keys of a name are open, or are to be opened by an [`Action`] that was returned.
    pub fn is_open(&self, name: &Name) -> bool {
        let known = self.known.lock();
        known.own.get(name).is_some_and(|own| own.is_open)
    }

    /// Withdraws the claim to a name.
    pub fn end(&self, name: &Name) {
        self.known.lock().own.remove(name);
        self.tokens.lock().remove(name);
    }

    /// Withdraws the claim to a name that was reserved for a swarm whose creation failed.
    pub fn release(&self, swarm: &str) {
        let name = Name::Swarm(swarm.to_owned());
        let is_reserved = {
            let known = self.known.lock();
            let own = known.own.get(&name);
            own.is_some_and(|own| own.reserved.is_some())
        };
        if is_reserved {
            self.end(&name);
        }
    }

    /// Reserves a name for a swarm that is to be created, forked, restored or played back.
    pub fn reserve(&self, swarm: &str) -> Reserved {
        let name = Name::Swarm(swarm.to_owned());
        let now = Instant::now();
        let mut known = self.known.lock();
        if known.routers.is_empty() {
            return Reserved::Now;
        }
        let others = known.others.get(&name);
        match known.own.get(&name) {
            Some(own) if own.reserved.is_none() => return Reserved::Now,
            Some(own) if now < own.serve_after => return Reserved::At(own.serve_after),
            Some(own) => {
                let verdict = others.map(|it| judge(own.standing, &self.claimant, it));
                let (Some(Verdict::Wait(other)) | Some(Verdict::Reject(other))) = verdict else {
                    return Reserved::Now;
                };
                drop(known);
                self.end(&name);
                return Reserved::ClaimedBy(other.node);
            }
            None => {
                if let Some(other) = others.and_then(|it| it.keys().next()) {
                    return Reserved::ClaimedBy(other.node.clone());
                }
            }
        }
        let serve_after = now + SETTLING;
        let own = Own::new(Standing::Waiting, serve_after, Some(now));
        known.own.insert(name.clone(), own);
        drop(known);
        self.declare(&name, Standing::Waiting);
        Reserved::At(serve_after)
    }

    /// How to handle a query about `name`; only commands are held.
    pub fn gate(&self, name: &Name, is_command: bool) -> Gate {
        let now = Instant::now();
        let mut known = self.known.lock();
        known.note_suspension(suspension::resumed());
        let Some((verdict, own)) = known.verdict(name, &self.claimant) else {
            // A swarm that was just deleted here, of a name that another daemon serves now.
            let is_of_another = !known.routers.is_empty() && known.others.contains_key(name);
            return match is_of_another {
                true => Gate::Drop,
                false => Gate::Open,
            };
        };
        if is_command && now < known.stale_until {
            return Gate::Busy;
        }
        match verdict {
            Verdict::Reject(other) => Gate::Reject(Box::new(self.contest(name, &other, false))),
            Verdict::Serve if own.is_rejecting => Gate::Busy,
            Verdict::Serve if own.is_open => match is_command {
                true if now < known.held_until => Gate::Hold(known.held_until),
                true if own.standing == Standing::Serving => Gate::First,
                _ => Gate::Open,
            },
            Verdict::Serve | Verdict::Wait(_) => Gate::Drop,
        }
    }

    /// Raises the claims to a name and to the daemon's own name to `changed`, since a command is
    /// about to be executed.
    pub fn change(&self, name: &Name) {
        for name in [&Name::Node, name] {
            let mut known = self.known.lock();
            let own = known.own.get_mut(name);
            if let Some(own) = own.filter(|own| own.standing == Standing::Serving) {
                own.standing = Standing::Changed;
                drop(known);
                self.declare(name, Standing::Changed);
            }
        }
    }

    /// Whether the daemon serves nothing, because another daemon of the same name serves.
    pub fn waits(&self) -> bool {
        let known = self.known.lock();
        let verdict = known.verdict(&Name::Node, &self.claimant);
        matches!(verdict, Some((Verdict::Wait(_), _)))
    }

    /// Whether a router is connected, through which other daemons may be reachable.
    pub fn is_connected(&self) -> bool {
        !self.known.lock().routers.is_empty()
    }

    /// Whether the swarm accepts messages that get no reply, such as set-points.
    pub fn serves(&self, swarm: &str) -> bool {
        matches!(
            self.gate(&Name::Swarm(swarm.to_owned()), true),
            Gate::Open | Gate::First
        )
    }

    /// When [`Claims::reconcile`] is due, unless a claim changes before.
    pub fn due(&self) -> Option<Instant> {
        let known = self.known.lock();
        match known.changed.is_empty() {
            true => known.due,
            false => Some(Instant::now()),
        }
    }

    /// Judges the names whose claims changed, and returns what to change.
    pub fn reconcile(&self) -> Vec<Action> {
        let now = Instant::now();
        let (mut actions, mut declared, mut ended) = (Vec::new(), Vec::new(), Vec::new());
        {
            let mut known = self.known.lock();
            known.note_suspension(suspension::resumed());
            let changed = std::mem::take(&mut known.changed);
            // The verdict on the daemon's own name applies to all of its swarms.
            let names: Vec<Name> = match known.due.is_some_and(|due| now >= due) {
                false if !changed.contains(&Name::Node) => changed.into_iter().collect(),
                _ => {
                    known.due = None;
                    known.own.keys().cloned().collect()
                }
            };
            for name in names {
                let Some((verdict, _)) = known.verdict(&name, &self.claimant) else {
                    continue;
                };
                let Some(own) = known.own.get_mut(&name) else {
                    continue;
                };
                let due = match own.reserved.map(|since| since + MAX_RESERVATION) {
                    Some(due) if now >= due => {
                        ended.push(name);
                        continue;
                    }
                    Some(due) => Some(due),
                    None => {
                        let before = own.standing;
                        actions.extend(own.apply(&name, &verdict, now));
                        if own.standing != before {
                            declared.push((name, own.standing));
                        }
                        own.must_judge_again().then_some(own.serve_after)
                    }
                };
                known.due = known.due.into_iter().chain(due).min();
            }
        }
        for (name, standing) in declared {
            self.declare(&name, standing);
        }
        for name in ended {
            self.end(&name);
        }
        actions
    }

    /// Every name that another daemon claims, too.
    pub fn contests(&self) -> Vec<Contest> {
        let known = self.known.lock();
        // While this daemon waits for another one of its own name, it serves nothing: report that.
        if let Some((Verdict::Wait(other), _)) = known.verdict(&Name::Node, &self.claimant) {
            return vec![self.contest(&Name::Node, &other, true)];
        }
        let names = known.own.iter().filter(|(_, own)| own.reserved.is_none());
        names
            .filter_map(|(name, _)| match known.verdict(name, &self.claimant)?.0 {
                Verdict::Serve => None,
                Verdict::Wait(other) => Some(self.contest(name, &other, true)),
                Verdict::Reject(other) => Some(self.contest(name, &other, false)),
            })
            .collect()
    }

    fn contest(&self, name: &Name, other: &Claimant, waits: bool) -> Contest {
        Contest {
            swarm: name.swarm(),
            claimants: [self.claimant.clone(), other.clone()],
            waits,
        }
    }

    /// Declares the claim to a name with its new standing, then undeclares the previous one.
    fn declare(&self, name: &Name, standing: Standing) {
        let claim = Claim {
            swarm: name.swarm(),
            claimant: self.claimant.clone(),
            standing,
        };
        let token = self.session.liveliness();
        match token.declare_token(claim.key(&self.prefix)).wait() {
            Ok(token) => drop(self.tokens.lock().insert(name.clone(), token)),
            Err(error) => warn!(name = name.swarm(), %error, "failed to claim a name"),
        }
    }

    /// Records that a router connected or disconnected.
    fn router(&self, router: String, is_connected: bool) {
        let now = Instant::now();
        let mut known = self.known.lock();
        known.changed.insert(Name::Node);
        if !is_connected {
            return known.remove_router(&router, suspension::resumed());
        }
        if known.routers.is_empty() {
            known.watch = Some(suspension::watch());
        }
        known.note_suspension(suspension::resumed());
        known.routers.insert(router);
        known.hold(now);
    }

    /// Records that another daemon declared or undeclared a claim. Returns false if the key is not
    /// a claim of another daemon to a name that concerns this one.
    fn other(&self, key: &str, stands: bool) -> bool {
        let Some(claim) = Claim::read(&self.prefix, key) else {
            debug!(key, "ignored a key that is not a claim");
            return false;
        };
        if claim.claimant == self.claimant {
            return false;
        }
        let Some(name) = Name::of(&claim, &self.claimant.node) else {
            return false;
        };
        let mut known = self.known.lock();
        known.changed.insert(name.clone());
        let others = known.others.entry(name.clone()).or_default();
        if stands {
            let standings = others.entry(claim.claimant).or_default();
            standings.insert(claim.standing);
        } else if let Some(standings) = others.get_mut(&claim.claimant) {
            standings.remove(&claim.standing);
            if standings.is_empty() {
                others.remove(&claim.claimant);
            }
            if others.is_empty() {
                known.others.remove(&name);
            }
        }
        true
    }
}
