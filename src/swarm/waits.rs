//! Queries that wait for a condition. They are no part of the state: neither journaled nor in checkpoints,
//! forks and snapshots, and each ends shortly after its client.
//!
//! A client repeats its query, since the daemon holds one for at most 30 s. In between the wait remains, with
//! what its comparisons have seen.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use jostle_conditions::{Condition, Held};
use jostle_measures::{FRAME_POSES, MAX_PAST, MAX_PLAIN, Past, View, check_cost, check_past};
use jostle_physics::model::State;

use crate::swarm::awaited::{Awaited, WaitSummary};
use crate::swarm::error::SwarmError;
use crate::swarm::frame::{Frame, Stamp};
use crate::swarm::handle::{Outcome, Rejection, ReplyTo};

/// Waits of one swarm.
pub const MAX_WAITS: usize = 16;

/// Of them, those of one user.
const MAX_WAITS_OF_USER: usize = 4;

/// Different measures that the waits of a user who is no operator compare in a swarm, of any cost: a single
/// condition has room for more than all waits together may compare.
const MAX_MEASURES_OF_USER: usize = MAX_PLAIN / 4;

/// A wait ends this long after its token or connection. A connection through a router may declare its token
/// later than it sends the query, and a client over HTTP sends the next query after a reply.
const GRACE: Duration = Duration::from_secs(2);

/// A wait ends when it has had no query for this long, even if its token is declared.
const MAX_IDLE: Duration = Duration::from_secs(10);

/// The interval of the checks whether clients exist.
const SWEEP_INTERVAL: Duration = Duration::from_millis(100);

/// The same while the swarm does not step.
const IDLE_SWEEP_INTERVAL: Duration = Duration::from_millis(500);

/// Memory of a pose of an earlier step, in bytes; see [`MAX_PAST`].
const BYTES_PER_POSE: u64 = 28;

/// Reserves so many bytes for the earlier states, in place of those before.
pub type ReservePast = Box<dyn Fn(u64) -> Result<(), SwarmError> + Send>;

/// The query of a wait.
pub struct Query {
    /// Whether it has a reply, or its client is gone.
    is_abandoned: Box<dyn Fn() -> bool + Send>,
    reply_to: ReplyTo,
}

/// A wait.
struct Waiting {
    awaited: Awaited,
    held: Held,
    /// The step at which it began: its measures do not use earlier states.
    first: u64,
    query: Option<Query>,
    /// Since when it has no query.
    idle_since: Option<Instant>,
}

/// A wait whose condition has held. Its reply may have missed the query, which ended at the same time, so the
/// next query gets it again.
struct Settled {
    awaited: Awaited,
    at: Instant,
    state: (Stamp, Arc<Frame>),
}

/// The outcome of a query.
pub enum Added {
    /// The condition holds in the present state.
    Holds,
    /// It waits: call [`Waits::attach`] next.
    Waits,
}

/// The waits of a swarm, in the order of arrival.
#[derive(Default)]
pub struct Waits {
    waiting: Vec<Waiting>,
    /// At most [`MAX_WAITS`], the newest ones.
    settled: VecDeque<Settled>,
    /// The states before each step, as far back as the measures need them.
    past: Past,
    /// The lag of their measures; `None` after a change.
    lag: Option<u64>,
    /// The number of individuals for which costs and memory were checked.
    checked_for: usize,
    /// Bytes that are reserved for the past.
    reserved: u64,
    reserve: Option<ReservePast>,
    swept: Option<Instant>,
}

impl Waits {
    /// Reserves memory by `reserve` from now on.
    pub fn set_reserve(&mut self, reserve: ReservePast) {
        self.reserve = Some(reserve);
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// The state in which the condition of a wait has held that was told before, or should have been.
    pub fn held(&self, awaited: &Awaited) -> Option<(Stamp, Arc<Frame>)> {
        let is_same = |it: &Awaited| it.is_same(awaited) && it.condition == awaited.condition;
        let mut settled = self.settled.iter();
        let held = settled.find(|it| is_same(&it.awaited))?;
        Some(held.state.clone())
    }

    /// Begins a wait, or continues the one of the same user, id and condition.
    ///
    /// # Errors
    ///
    /// Nothing has changed but that a wait of the same user and id has ended.
    pub fn add(&mut self, awaited: &Awaited, state: &State) -> Result<Added, SwarmError> {
        self.sweep(Instant::now(), state.step);
        let mut waiting = self.waiting.iter();
        if let Some(index) = waiting.position(|it| it.awaited.is_same(awaited)) {
            let mut before = self.waiting.remove(index);
            if before.awaited.condition == awaited.condition {
                before.awaited.holder = awaited.holder.clone();
                reject(before.query.take(), state.step, SwarmError::Superseded);
                self.waiting.push(before);
                return Ok(Added::Waits);
            }
            reject(before.query, state.step, SwarmError::Superseded);
        }
        let condition = &awaited.condition;
        match self.admit(awaited, state) {
            // A client that has ended its wait may come back, but the next wait needs the place.
            Err(_) if self.end_lost(state.step) => self.admit(awaited, state)?,
            admitted => admitted?,
        }
        let mut held = Held::default();
        let view = View::new(state, &self.past);
        condition.measures().for_each(|it| it.announce(&view));
        view.ignore_before(state.step);
        if condition.observe(&view, state.step, state.parameters.dt, &mut held) {
            self.release_if_unused();
            return Ok(Added::Holds);
        }
        self.lag = None;
        awaited.holder.begin();
        self.waiting.push(Waiting {
            awaited: awaited.clone(),
            held,
            first: state.step,
            query: None,
            idle_since: None,
        });
        Ok(Added::Waits)
    }

    /// Gives the wait that was added last its query.
    pub fn attach(&mut self, is_abandoned: Box<dyn Fn() -> bool + Send>, reply_to: ReplyTo) {
        if let Some(last) = self.waiting.last_mut() {
            last.query = Some(Query {
                is_abandoned,
                reply_to,
            });
            last.idle_since = None;
        }
    }

    fn admit(&mut self, awaited: &Awaited, state: &State) -> Result<(), SwarmError> {
        self.check_places(awaited)?;
        self.check(&awaited.condition, state)
    }

    /// Ends the waits whose tokens or connections have ended. Whether there were any.
    fn end_lost(&mut self, step: u64) -> bool {
        let before = self.waiting.len();
        for lost in self
            .waiting
            .extract_if(.., |it| it.awaited.holder.is_lost())
        {
            let key = lost.awaited.holder.key.clone();
            reject(lost.query, step, SwarmError::NotHeld(key));
        }
        self.lag = None;
        self.waiting.len() < before
    }

    fn check_places(&self, awaited: &Awaited) -> Result<(), SwarmError> {
        let count = self.waiting.len();
        if count >= MAX_WAITS {
            return Err(SwarmError::TooManyWaits { count, user: None });
        }
        let Some(user) = &awaited.user else {
            return Ok(());
        };
        let own = || {
            let waiting = self.waiting.iter().map(|it| &it.awaited);
            waiting.filter(|it| it.user == awaited.user)
        };
        let count = own().count();
        if count >= MAX_WAITS_OF_USER {
            return Err(SwarmError::TooManyWaits {
                count,
                user: Some(user.to_string()),
            });
        }
        let mut measures = Vec::new();
        for measure in own()
            .chain([awaited])
            .flat_map(|it| it.condition.measures())
        {
            if !measures.contains(&measure) {
                measures.push(measure);
            }
        }
        match measures.len() > MAX_MEASURES_OF_USER && !awaited.is_operator {
            true => Err(SwarmError::TooManyMeasuresOfUser {
                count: measures.len(),
                limit: MAX_MEASURES_OF_USER,
                user: user.to_string(),
            }),
            false => Ok(()),
        }
    }

    /// The number of earlier steps that the waits need, and `added` with them.
    fn lag(&self, added: Option<&Condition>, dt: f64) -> u64 {
        let waiting = self.waiting.iter().map(|it| &it.awaited.condition);
        waiting.chain(added).map(|it| it.lag(dt)).max().unwrap_or(0)
    }

    /// Reserves the memory of a past of so many steps of `n` individuals. Less is always admitted.
    fn reserve(&mut self, lag: u64, n: usize) -> Result<(), SwarmError> {
        let needed = match lag {
            0 => 0,
            lag => {
                let of_frame = n as u64 + FRAME_POSES;
                let earlier = lag.saturating_mul(of_frame).min(MAX_PAST);
                (earlier + of_frame) * BYTES_PER_POSE
            }
        };
        if needed != self.reserved {
            if let Some(reserve) = &self.reserve {
                reserve(needed)?;
            }
            self.reserved = needed;
        }
        Ok(())
    }

    /// Releases the memory of the past once nothing waits.
    fn release_if_unused(&mut self) {
        self.lag = None;
        if self.waiting.is_empty() {
            self.past = Past::default();
            let _ = self.reserve(0, 0);
        }
    }

    /// Stores the state before a step, if a measure needs it afterwards. Ends the newest waits for which a
    /// group that has grown is too large.
    pub fn record(&mut self, state: &State) {
        if self.is_empty() {
            return;
        }
        let (n, dt) = (state.configuration.n(), state.parameters.dt);
        if n != self.checked_for {
            self.checked_for = n;
            self.lag = None;
            self.end_what_is_too_large(state);
        }
        let lag = match self.lag {
            Some(lag) => lag,
            None => {
                let lag = self.lag(None, dt);
                let _ = self.reserve(lag, n);
                *self.lag.insert(lag)
            }
        };
        if lag > 0 || self.past.lag_steps() > 0 {
            self.past.observe_with(state, lag);
        }
    }

    fn end_what_is_too_large(&mut self, state: &State) {
        let waiting = std::mem::take(&mut self.waiting);
        for it in waiting {
            match self.check(&it.awaited.condition, state) {
                Ok(()) => self.waiting.push(it),
                Err(error) => reject(it.query, state.step, error),
            }
        }
    }

    /// Checks that a condition can wait beside those that do, and reserves the memory of its past.
    fn check(&mut self, condition: &Condition, state: &State) -> Result<(), SwarmError> {
        let n = state.configuration.n();
        for measure in condition.measures() {
            measure.check_size(n)?;
        }
        check_past(condition.lag(state.parameters.dt), n)?;
        let waiting = self.waiting.iter().map(|it| &it.awaited.condition);
        check_cost(waiting.chain([condition]).map(Condition::measures), n)?;
        let lag = self.lag(Some(condition), state.parameters.dt);
        self.reserve(lag, n)
    }

    /// The earlier states that its measures use.
    pub fn split(&mut self) -> (&Past, Observer<'_>) {
        (&self.past, Observer(&mut self.waiting))
    }

    /// Ends the waits at these indices, which ascend, with this state.
    pub fn settle(&mut self, holding: &[usize], state: &(Stamp, Arc<Frame>)) {
        for &index in holding.iter().rev() {
            let Waiting { awaited, query, .. } = self.waiting.remove(index);
            if let Some(query) = query {
                let (stamp, frame) = state.clone();
                query.reply_to.send(Ok((stamp, Outcome::State(frame))));
            }
            if self.settled.len() >= MAX_WAITS {
                self.settled.pop_front();
            }
            self.settled.push_back(Settled {
                awaited,
                at: Instant::now(),
                state: state.clone(),
            });
        }
        self.release_if_unused();
    }

    /// Ends all waits, and returns their queries.
    pub fn take_all(&mut self) -> Vec<ReplyTo> {
        let ended = self.waiting.drain(..);
        let queries = ended.filter_map(|it| it.query.map(|it| it.reply_to));
        let queries = queries.collect();
        self.release_if_unused();
        queries
    }

    /// Starts all waits again, since the swarm was reset.
    pub fn restart(&mut self) {
        self.past = Past::default();
        self.settled.clear();
        for waiting in &mut self.waiting {
            waiting.held = Held::default();
            waiting.first = 0;
        }
    }

    /// Ends the waits whose clients are gone, if that was last done a while ago.
    pub fn sweep_if_due(&mut self, now: Instant, step: u64) {
        let is_due = |swept: Instant| now.saturating_duration_since(swept) >= SWEEP_INTERVAL;
        let is_empty = self.waiting.is_empty() && self.settled.is_empty();
        if !is_empty && self.swept.is_none_or(is_due) {
            self.sweep(now, step);
        }
    }

    /// When the tokens are next looked at, if nothing happens before.
    pub fn due(&self) -> Option<Instant> {
        let is_empty = self.waiting.is_empty() && self.settled.is_empty();
        (!is_empty).then(|| self.swept.unwrap_or_else(Instant::now) + IDLE_SWEEP_INTERVAL)
    }

    fn sweep(&mut self, now: Instant, step: u64) {
        self.swept = Some(now);
        let has_lasted = |since: Instant, limit| now.saturating_duration_since(since) >= limit;
        let is_over = |it: &mut Waiting| {
            if it
                .query
                .as_ref()
                .is_some_and(|query| (query.is_abandoned)())
            {
                it.query = None;
                it.idle_since = Some(now);
            }
            let is_gone = it.awaited.holder.gone_since();
            is_gone.is_some_and(|since| has_lasted(since, GRACE))
                || it
                    .idle_since
                    .is_some_and(|since| has_lasted(since, MAX_IDLE))
        };
        self.settled.retain(|it| {
            let is_gone = it.awaited.holder.gone_since();
            !is_gone.is_some_and(|since| has_lasted(since, GRACE)) && !has_lasted(it.at, MAX_IDLE)
        });
        for ended in self.waiting.extract_if(.., is_over) {
            let key = ended.awaited.holder.key.clone();
            reject(ended.query, step, SwarmError::NotHeld(key));
        }
        self.release_if_unused();
    }

    /// The waits, for the status.
    pub fn summaries(&self) -> Vec<WaitSummary> {
        let summary = |it: &Waiting| WaitSummary {
            condition: it.awaited.condition.to_string(),
            user: it.awaited.user.clone(),
        };
        self.waiting.iter().map(summary).collect()
    }
}

/// Evaluates the conditions of waits.
pub struct Observer<'a>(&'a mut Vec<Waiting>);

impl Observer<'_> {
    /// Announces the measures.
    pub fn expect(&self, view: &View<'_>) {
        let conditions = self.0.iter().map(|it| &it.awaited.condition);
        conditions
            .flat_map(Condition::measures)
            .for_each(|it| it.announce(view));
    }

    /// Evaluates all conditions on a state, once for each step. Returns the indices of those that hold.
    pub fn observe(&mut self, view: &View<'_>) -> Vec<usize> {
        let (step, dt) = (view.state().step, view.state().parameters.dt);
        let mut holding = Vec::new();
        for (index, waiting) in self.0.iter_mut().enumerate() {
            view.ignore_before(waiting.first);
            let condition = &waiting.awaited.condition;
            if condition.observe(view, step, dt, &mut waiting.held) {
                holding.push(index);
            }
        }
        holding
    }
}

fn reject(query: Option<Query>, step: u64, error: SwarmError) {
    if let Some(query) = query {
        let step = Some(step);
        query.reply_to.send(Err(Rejection { step, error }));
    }
}
