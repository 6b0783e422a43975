//! The controllers that have joined a swarm: the individuals that each steers, the step that each has
//! advanced to, and their deadlines.
//!
//! The caller passes the time. A deadline that has passed is a command, so a replay needs no clock.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Instant;

use crate::swarm::error::SwarmError;
use crate::swarm::membership::{
    ControllerState, ControllerStatus, Departure, JoinOptions, Miss, Mode, News, Put, Puts,
};
use crate::swarm::outcome::ReplyTo;
use crate::swarm::sender::Sender;

/// Controllers that may join one swarm.
const MAX_CONTROLLERS: usize = 256;

/// Departures that are kept for the error that a controller gets after it has left.
const MAX_DEPARTURES: usize = 256;

/// A controller that has joined.
pub struct Member {
    /// What is persisted.
    pub state: ControllerState,
    /// Receives the reply to its `advance`.
    reply_to: Option<ReplyTo>,
    /// Since when the swarm waits for it, or the time of its last put.
    since: Option<Instant>,
    put: Option<Put>,
    puts: Puts,
}

/// Every controller that has joined a swarm.
#[derive(Default)]
pub struct Controllers {
    members: BTreeMap<String, Member>,
    departures: VecDeque<(String, Departure, u64)>,
    /// The next deadline or end of a lease.
    due: Option<Instant>,
}

impl Controllers {
    /// The controllers of a checkpoint; `reply_for` makes the receivers of the replies to their advances.
    pub fn restore(
        state: Vec<(String, ControllerState)>,
        mut reply_for: impl FnMut(&Arc<Sender>) -> ReplyTo,
    ) -> Self {
        let members = state.into_iter().map(|(name, state)| {
            let reply_to = state.advance.as_ref().map(&mut reply_for);
            (name, Member::new(state, reply_to))
        });
        Controllers {
            members: members.collect(),
            ..Controllers::default()
        }
    }

    /// The persisted state of each.
    pub fn states(&self) -> Vec<(String, ControllerState)> {
        let members = self.members.iter();
        members
            .map(|(name, member)| (name.clone(), member.state.clone()))
            .collect()
    }

    /// Whether no controller has joined.
    pub fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    /// Whether the swarm steps only when all have advanced.
    pub fn is_lockstep(&self) -> bool {
        self.lockstep().next().is_some()
    }

    /// The controller of this name.
    ///
    /// # Errors
    ///
    /// [`SwarmError::NotJoined`], with the reason of its departure if it had joined.
    pub fn find(&mut self, controller: &str) -> Result<&mut Member, SwarmError> {
        let departures = self.departures.iter().rev();
        let mut departures = departures.filter(|(name, ..)| name == controller);
        let left = departures.next().map(|(_, why, step)| (*why, *step));
        self.members
            .get_mut(controller)
            .ok_or_else(|| SwarmError::NotJoined {
                controller: controller.to_owned(),
                left,
            })
    }

    /// The controller that has claimed this individual.
    pub fn owner(&self, id: u32) -> Option<&str> {
        let mut members = self.members.iter();
        members
            .find(|(_, member)| member.state.claims.contains(&id))
            .map(|(name, _)| name.as_str())
    }

    /// The individuals that other controllers have claimed.
    pub fn claimed_by_others(&self, controller: &str) -> BTreeSet<u32> {
        let others = self.members.iter().filter(|(name, _)| *name != controller);
        others
            .flat_map(|(_, member)| member.state.claims.iter().copied())
            .collect()
    }

    /// Whether a controller may join with these options.
    ///
    /// # Errors
    ///
    /// [`SwarmError::HasJoined`] and [`SwarmError::TooManyControllers`].
    pub fn check_join(&self, options: &JoinOptions) -> Result<(), SwarmError> {
        if self.members.contains_key(&options.controller) {
            return match options.again {
                true => Ok(()),
                false => Err(SwarmError::HasJoined(options.controller.clone())),
            };
        }
        match self.members.len() {
            MAX_CONTROLLERS => Err(SwarmError::TooManyControllers {
                limit: MAX_CONTROLLERS,
            }),
            _ => Ok(()),
        }
    }

    /// Adds a controller at `step`; without `claims` it keeps its earlier ones. Returns the receiver of
    /// the reply to an `advance` that was pending.
    pub fn join(
        &mut self,
        options: &JoinOptions,
        claims: Option<BTreeSet<u32>>,
        step: u64,
    ) -> Option<ReplyTo> {
        let before = self.members.remove(&options.controller);
        let (old, reply_to) = before.map_or((None, None), |it| (Some(it.state), it.reply_to));
        let old = old.unwrap_or_else(|| ControllerState {
            mode: options.mode,
            deadline: options.deadline,
            on_timeout: options.on_timeout,
            driving: options.driving,
            claims: BTreeSet::new(),
            steered: BTreeSet::new(),
            target: step,
            from: step,
            advance: None,
            misses: 0,
            news: News::default(),
            sequence: 0,
        });
        let claims = claims.unwrap_or_else(|| old.claims.clone());
        let state = ControllerState {
            mode: options.mode,
            deadline: options.deadline,
            on_timeout: options.on_timeout,
            driving: options.driving,
            steered: old.steered.intersection(&claims).copied().collect(),
            claims,
            target: step,
            from: step,
            advance: None,
            misses: 0,
            ..old
        };
        self.members
            .insert(options.controller.clone(), Member::new(state, None));
        reply_to
    }

    /// Removes a controller at `step`, and adds that to the news of the others.
    pub fn remove(&mut self, controller: &str, why: Departure, step: u64) -> Option<Member> {
        let member = self.members.remove(controller)?;
        for other in self.members.values_mut() {
            other.state.news.left.push((controller.to_owned(), why));
        }
        if self.departures.len() == MAX_DEPARTURES {
            self.departures.pop_front();
        }
        self.departures
            .push_back((controller.to_owned(), why, step));
        Some(member)
    }

    /// Adds a deadline that fired at `step` to the news of all. Returns the number of misses in a row.
    pub fn record_miss(&mut self, controller: &str, step: u64) -> u32 {
        let Some(member) = self.members.get_mut(controller) else {
            return 0;
        };
        member.state.misses += 1;
        member.since = None;
        let miss = Miss {
            controller: controller.to_owned(),
            step,
            misses: member.state.misses,
        };
        for member in self.members.values_mut() {
            member.state.news.missed.push(miss.clone());
        }
        miss.misses
    }

    /// The least step beyond `step` that a controller has advanced to.
    pub fn nearest_target(&self, step: u64) -> Option<u64> {
        let targets = self.lockstep().map(|(_, member)| member.state.target);
        targets.filter(|&target| target > step).min()
    }

    /// The step that all controllers have advanced to, if it is beyond `step`.
    pub fn common_target(&self, step: u64) -> Option<u64> {
        let targets = self.lockstep().map(|(_, member)| member.state.target);
        targets.min().filter(|&target| target > step)
    }

    /// Takes the pending advances that end at `step`, or all: the receiver of the reply, the step at
    /// which each began, and the news.
    pub fn take_arrived(&mut self, step: u64, all: bool) -> Vec<(ReplyTo, u64, News)> {
        let mut arrived = Vec::new();
        for member in self.members.values_mut() {
            let state = &mut member.state;
            if (state.target <= step || all) && state.advance.take().is_some() {
                state.target = state.target.min(step);
                if let Some(reply_to) = member.reply_to.take() {
                    arrived.push((reply_to, state.from, std::mem::take(&mut state.news)));
                }
            }
        }
        arrived
    }

    /// Takes the receivers of all pending replies.
    pub fn cancel_advances(&mut self) -> Vec<ReplyTo> {
        let members = self.members.values_mut();
        members
            .filter_map(|member| {
                member.state.advance = None;
                member.reply_to.take()
            })
            .collect()
    }

    /// Restarts at `step`, with only these individuals left.
    pub fn restart(&mut self, step: u64, exists: impl Fn(u32) -> bool) {
        for member in self.members.values_mut() {
            member.state.target = step;
            member.state.from = step;
            member.state.steered.clear();
            member.put = None;
        }
        self.retain_individuals(exists);
    }

    /// Drops the individuals that no longer exist, and adds that to the news of their controllers.
    pub fn retain_individuals(&mut self, exists: impl Fn(u32) -> bool) {
        for member in self.members.values_mut() {
            let state = &mut member.state;
            let gone: Vec<u32> = state
                .claims
                .iter()
                .copied()
                .filter(|&id| !exists(id))
                .collect();
            for id in gone {
                state.claims.remove(&id);
                state.steered.remove(&id);
                state.news.removed.push(id);
            }
        }
    }

    /// Updates the deadlines at `step`.
    pub fn update_deadlines(&mut self, step: u64, now: Instant) {
        let is_waiting = self.nearest_target(step).is_some();
        self.due = None;
        for member in self.members.values_mut() {
            let is_awaited = match member.state.mode {
                Mode::Lockstep => is_waiting && member.state.target <= step,
                // The lease begins at the last put, as long as its set-points hold.
                Mode::FreeRunning => !member.state.steered.is_empty() && member.state.misses == 0,
            };
            if !is_awaited {
                member.since = None;
                continue;
            }
            let due = *member.since.get_or_insert(now) + member.state.deadline;
            self.due = Some(self.due.map_or(due, |least| least.min(due)));
        }
    }

    /// Clears the deadline until the next update.
    pub fn clear_deadline(&mut self) {
        self.due = None;
    }

    /// The next deadline or end of a lease.
    pub fn due(&self) -> Option<Instant> {
        self.due
    }

    /// The controllers whose deadline or lease has ended.
    pub fn overdue(&self, now: Instant) -> Vec<String> {
        if self.due.is_none_or(|due| due > now) {
            return Vec::new();
        }
        let overdue = self.members.iter().filter(|(_, member)| {
            let since = member.since;
            since.is_some_and(|since| since + member.state.deadline <= now)
        });
        overdue.map(|(name, _)| name.clone()).collect()
    }

    /// Queues set-points, which replace older ones, and counts the outcome.
    pub fn put(&mut self, controller: &str, put: Put, is_current_epoch: bool) {
        let Some(member) = self.members.get_mut(controller) else {
            return;
        };
        let state = &member.state;
        let newest = member.put.as_ref().map_or(state.sequence, |it| it.sequence);
        if state.mode == Mode::Lockstep {
            member.puts.rejected += 1;
        } else if put.sequence <= newest || !is_current_epoch {
            member.puts.stale += 1;
        } else if member.put.replace(put).is_some() {
            member.puts.overtaken += 1;
        }
    }

    /// Counts a put that could not be parsed.
    pub fn count_rejected_put(&mut self, controller: &str) {
        if let Some(member) = self.members.get_mut(controller) {
            member.puts.rejected += 1;
        }
    }

    /// Takes the queued set-points, in the order of the controllers' names.
    pub fn take_puts(&mut self) -> Vec<(String, Put)> {
        let members = self.members.iter_mut();
        members
            .filter_map(|(name, member)| Some((name.clone(), member.put.take()?)))
            .collect()
    }

    /// All of them, for replies to queries.
    pub fn statuses(&self, now: Instant) -> Vec<ControllerStatus> {
        let members = self.members.iter().map(|(name, member)| {
            let state = &member.state;
            let is_lockstep = state.mode == Mode::Lockstep;
            let waited = member.since.filter(|_| is_lockstep);
            ControllerStatus {
                controller: name.clone(),
                mode: state.mode,
                ids: state.claims.iter().copied().collect(),
                deadline: state.deadline,
                on_timeout: state.on_timeout,
                driving: state.driving,
                target: is_lockstep.then_some(state.target),
                misses: state.misses,
                waited: waited.map(|since| now.saturating_duration_since(since)),
                puts: member.puts,
            }
        });
        members.collect()
    }

    /// The controllers in lockstep.
    fn lockstep(&self) -> impl Iterator<Item = (&String, &Member)> {
        let members = self.members.iter();
        members.filter(|(_, member)| member.state.mode == Mode::Lockstep)
    }
}

impl Member {
    fn new(state: ControllerState, reply_to: Option<ReplyTo>) -> Self {
        Member {
            state,
            reply_to,
            since: None,
            put: None,
            puts: Puts::default(),
        }
    }

    /// Begins an `advance`. Returns the receiver of the reply to one that was pending.
    pub fn advance(
        &mut self,
        from: u64,
        target: u64,
        sender: Arc<Sender>,
        reply_to: ReplyTo,
    ) -> Option<ReplyTo> {
        self.state.from = from;
        self.state.target = target;
        self.state.misses = 0;
        self.state.advance = Some(sender);
        self.since = None;
        self.reply_to.replace(reply_to)
    }

    /// Counts set-points that were applied or rejected.
    pub fn count_put(&mut self, sequence: u64, is_applied: bool) {
        self.state.sequence = sequence;
        self.state.misses = 0;
        self.since = None;
        match is_applied {
            true => self.puts.applied += 1,
            false => self.puts.rejected += 1,
        }
    }

    /// Takes the receiver of the reply to the pending `advance`.
    pub fn take_reply_to(&mut self) -> Option<ReplyTo> {
        self.state.advance = None;
        self.reply_to.take()
    }
}
