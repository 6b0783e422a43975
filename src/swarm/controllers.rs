//! The controllers that have joined a swarm: whom each steers, how far each has advanced, and for
//! whom the swarm waits. Clocks are the caller's: whether a deadline has passed is asked with a
//! time, and that it did is an order like any other, so that a journal told again needs no clock.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Instant;

use crate::swarm::error::SwarmError;
use crate::swarm::membership::{
    ControllerState, Departure, JoinOptions, Miss, Mode, News, Put, Puts, Seen,
};
use crate::swarm::outcome::ReplyTo;
use crate::swarm::sender::Sender;

/// Controllers that may join one swarm.
const MOST: usize = 256;

/// Departures that are remembered, to tell whoever comes back.
const MOST_DEPARTURES: usize = 256;

/// A controller that has joined.
pub struct Member {
    /// What outlives a crash.
    pub kept: ControllerState,
    /// Takes the answer to its `advance`.
    answer: Option<ReplyTo>,
    /// Since when the swarm waits for it, or since when it has put nothing.
    since: Option<Instant>,
    put: Option<Put>,
    puts: Puts,
}

/// Every controller that has joined a swarm.
#[derive(Default)]
pub struct Controllers {
    members: BTreeMap<String, Member>,
    departures: VecDeque<(String, Departure, u64)>,
    /// When the next deadline or lease ends.
    due: Option<Instant>,
}

impl Controllers {
    /// Those that were there at a checkpoint; `answers` takes what their advances come to.
    pub fn recall(
        kept: Vec<(String, ControllerState)>,
        mut answers: impl FnMut(&Arc<Sender>) -> ReplyTo,
    ) -> Self {
        let members = kept.into_iter().map(|(name, kept)| {
            let answer = kept.advance.as_ref().map(&mut answers);
            (name, Member::new(kept, answer))
        });
        Controllers {
            members: members.collect(),
            ..Controllers::default()
        }
    }

    /// All that outlives a crash.
    pub fn kept(&self) -> Vec<(String, ControllerState)> {
        let members = self.members.iter();
        members
            .map(|(name, member)| (name.clone(), member.kept.clone()))
            .collect()
    }

    /// Whether nobody has joined.
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
    /// [`SwarmError::NotJoined`], with why it is no longer there, if it once was.
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

    /// Who may steer this individual.
    pub fn owner(&self, id: u32) -> Option<&str> {
        let mut members = self.members.iter();
        members
            .find(|(_, member)| member.kept.claims.contains(&id))
            .map(|(name, _)| name.as_str())
    }

    /// Everybody who is claimed by another than this controller.
    pub fn claimed_beside(&self, controller: &str) -> BTreeSet<u32> {
        let others = self.members.iter().filter(|(name, _)| *name != controller);
        others
            .flat_map(|(_, member)| member.kept.claims.iter().copied())
            .collect()
    }

    /// Whether a controller may join by these terms.
    ///
    /// # Errors
    ///
    /// [`SwarmError::HasJoined`] and [`SwarmError::TooManyControllers`].
    pub fn admit(&self, options: &JoinOptions) -> Result<(), SwarmError> {
        if self.members.contains_key(&options.controller) {
            return match options.again {
                true => Ok(()),
                false => Err(SwarmError::HasJoined(options.controller.clone())),
            };
        }
        match self.members.len() {
            MOST => Err(SwarmError::TooManyControllers { limit: MOST }),
            _ => Ok(()),
        }
    }

    /// Takes a controller in at `step`; with `None` it claims whom it claimed before. Gives back
    /// whoever still waited for its last advance.
    pub fn join(
        &mut self,
        options: &JoinOptions,
        claims: Option<BTreeSet<u32>>,
        step: u64,
    ) -> Option<ReplyTo> {
        let before = self.members.remove(&options.controller);
        let (old, answer) = before.map_or((None, None), |it| (Some(it.kept), it.answer));
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
        let kept = ControllerState {
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
            .insert(options.controller.clone(), Member::new(kept, None));
        answer
    }

    /// Takes a controller out at `step`, and tells the others. Gives back what it was.
    pub fn part(&mut self, controller: &str, why: Departure, step: u64) -> Option<Member> {
        let member = self.members.remove(controller)?;
        for other in self.members.values_mut() {
            other.kept.news.left.push((controller.to_owned(), why));
        }
        if self.departures.len() == MOST_DEPARTURES {
            self.departures.pop_front();
        }
        self.departures
            .push_back((controller.to_owned(), why, step));
        Some(member)
    }

    /// Tells everybody of a deadline that fired at `step`. Returns how many were missed in a row.
    pub fn miss(&mut self, controller: &str, step: u64) -> u32 {
        let Some(member) = self.members.get_mut(controller) else {
            return 0;
        };
        member.kept.misses += 1;
        member.since = None;
        let miss = Miss {
            controller: controller.to_owned(),
            step,
            misses: member.kept.misses,
        };
        for member in self.members.values_mut() {
            member.kept.news.missed.push(miss.clone());
        }
        miss.misses
    }

    /// The least step that anybody has advanced to beyond `step`.
    pub fn nearest(&self, step: u64) -> Option<u64> {
        let targets = self.lockstep().map(|(_, member)| member.kept.target);
        targets.filter(|&target| target > step).min()
    }

    /// The step up to which every controller has advanced, if that lies beyond `step`.
    pub fn together(&self, step: u64) -> Option<u64> {
        let targets = self.lockstep().map(|(_, member)| member.kept.target);
        targets.min().filter(|&target| target > step)
    }

    /// Takes out the answers of all whose advance has come to its end at `step`, or of everybody,
    /// each with where it began and what is news to it.
    pub fn arrived(&mut self, step: u64, everybody: bool) -> Vec<(ReplyTo, u64, News)> {
        let mut arrived = Vec::new();
        for member in self.members.values_mut() {
            let kept = &mut member.kept;
            if (kept.target <= step || everybody) && kept.advance.take().is_some() {
                kept.target = kept.target.min(step);
                if let Some(answer) = member.answer.take() {
                    arrived.push((answer, kept.from, std::mem::take(&mut kept.news)));
                }
            }
        }
        arrived
    }

    /// Takes out the answers of everybody who waits.
    pub fn give_up(&mut self) -> Vec<ReplyTo> {
        let members = self.members.values_mut();
        members
            .filter_map(|member| {
                member.kept.advance = None;
                member.answer.take()
            })
            .collect()
    }

    /// Begins anew at `step`, with only these individuals left.
    pub fn restart(&mut self, step: u64, is_there: impl Fn(u32) -> bool) {
        for member in self.members.values_mut() {
            member.kept.target = step;
            member.kept.from = step;
            member.kept.steered.clear();
            member.put = None;
        }
        self.forget(is_there);
    }

    /// Forgets those who are gone, and has their owners told.
    pub fn forget(&mut self, is_there: impl Fn(u32) -> bool) {
        for member in self.members.values_mut() {
            let kept = &mut member.kept;
            let gone: Vec<u32> = kept
                .claims
                .iter()
                .copied()
                .filter(|&id| !is_there(id))
                .collect();
            for id in gone {
                kept.claims.remove(&id);
                kept.steered.remove(&id);
                kept.news.removed.push(id);
            }
        }
    }

    /// Looks anew for whom the swarm waits at `step`, and until when.
    pub fn wait_at(&mut self, step: u64, now: Instant) {
        let somebody_waits = self.nearest(step).is_some();
        self.due = None;
        for member in self.members.values_mut() {
            let is_awaited = match member.kept.mode {
                Mode::Lockstep => somebody_waits && member.kept.target <= step,
                // Its lease runs from its last put on, if what that said still holds.
                Mode::FreeRunning => !member.kept.steered.is_empty() && member.kept.misses == 0,
            };
            if !is_awaited {
                member.since = None;
                continue;
            }
            let due = *member.since.get_or_insert(now) + member.kept.deadline;
            self.due = Some(self.due.map_or(due, |least| least.min(due)));
        }
    }

    /// Waits for nobody, until it is looked anew.
    pub fn rest(&mut self) {
        self.due = None;
    }

    /// When the next deadline or lease ends.
    pub fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Whose deadline or lease has ended.
    pub fn overdue(&self, now: Instant) -> Vec<String> {
        if self.due.is_none_or(|due| due > now) {
            return Vec::new();
        }
        let overdue = self.members.iter().filter(|(_, member)| {
            let since = member.since;
            since.is_some_and(|since| since + member.kept.deadline <= now)
        });
        overdue.map(|(name, _)| name.clone()).collect()
    }

    /// Takes set-points that were put; the newest wins, and all are counted.
    pub fn put(&mut self, controller: &str, put: Put, is_of_now: bool) {
        let Some(member) = self.members.get_mut(controller) else {
            return;
        };
        let kept = &member.kept;
        let newest = member.put.as_ref().map_or(kept.sequence, |it| it.sequence);
        if kept.mode == Mode::Lockstep {
            member.puts.refused += 1;
        } else if put.sequence <= newest || !is_of_now {
            member.puts.stale += 1;
        } else if member.put.replace(put).is_some() {
            member.puts.overtaken += 1;
        }
    }

    /// Counts a put that could not be read.
    pub fn refuse_put(&mut self, controller: &str) {
        if let Some(member) = self.members.get_mut(controller) {
            member.puts.refused += 1;
        }
    }

    /// Takes out the set-points that wait, in the order of their controllers' names.
    pub fn take_puts(&mut self) -> Vec<(String, Put)> {
        let members = self.members.iter_mut();
        members
            .filter_map(|(name, member)| Some((name.clone(), member.put.take()?)))
            .collect()
    }

    /// All of them, as others see them.
    pub fn seen(&self, now: Instant) -> Vec<Seen> {
        let members = self.members.iter().map(|(name, member)| {
            let kept = &member.kept;
            let is_lockstep = kept.mode == Mode::Lockstep;
            let waited = member.since.filter(|_| is_lockstep);
            Seen {
                controller: name.clone(),
                mode: kept.mode,
                ids: kept.claims.iter().copied().collect(),
                deadline: kept.deadline,
                on_timeout: kept.on_timeout,
                driving: kept.driving,
                target: is_lockstep.then_some(kept.target),
                misses: kept.misses,
                waited: waited.map(|since| now.saturating_duration_since(since)),
                puts: member.puts,
            }
        });
        members.collect()
    }

    /// Those that advance in lock-step.
    fn lockstep(&self) -> impl Iterator<Item = (&String, &Member)> {
        let members = self.members.iter();
        members.filter(|(_, member)| member.kept.mode == Mode::Lockstep)
    }
}

impl Member {
    fn new(kept: ControllerState, answer: Option<ReplyTo>) -> Self {
        Member {
            kept,
            answer,
            since: None,
            put: None,
            puts: Puts::default(),
        }
    }

    /// Has advanced to a step; gives back whoever waited for an advance before.
    pub fn advance(
        &mut self,
        from: u64,
        target: u64,
        sender: Arc<Sender>,
        answer: ReplyTo,
    ) -> Option<ReplyTo> {
        self.kept.from = from;
        self.kept.target = target;
        self.kept.misses = 0;
        self.kept.advance = Some(sender);
        self.since = None;
        self.answer.replace(answer)
    }

    /// Counts set-points that were put and applied, or were not to be.
    pub fn count_put(&mut self, sequence: u64, is_applied: bool) {
        self.kept.sequence = sequence;
        self.kept.misses = 0;
        self.since = None;
        match is_applied {
            true => self.puts.applied += 1,
            false => self.puts.refused += 1,
        }
    }

    /// Who waits for its advance.
    pub fn take_answer(&mut self) -> Option<ReplyTo> {
        self.kept.advance = None;
        self.answer.take()
    }
}
