//! Follows a swarm: one stream of its states, order samples and events, through lost connections
//! and restarts of the daemon.

use std::collections::VecDeque;
use std::fmt;
use std::future::{pending, poll_fn};
use std::pin::Pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use futures_util::stream::unfold;
use futures_util::{Stream, StreamExt};
use jostle_proto::{Event, EventKind, Events, OrderSample, Reply, State, Status, keys};
use serde::Deserialize;
use serde_json::value::RawValue;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval, sleep_until};
use zenoh::sample::{Sample, SampleKind};

use crate::client::{Client, Subscription, Target};
use crate::discovery::node_of;
use crate::error::Error;
use crate::payload::{Message, Payload};
use crate::presence::{Change, Presence};
use crate::published::{Publication, Published, publication};
use crate::retry::Delays;

/// The queue of events. Events that are dropped are queried again.
const EVENT_CAPACITY: usize = 64;
/// The interval of the queries for a lost event that no later event reveals.
const EVENT_POLL_INTERVAL: Duration = Duration::from_secs(5);

/// What to follow; by default only whether the swarm is reachable.
#[derive(Clone, Copy, Debug, Default)]
pub struct FollowOptions {
    /// Yield the status first and after each interruption, since a paused swarm publishes nothing.
    pub status: bool,
    /// Yield states, first the present one. The queue holds this many and drops the oldest.
    pub states: Option<usize>,
    /// Yield order samples. The queue holds this many and drops the oldest.
    pub order: Option<usize>,
    /// Yield events, without gaps.
    pub events: Option<EventsFrom>,
}

/// The first event to yield.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventsFrom {
    /// The next one.
    Now,
    /// The one after this number, or the oldest that the daemon still stores.
    After(u64),
}

/// An update of a followed swarm.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Update {
    /// Its status.
    Status(Box<Reply<Status>>),
    /// A state.
    State(Box<Message<State>>),
    /// An order sample.
    Order(Box<Message<OrderSample>>),
    /// An event.
    Event(Box<Message<Event>>),
    /// The daemon is unreachable. The stream continues and waits for it.
    Away,
    /// The daemon and the swarm are reachable again. The present status and state, if they are
    /// followed, and the events of the meantime are next.
    Back,
    /// The swarm is in a later epoch than before the interruption: the daemon recovered it, or a
    /// client reset it. Its step may be lower.
    Restarted {
        /// The epoch.
        epoch: u64,
    },
    /// The swarm was deleted. The last update.
    Deleted,
}

/// The updates of a swarm, as a [`Stream`]. The stream ends after [`Update::Deleted`] or
/// [`Error::NotRecovered`], not after another error.
pub struct Follow(Pin<Box<dyn Stream<Item = Result<Update, Error>> + Send>>);

impl Follow {
    /// The next update, `None` after the last.
    ///
    /// Cancel safety: no update is lost; the next call returns it.
    pub async fn next(&mut self) -> Option<Result<Update, Error>> {
        poll_fn(|context| self.0.as_mut().poll_next(context)).await
    }

    /// The next update if there is one already. Updates that [`Client::follow`] has queried are
    /// available at once.
    pub fn try_next(&mut self) -> Option<Result<Update, Error>> {
        match self
            .0
            .as_mut()
            .poll_next(&mut Context::from_waker(Waker::noop()))
        {
            Poll::Ready(update) => update,
            Poll::Pending => None,
        }
    }
}

impl Stream for Follow {
    type Item = Result<Update, Error>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.0.as_mut().poll_next(context)
    }
}

impl fmt::Debug for Follow {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Follow").finish_non_exhaustive()
    }
}

impl Client {
    /// Follows a swarm until it is deleted.
    ///
    /// Cancel safety: the subscriptions end; call it again.
    ///
    /// # Errors
    ///
    /// [`Error::NoSwarm`] if there is no such swarm; as [`Client::get`], if it is not reachable or the
    /// options require a query. Items of the stream are
    /// [`Error::NotRecovered`] if the daemon came back without the swarm, [`Error::Decode`] for an
    /// undecodable message, or the error of a query for missed events that a retry cannot resolve.
    pub async fn follow(&self, swarm: &str, options: FollowOptions) -> Result<Follow, Error> {
        let prefix = self.prefix();
        // Subscribes before the queries of `refresh`, so that no sample is missed in between.
        let mut follower = Follower {
            states: self
                .subscribe_if(&keys::state(prefix, swarm), options.states)
                .await?,
            order: self
                .subscribe_if(&keys::order(prefix, swarm), options.order)
                .await?,
            events: self
                .subscribe(&keys::event(prefix, swarm), EVENT_CAPACITY)
                .await?,
            swarm_tokens: self
                .subscribe_tokens(&keys::alive(prefix, swarm, "*"))
                .await?,
            node_tokens: self
                .subscribe_tokens(&keys::node_alive(prefix, "*"))
                .await?,
            client: self.clone(),
            swarm: swarm.to_owned(),
            options,
            presence: Presence::Present,
            node: None,
            connections_lost: self.connections_lost(),
            epoch: 0,
            epoch_before: None,
            last_event: match options.events {
                Some(EventsFrom::After(number)) => Some(number),
                _ => None,
            },
            has_events: false,
            poll: interval(EVENT_POLL_INTERVAL),
            updates: VecDeque::new(),
            refresh_at: None,
            delays: Delays::default(),
            is_over: false,
        };
        follower
            .poll
            .set_missed_tick_behavior(MissedTickBehavior::Delay);
        follower.poll.tick().await;
        // The subscribers have received the tokens that exist once this query has its replies. The end
        // of a token that was not received would not be reported.
        let hosts = self.tokens(&keys::alive(prefix, swarm, "*")).await;
        let sends_a_query =
            options.status || options.states.is_some() || follower.last_event.is_some();
        if !sends_a_query && hosts.as_ref().is_ok_and(Vec::is_empty) {
            // Nothing would be received: the error says why, unless the swarm begins now.
            self.status(swarm).await?;
        }
        tolerate(hosts.map(drop))?;
        follower.refresh(self.0.timeout).await?;
        let updates = unfold(follower, |mut follower| async move {
            let update = follower.next().await.transpose()?;
            Some((update, follower))
        });
        Ok(Follow(Box::pin(updates.fuse())))
    }

    /// The events of a swarm with numbers above `after` that the daemon still stores, oldest first.
    ///
    /// Cancel safety: a dropped query changes nothing.
    ///
    /// # Errors
    ///
    /// As [`Client::get`], and [`Error::Decode`].
    pub async fn events(&self, swarm: &str, after: u64) -> Result<Vec<Message<Event>>, Error> {
        let failing = self.0.timeout;
        Ok(self.events_and_newest(swarm, after, failing).await?.0)
    }

    /// As [`Client::events`], with the number of the newest event. Gives up after `failing`.
    async fn events_and_newest(
        &self,
        swarm: &str,
        mut after: u64,
        failing: Duration,
    ) -> Result<(Vec<Message<Event>>, u64), Error> {
        /// Events as received, with fields that this version does not know.
        #[derive(Deserialize)]
        struct Raw {
            events: Vec<Box<RawValue>>,
        }

        let mut all: Vec<Message<Event>> = Vec::new();
        loop {
            let noun = format!("events?after={after};limit=1000");
            let (key, target) = (
                keys::get(&self.0.prefix, swarm, &noun),
                Target::Swarm(swarm),
            );
            let timeout = self.0.timeout;
            let query = self.query_within(target, &key, None, timeout, failing);
            let payload = query.await?;
            let page = payload.read::<Reply<Events>>()?.result;
            let raw: Reply<Raw> = payload.read()?;
            for (value, raw) in page.events.into_iter().zip(raw.result.events) {
                let payload = Payload::of_json(raw.get());
                all.push(Message { value, payload });
            }
            match all.last() {
                Some(last) if after < last.number && last.number < page.newest => {
                    after = last.number;
                }
                _ => return Ok((all, page.newest)),
            }
        }
    }

    async fn subscribe_if(
        &self,
        key: &str,
        capacity: Option<usize>,
    ) -> Result<Option<Subscription>, Error> {
        match capacity {
            Some(capacity) => self.subscribe(key, capacity).await.map(Some),
            None => Ok(None),
        }
    }
}

struct Follower {
    client: Client,
    swarm: String,
    options: FollowOptions,
    states: Option<Subscription>,
    order: Option<Subscription>,
    events: Subscription,
    swarm_tokens: Subscription,
    node_tokens: Subscription,
    presence: Presence,
    /// The daemon that hosts the swarm, once its token is known.
    node: Option<String>,
    /// The number of connections lost before the last refresh.
    connections_lost: u64,
    /// The latest epoch of a message, 0 before the first.
    epoch: u64,
    /// That epoch when the swarm's token disappeared, until a refresh after that.
    epoch_before: Option<u64>,
    last_event: Option<u64>,
    /// Whether an event was yielded.
    has_events: bool,
    poll: Interval,
    updates: VecDeque<Update>,
    /// When to refresh, after an interruption or a query that failed.
    refresh_at: Option<Instant>,
    /// The delays before a refresh is repeated.
    delays: Delays,
    is_over: bool,
}

impl Follower {
    async fn next(&mut self) -> Result<Option<Update>, Error> {
        loop {
            if let Some(update) = self.updates.pop_front() {
                return Ok(Some(update));
            }
            if self.is_over {
                return Ok(None);
            }
            tokio::select! {
                // Tokens first: they show that what is received next follows an interruption.
                biased;
                token = self.swarm_tokens.sample() => self.swarm_token(&token?),
                token = self.node_tokens.sample() => self.node_token(&token?),
                () = reach(self.presence.deadline()) => self.judge().await?,
                () = reach(self.refresh_at), if self.presence == Presence::Present => {
                    let outcome = self.refresh(Duration::ZERO).await;
                    self.refresh_later_after(outcome)?;
                }
                _ = self.poll.tick(), if self.presence == Presence::Present => {
                    let outcome = self.query_events(Duration::ZERO).await;
                    self.refresh_later_after(outcome)?;
                }
                // While it is away they wait for its token: what follows an interruption follows `Back`.
                received = publication(&self.events, self.states.as_ref(), self.order.as_ref()),
                    if !self.presence.is_away() =>
                {
                    match received? {
                        Publication::Event(event) => self.event(event).await?,
                        Publication::State(state) => self.received_state(state)?,
                        Publication::Order(order) => self.order(order)?,
                    }
                }
            }
        }
    }

    /// Schedules a refresh if a query failed for a reason that may pass.
    fn refresh_later_after(&mut self, outcome: Result<(), Error>) -> Result<(), Error> {
        match outcome {
            Ok(()) => {
                self.delays = Delays::default();
                Ok(())
            }
            Err(error) if may_pass(&error) => {
                self.refresh_at = Some(Instant::now() + self.delays.next());
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    /// Queries what a paused swarm does not publish, and the missed events; each query may fail for so
    /// long. After the first refresh none is repeated here: the tokens of an interruption would not be
    /// received meanwhile, and the reply of a restarted daemon would precede them.
    async fn refresh(&mut self, failing: Duration) -> Result<(), Error> {
        self.refresh_at = None;
        let connections_lost = self.client.connections_lost();
        if self.options.status {
            let key = keys::get(self.client.prefix(), &self.swarm, "status");
            let status: Reply<Status> = self.query(&key, failing).await?.read()?;
            self.see_epoch(status.epoch);
            self.updates.push_back(Update::Status(Box::new(status)));
        }
        if self.options.states.is_some() {
            let key = keys::state(self.client.prefix(), &self.swarm);
            let state = self.query(&key, failing).await?;
            self.state(state.try_into()?);
        }
        self.query_events(failing).await?;
        self.connections_lost = connections_lost;
        self.epoch_before = None;
        Ok(())
    }

    async fn query(&self, key: &str, failing: Duration) -> Result<Payload, Error> {
        let (target, timeout) = (Target::Swarm(&self.swarm), self.client.0.timeout);
        let query = self
            .client
            .query_within(target, key, None, timeout, failing);
        query.await
    }

    /// Notes the epoch of a message.
    fn see_epoch(&mut self, epoch: u64) {
        if self.epoch_before.is_some_and(|before| before < epoch) {
            self.epoch_before = None;
            self.updates.push_back(Update::Restarted { epoch });
        }
        self.epoch = self.epoch.max(epoch);
    }

    /// Decodes a message that was published. `None` if it belongs on another key: after a connection was
    /// restored, zenoh 1.10 sometimes delivers a message under the key of another subscription. What
    /// belongs on this key may then have gone elsewhere, so that it is queried, as after an interruption.
    fn decode<T: Published>(&mut self, payload: Payload) -> Result<Option<Message<T>>, Error> {
        match payload.read::<T>() {
            Ok(value) if value.swarm() == self.swarm => {
                return Ok(Some(Message { value, payload }));
            }
            Err(error) if !T::is_of_another_key(&payload) => return Err(error),
            Ok(_) | Err(_) => {}
        }
        if self.refresh_at.is_none() {
            self.refresh_at = Some(Instant::now() + self.delays.next());
        }
        Ok(None)
    }

    fn state(&mut self, state: Message<State>) {
        self.see_epoch(state.epoch);
        self.updates.push_back(Update::State(Box::new(state)));
    }

    fn received_state(&mut self, payload: Payload) -> Result<(), Error> {
        if let Some(state) = self.decode(payload)? {
            self.state(state);
        }
        Ok(())
    }

    fn order(&mut self, payload: Payload) -> Result<(), Error> {
        let Some(order) = self.decode::<OrderSample>(payload)? else {
            return Ok(());
        };
        self.see_epoch(order.epoch);
        self.updates.push_back(Update::Order(Box::new(order)));
        Ok(())
    }

    async fn event(&mut self, payload: Payload) -> Result<(), Error> {
        if self.options.events.is_none() {
            let is_deleted =
                |it: Event| it.swarm == self.swarm && matches!(it.event, EventKind::Deleted { .. });
            if payload.read().is_ok_and(is_deleted) {
                self.finish()?;
            }
            return Ok(());
        }
        let Some(event) = self.decode::<Event>(payload)? else {
            return Ok(());
        };
        let is_last = matches!(event.event, EventKind::Deleted { .. });
        if self.last_event.is_some_and(|last| event.number > last + 1) {
            match self.query_events(Duration::ZERO).await {
                // The refresh yields it, and those before it.
                Err(error) if may_pass(&error) && !is_last => {
                    return self.refresh_later_after(Err(error));
                }
                outcome => tolerate(outcome)?,
            }
        }
        if self.last_event.is_none_or(|last| event.number > last) {
            self.push_event(event);
        }
        if is_last {
            self.finish()?;
        }
        Ok(())
    }

    fn push_event(&mut self, event: Message<Event>) {
        self.see_epoch(event.epoch);
        self.last_event = Some(event.number);
        self.has_events = true;
        self.updates.push_back(Update::Event(Box::new(event)));
    }

    /// Queries the events after the last one, if that is known. Gives up after `failing`.
    async fn query_events(&mut self, failing: Duration) -> Result<(), Error> {
        let Some(last) = self.last_event else {
            return Ok(());
        };
        let query = self.client.events_and_newest(&self.swarm, last, failing);
        let (mut events, newest) = query.await?;
        if newest < last && self.has_events {
            // Another swarm of the same name, whose events are numbered from 1.
            let query = self.client.events_and_newest(&self.swarm, 0, failing);
            events = query.await?.0;
        }
        events.into_iter().for_each(|event| self.push_event(event));
        Ok(())
    }

    fn swarm_token(&mut self, token: &Sample) {
        let is_alive = token.kind() == SampleKind::Put;
        if is_alive {
            self.node = node_of(self.client.prefix(), token.key_expr().as_str());
        } else {
            self.epoch_before = (self.epoch > 0).then_some(self.epoch);
        }
        let was_missing = matches!(self.presence, Presence::Missing { .. });
        let change = self.presence.swarm_token(is_alive, Instant::now());
        if change == Some(Change::Back) {
            self.updates.push_back(Update::Back);
        }
        // A connection may also be lost and restored before its tokens are received.
        let is_interrupted = self.connections_lost != self.client.connections_lost();
        if was_missing && is_alive && is_interrupted {
            self.updates.extend([Update::Away, Update::Back]);
        }
        if change == Some(Change::Back) || is_alive && is_interrupted {
            self.delays = Delays::default();
            self.refresh_at = Some(Instant::now());
        }
    }

    fn node_token(&mut self, token: &Sample) {
        let node = node_of(self.client.prefix(), token.key_expr().as_str());
        if node.is_some_and(|node| self.is_its_node(&node)) {
            let is_alive = token.kind() == SampleKind::Put;
            self.presence.node_token(is_alive, Instant::now());
        }
    }

    /// Decides whether a swarm whose token disappeared is away, was deleted or not recovered.
    async fn judge(&mut self) -> Result<(), Error> {
        let nodes = match self.client.nodes().await {
            // The deadline has passed, so that this is asked again.
            Err(Error::TimedOut { .. }) => return Ok(()),
            nodes => nodes?,
        };
        let is_node_there = nodes.iter().any(|node| self.is_its_node(node));
        let is_missing = matches!(self.presence, Presence::Missing { .. });
        // The connection was lost with the token, and is back before that was noticed.
        let is_interrupted = self.connections_lost != self.client.connections_lost();
        let is_back = is_missing && is_interrupted && is_node_there;
        match self.presence.judge(is_node_there && !is_back) {
            Some(Change::Away) => {
                self.updates.push_back(Update::Away);
                if is_back {
                    self.presence.node_token(true, Instant::now());
                }
            }
            Some(Change::Deleted) => self.finish()?,
            Some(Change::NotRecovered) => {
                self.is_over = true;
                let swarm = self.swarm.clone();
                return Err(Error::NotRecovered { swarm });
            }
            Some(Change::Back) | None => {}
        }
        Ok(())
    }

    /// Whether a daemon hosts the swarm; true for every daemon until the host is known.
    fn is_its_node(&self, node: &str) -> bool {
        self.node.as_deref().is_none_or(|known| known == node)
    }

    /// Yields what was received before the deletion, and the deletion.
    fn finish(&mut self) -> Result<(), Error> {
        while let Some(state) = self.states.as_ref().and_then(Subscription::try_next) {
            self.received_state(state)?;
        }
        while let Some(order) = self.order.as_ref().and_then(Subscription::try_next) {
            self.order(order)?;
        }
        self.updates.push_back(Update::Deleted);
        self.is_over = true;
        Ok(())
    }
}

/// Whether a query may have failed because of an interruption.
fn may_pass(error: &Error) -> bool {
    error.is_transient() || error.is_not_found()
}

/// Ignores the error of a query that failed because of an interruption: the tokens report it.
fn tolerate(outcome: Result<(), Error>) -> Result<(), Error> {
    outcome.or_else(|error| match may_pass(&error) {
        true => Ok(()),
        false => Err(error),
    })
}

/// Completes at `deadline`, never without one.
async fn reach(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => sleep_until(deadline).await,
        None => pending().await,
    }
}
