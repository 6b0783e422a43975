//! Claims: two daemons that can reach each other never both serve one name.
//!
//! A daemon holds a liveliness token for each of its names, its own and those of its swarms, and
//! reads the tokens of all others. zenoh routers carry them, so each side learns of the other
//! shortly after a connection, and `judge` gives both the same verdict. A delay covers the time
//! until then: commands that arrive within [`SETTLING`] of a new router's connection are held,
//! because the other daemon may execute them.
//!
//! Without a router, clients reach this daemon only, and no command is held.

mod verdict;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use jostle_proto::{Claim, Claimant, Standing};
use tracing::{debug, warn};
use zenoh::config::WhatAmI;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

use crate::convert::commands::CommandError;
use crate::health::Contested;

use self::verdict::{Others, Verdict, judge};

/// The time that claims of other daemons may take to arrive. zenoh's routers compute their routes
/// 100 ms after a connection and then forward claims, so this leaves 300 ms for the network.
pub const SETTLING: Duration = Duration::from_millis(400);

/// The most router connections within [`HOLDS_WITHIN`] that hold commands. A client can connect as
/// a router, and must not delay the commands of all clients indefinitely.
const MAX_HOLDS: usize = 5;
const HOLDS_WITHIN: Duration = Duration::from_secs(60);

/// After a daemon was suspended for longer than this, it rejects the commands that arrived
/// meanwhile: other daemons notice its absence after 2.3 s to 3 s (the lease of its connections),
/// and may then serve its names.
const MAX_PAUSE: Duration = Duration::from_millis(1500);
const HEARTBEAT: Duration = Duration::from_millis(200);

/// How long a name is reserved for a swarm that is being built, on a daemon that is connected to
/// routers.
const MAX_RESERVATION: Duration = Duration::from_secs(60);

/// Something that a daemon claims.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Name {
    /// Its own name.
    Node,
    /// The name of a swarm.
    Swarm(String),
}

impl Name {
    /// The swarm's name; empty for the daemon's own name.
    fn text(&self) -> &str {
        match self {
            Name::Node => "",
            Name::Swarm(swarm) => swarm,
        }
    }

    fn of(claim: &Claim, node: &str) -> Option<Self> {
        match &claim.swarm {
            Some(swarm) => Some(Name::Swarm(swarm.clone())),
            None => (claim.claimant.node == node).then_some(Name::Node),
        }
    }
}

/// Two daemons that hold one name.
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
    /// It is the first command since this daemon began to serve the name: call [`Claims::change`],
    /// then execute it.
    First,
    /// It is held until this instant.
    Hold(Instant),
    /// It gets no reply: another daemon replies.
    Drop,
    /// It is rejected with `busy`: either it arrived while the daemon was suspended, so that its
    /// client may have retried it on another daemon, or the name is about to be served.
    Busy,
    /// It is rejected.
    Refuse(Box<Contest>),
}

/// Whether a name may be given to a new swarm.
#[derive(Debug, PartialEq, Eq)]
pub enum Reserved {
    /// It may.
    Now,
    /// Unknown until this instant: call [`Claims::reserve`] again then.
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
    Refuse(Name),
    /// It is served again.
    Resume(Name),
}

/// The claims of a daemon.
pub struct Claims {
    session: Session,
    prefix: String,
    claimant: Claimant,
    known: Mutex<Known>,
    /// Only the dispatcher thread declares tokens. It holds no other lock while it does, because
    /// zenoh may run a callback that locks `known`.
    tokens: Mutex<BTreeMap<Name, LivelinessToken>>,
}

/// What is known of all claims.
struct Known {
    own: BTreeMap<Name, Own>,
    others: BTreeMap<Name, Others>,
    /// The routers that are connected.
    routers: BTreeSet<String>,
    held_until: Instant,
    holds: VecDeque<Instant>,
    beat: Instant,
    stale_until: Instant,
    /// The names with news since the last [`Claims::reconcile`].
    news: BTreeSet<Name>,
    /// When to judge all names again.
    due: Option<Instant>,
}

/// A name that this daemon claims.
struct Own {
    standing: Standing,
    /// The name must not be served before this instant.
    settled: Instant,
    /// When the name was reserved for a swarm that is still being built; `None` once it is built.
    reserved: Option<Instant>,
    /// Whether its keys are open.
    is_open: bool,
    /// Whether it rejects everything.
    is_refusing: bool,
    /// Whether another daemon held it when it was judged last.
    is_contested: bool,
}

/// The subscriptions that keep [`Claims`] up to date.
pub type Watching = [Subscriber<()>; 2];

impl Claims {
    /// Begins to read the claims of others. `wake` is called when something changed.
    ///
    /// # Errors
    ///
    /// When zenoh refuses the keys.
    pub fn watch(
        session: &Session,
        prefix: &str,
        node: &str,
        wake: impl Fn() + Clone + Send + Sync + 'static,
    ) -> zenoh::Result<(Arc<Self>, Watching)> {
        let unix = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let started = unix.unwrap_or_default().as_millis();
        let now = Instant::now();
        let claims = Arc::new(Claims {
            session: session.clone(),
            prefix: prefix.to_owned(),
            claimant: Claimant {
                instance: format!("{started:012x}-{}", session.zid()),
                node: node.to_owned(),
            },
            known: Mutex::new(Known {
                own: BTreeMap::new(),
                others: BTreeMap::new(),
                routers: BTreeSet::new(),
                held_until: now,
                holds: VecDeque::new(),
                beat: now,
                stale_until: now,
                news: BTreeSet::new(),
                due: None,
            }),
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

    /// Claims a name that this daemon has. [`Claims::reconcile`] returns [`Action::Open`] when the
    /// name may be served. `has_changed` is true if commands were executed on it, and for a swarm
    /// that was just created.
    pub fn begin(&self, name: &Name, has_changed: bool) {
        let now = Instant::now();
        let standing = match has_changed {
            true => Standing::Changed,
            false => Standing::Waiting,
        };
        let settled = {
            let mut known = self.known();
            known.news.insert(name.clone());
            let settled = match known.routers.is_empty() || has_changed {
                true => now,
                false => now + SETTLING,
            };
            let own = Own {
                standing,
                settled,
                reserved: None,
                is_open: false,
                is_refusing: false,
                is_contested: false,
            };
            known.own.insert(name.clone(), own);
            settled
        };
        // Without a router no daemon can contest the name: `reconcile` declares `serving` first.
        if has_changed || settled > now {
            self.declare(name, standing);
        }
    }

    /// Withdraws the claim to a name.
    pub fn end(&self, name: &Name) {
        self.known().own.remove(name);
        self.tokens().remove(name);
    }

    /// Withdraws the claim to a name that was reserved for a swarm whose creation failed.
    pub fn release(&self, swarm: &str) {
        let name = Name::Swarm(swarm.to_owned());
        let is_reserved = {
            let known = self.known();
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
        let mut known = self.known();
        if known.routers.is_empty() {
            return Reserved::Now;
        }
        let others = known.others.get(&name);
        match known.own.get(&name) {
            Some(own) if own.reserved.is_none() => return Reserved::Now,
            Some(own) if now < own.settled => return Reserved::At(own.settled),
            Some(own) => {
                let verdict = others.map(|it| judge(own.standing, &self.claimant, it));
                let (Some(Verdict::Wait(other)) | Some(Verdict::Refuse(other))) = verdict else {
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
        let settled = now + SETTLING;
        let own = Own {
            standing: Standing::Waiting,
            settled,
            reserved: Some(now),
            is_open: false,
            is_refusing: false,
            is_contested: false,
        };
        known.own.insert(name.clone(), own);
        drop(known);
        self.declare(&name, Standing::Waiting);
        Reserved::At(settled)
    }

    /// How to handle a query about `name`; only commands are held.
    pub fn gate(&self, name: &Name, is_command: bool) -> Gate {
        let now = Instant::now();
        let mut known = self.known();
        known.notice_pause(now);
        if !known.own.contains_key(name) {
            // A swarm that was just deleted here, of a name that another daemon serves now.
            let is_of_another = !known.routers.is_empty() && known.others.contains_key(name);
            return if is_of_another {
                Gate::Drop
            } else {
                Gate::Open
            };
        }
        if is_command && now < known.stale_until {
            return Gate::Busy;
        }
        let (verdict, own) = match known.verdict(name, &self.claimant) {
            Some(judged) => judged,
            None => return Gate::Open,
        };
        match verdict {
            Verdict::Refuse(other) => Gate::Refuse(Box::new(self.contest(name, &other, false))),
            Verdict::Serve if own.is_refusing => Gate::Busy,
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
            let has_changed = {
                let mut known = self.known();
                let own = known.own.get_mut(name);
                own.is_some_and(|own| {
                    let is_served = own.standing == Standing::Serving;
                    if is_served {
                        own.standing = Standing::Changed;
                    }
                    is_served
                })
            };
            if has_changed {
                self.declare(name, Standing::Changed);
            }
        }
    }

    /// Whether the daemon waits for another one of its own name to end.
    pub fn waits(&self) -> bool {
        let known = self.known();
        let verdict = known.verdict(&Name::Node, &self.claimant);
        matches!(verdict, Some((Verdict::Wait(_), _)))
    }

    /// Whether a router is connected, through which other daemons may be reachable.
    pub fn is_connected(&self) -> bool {
        !self.known().routers.is_empty()
    }

    /// Whether the swarm accepts messages that get no reply, such as set-points.
    pub fn serves(&self, swarm: &str) -> bool {
        matches!(
            self.gate(&Name::Swarm(swarm.to_owned()), true),
            Gate::Open | Gate::First
        )
    }

    /// When [`Claims::reconcile`] is due, if nothing happens before.
    pub fn due(&self) -> Option<Instant> {
        let known = self.known();
        match known.news.is_empty() {
            true => known.due,
            false => Some(Instant::now()),
        }
    }

    /// Judges the names whose claims changed, and returns what to change.
    pub fn reconcile(&self) -> Vec<Action> {
        let now = Instant::now();
        let (mut actions, mut declared, mut ended) = (Vec::new(), Vec::new(), Vec::new());
        {
            let mut known = self.known();
            let news = std::mem::take(&mut known.news);
            // The verdict on the daemon's own name applies to all of its swarms.
            let names: Vec<Name> = match known.due.is_some_and(|due| now >= due) {
                false if !news.contains(&Name::Node) => news.into_iter().collect(),
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
                if own
                    .reserved
                    .is_some_and(|since| now >= since + MAX_RESERVATION)
                {
                    ended.push(name);
                    continue;
                }
                let due = match own.reserved {
                    Some(since) => Some(since + MAX_RESERVATION),
                    None => {
                        let before = own.standing;
                        actions.extend(own.judged(&name, &verdict, now));
                        if own.standing != before {
                            declared.push((name, own.standing));
                        }
                        own.is_settling().then_some(own.settled)
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

    /// Every name that another daemon holds, too.
    pub fn contests(&self) -> Vec<Contest> {
        let known = self.known();
        // While this daemon waits for another one of its own name, it serves nothing: report that.
        if let Some((Verdict::Wait(other), _)) = known.verdict(&Name::Node, &self.claimant) {
            return vec![self.contest(&Name::Node, &other, true)];
        }
        let names = known.own.iter().filter(|(_, own)| own.reserved.is_none());
        names
            .filter_map(|(name, _)| match known.verdict(name, &self.claimant)?.0 {
                Verdict::Serve => None,
                Verdict::Wait(other) => Some(self.contest(name, &other, true)),
                Verdict::Refuse(other) => Some(self.contest(name, &other, false)),
            })
            .collect()
    }

    /// The contest of a swarm's name, if another daemon holds it and this one does not serve it.
    pub fn contest_of(&self, swarm: &str) -> Option<Contest> {
        let mut contests = self.contests().into_iter();
        contests.find(|it| it.swarm.as_deref().is_none_or(|name| name == swarm))
    }

    fn contest(&self, name: &Name, other: &Claimant, waits: bool) -> Contest {
        let swarm = match name {
            Name::Node => None,
            Name::Swarm(swarm) => Some(swarm.clone()),
        };
        Contest {
            swarm,
            claimants: [self.claimant.clone(), other.clone()],
            waits,
        }
    }

    /// Declares the claim to a name with its new standing, then undeclares the previous one.
    fn declare(&self, name: &Name, standing: Standing) {
        let swarm = match name {
            Name::Node => None,
            Name::Swarm(swarm) => Some(swarm.clone()),
        };
        let claim = Claim {
            swarm,
            claimant: self.claimant.clone(),
            standing,
        };
        let token = self.session.liveliness();
        match token.declare_token(claim.key(&self.prefix)).wait() {
            Ok(token) => drop(self.tokens().insert(name.clone(), token)),
            Err(error) => warn!(name = name.text(), %error, "failed to claim a name"),
        }
    }

    /// Records that a router connected or disconnected.
    fn router(self: &Arc<Self>, router: String, is_there: bool) {
        let now = Instant::now();
        let mut known = self.known();
        known.news.insert(Name::Node);
        if !is_there {
            known.routers.remove(&router);
            return;
        }
        let is_first = known.routers.is_empty();
        known.routers.insert(router);
        known.hold(now);
        if is_first {
            known.beat = now;
            let claims = Arc::downgrade(self);
            let beating = thread::Builder::new()
                .name("heartbeat".into())
                .spawn(move || {
                    while let Some(claims) = claims.upgrade() {
                        let mut known = claims.known();
                        if known.routers.is_empty() {
                            break;
                        }
                        known.notice_pause(Instant::now());
                        known.beat = Instant::now();
                        drop(known);
                        drop(claims);
                        thread::sleep(HEARTBEAT);
                    }
                });
            if let Err(error) = beating {
                // Without heartbeats, commands are rejected as after a suspension.
                warn!(%error, "failed to start the heartbeat");
            }
        }
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
        let mut known = self.known();
        known.news.insert(name.clone());
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

    fn known(&self) -> MutexGuard<'_, Known> {
        // Every change is an assignment, so a panic leaves it whole.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tokens(&self) -> MutexGuard<'_, BTreeMap<Name, LivelinessToken>> {
        self.tokens.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Known {
    /// The verdict on a name of this daemon. A swarm waits if the daemon's own name waits.
    fn verdict(&self, name: &Name, claimant: &Claimant) -> Option<(Verdict, &Own)> {
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
    fn hold(&mut self, now: Instant) {
        self.holds
            .retain(|at| now.duration_since(*at) < HOLDS_WITHIN);
        if self.holds.len() >= MAX_HOLDS {
            return warn!("too many router connections: commands are not held for this one");
        }
        self.holds.push_back(now);
        self.held_until = now + SETTLING;
    }

    /// Detects that the daemon was suspended for so long that others may serve its names.
    fn notice_pause(&mut self, now: Instant) {
        let paused = now.saturating_duration_since(self.beat);
        if self.routers.is_empty() || paused <= MAX_PAUSE {
            return;
        }
        warn!(
            secs = paused.as_secs_f64(),
            "daemon was suspended: rejecting commands that arrived meanwhile"
        );
        self.beat = now;
        self.stale_until = now + SETTLING;
        self.news.insert(Name::Node);
    }
}

impl Own {
    /// Applies a verdict and returns what to change.
    fn judged(&mut self, name: &Name, verdict: &Verdict, now: Instant) -> Vec<Action> {
        let mut actions = Vec::new();
        match verdict {
            Verdict::Serve => {
                if std::mem::take(&mut self.is_contested) {
                    self.settled = now + SETTLING;
                }
                if now < self.settled {
                    return actions;
                }
                self.standing = self.standing.max(Standing::Serving);
                if !std::mem::replace(&mut self.is_open, true) {
                    actions.push(Action::Open(name.clone()));
                } else if std::mem::take(&mut self.is_refusing) {
                    actions.push(Action::Resume(name.clone()));
                }
            }
            Verdict::Wait(other) => {
                if !std::mem::replace(&mut self.is_contested, true) {
                    let Claimant { node, instance } = other;
                    let name = name.text();
                    warn!(name, node, instance, "contested: another daemon serves it");
                }
                self.standing = Standing::Waiting;
                self.is_refusing = false;
                if std::mem::take(&mut self.is_open) {
                    actions.push(Action::Close(name.clone()));
                }
            }
            Verdict::Refuse(other) => {
                if !std::mem::replace(&mut self.is_contested, true) {
                    let Claimant { node, instance } = other;
                    let problem = "contested: rejecting everything, both daemons executed commands";
                    let name = name.text();
                    warn!(name, node, instance, "{problem}");
                }
                if !std::mem::replace(&mut self.is_open, true) {
                    actions.push(Action::Open(name.clone()));
                }
                if !std::mem::replace(&mut self.is_refusing, true) {
                    actions.push(Action::Refuse(name.clone()));
                }
            }
        }
        actions
    }

    /// Whether the name must be judged again at `settled`.
    fn is_settling(&self) -> bool {
        !self.is_contested && (!self.is_open || self.is_refusing)
    }
}
