//! Follows one swarm: its states as they come, and what they do not tell.

use std::sync::Arc;
use std::time::Duration;

use jostle_proto::{Events, Reply, State, Status, keys};
use tokio::time::{interval, sleep};
use zenoh::sample::Sample;

use super::mailbox::Mailbox;
use super::view::Message;
use crate::bus::{Answer, Bus, Samples};
use crate::failure::Failure;

/// How many events may wait to be looked at.
const BACKLOG: usize = 64;
/// The least time between two states: more would not be drawn.
const BETWEEN_STATES: Duration = Duration::from_millis(50);
/// How often is asked what no event tells, or might have told and was lost.
const BETWEEN_LOOKS: Duration = Duration::from_secs(5);
/// How many past events are worth showing.
const PAST: u64 = 20;

/// Posts how a swarm is until nobody wants to know; who is gone is said by the list.
pub async fn follow(bus: Arc<Bus>, mailbox: Arc<Mailbox>, swarm: String) {
    let follower = Follower {
        bus,
        mailbox,
        swarm,
    };
    if let Err(failure) = follower.follow().await {
        follower.post(Message::Trouble(failure.to_string()));
    }
}

struct Follower {
    bus: Arc<Bus>,
    mailbox: Arc<Mailbox>,
    swarm: String,
}

impl Follower {
    /// Subscribes first and looks then, so that nothing falls in between.
    async fn follow(&self) -> Result<(), Failure> {
        let (bus, prefix) = (&self.bus, self.bus.prefix());
        let states = bus.subscribe(&keys::state(prefix, &self.swarm), 1).await?;
        let key = keys::event(prefix, &self.swarm);
        let events: Samples = bus.subscribe(&key, BACKLOG).await?;
        let mut looks = interval(BETWEEN_LOOKS);
        loop {
            tokio::select! {
                biased;
                event = events.recv_async() => {
                    let mut received = vec![event.map_err(Failure::defect)?];
                    while let Ok(Some(event)) = events.try_recv() {
                        received.push(event);
                    }
                    // A newer daemon may tell of what this version does not know.
                    let read = received.iter().filter_map(|it| Answer::from(it).read().ok());
                    self.post(Message::Events(read.collect()));
                    self.look(false).await;
                    // Whoever steers it at every step must not hide its states.
                    if let Ok(Some(state)) = states.try_recv() {
                        self.post_state(&state)?;
                    }
                    sleep(BETWEEN_STATES).await;
                }
                state = states.recv_async() => {
                    self.post_state(&state.map_err(Failure::defect)?)?;
                    sleep(BETWEEN_STATES).await;
                }
                _ = looks.tick() => self.look(true).await,
            }
        }
    }

    /// Asks how it is, because one that stands still publishes nothing. What fails passes, or the
    /// list tells.
    async fn look(&self, is_thorough: bool) {
        if let Ok(status) = self.ask::<Reply<Status>>("status").await {
            self.post(Message::Status(Box::new(status)));
        }
        if !is_thorough {
            return;
        }
        let state = self.bus.state(&self.swarm).await;
        if let Ok(state) = state.and_then(|answer| answer.read()) {
            self.post(Message::State(Box::new(state)));
        }
        // Every answer has the newest number; the newest events are those after one before it.
        let asked = async {
            let reply: Reply<Events> = self.ask("events?after=0;limit=1").await?;
            let after = reply.result.newest.saturating_sub(PAST);
            self.ask::<Reply<Events>>(&format!("events?after={after}"))
                .await
        };
        if let Ok(reply) = asked.await {
            self.post(Message::Events(reply.result.events));
        }
    }

    fn post_state(&self, sample: &Sample) -> Result<(), Failure> {
        let state: State = Answer::from(sample).read()?;
        self.post(Message::State(Box::new(state)));
        Ok(())
    }

    async fn ask<T: serde::de::DeserializeOwned>(&self, noun: &str) -> Result<T, Failure> {
        self.bus.get(&self.swarm, noun).await?.read()
    }

    fn post(&self, message: Message) {
        self.mailbox.post(message);
    }
}
