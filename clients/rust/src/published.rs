//! What a swarm publishes, by key.

use std::future::pending;

use jostle_proto::{Event, OrderSample, State};
use serde::de::DeserializeOwned;

use crate::client::Subscription;
use crate::error::Error;
use crate::payload::Payload;

/// A message that a swarm publishes on a key.
pub(crate) trait Published: DeserializeOwned {
    fn swarm(&self) -> &str;

    /// Whether a message that cannot be decoded is one that is published on another key.
    fn is_of_another_key(payload: &Payload) -> bool;
}

impl Published for State {
    fn swarm(&self) -> &str {
        &self.swarm
    }

    fn is_of_another_key(payload: &Payload) -> bool {
        !payload.is_cbor()
    }
}

impl Published for OrderSample {
    fn swarm(&self) -> &str {
        &self.swarm
    }

    fn is_of_another_key(payload: &Payload) -> bool {
        payload.is_cbor() || payload.read::<Event>().is_ok()
    }
}

impl Published for Event {
    fn swarm(&self) -> &str {
        &self.swarm
    }

    fn is_of_another_key(payload: &Payload) -> bool {
        payload.is_cbor() || payload.read::<OrderSample>().is_ok()
    }
}

/// What a swarm publishes.
pub(crate) enum Publication {
    Event(Payload),
    State(Payload),
    Order(Payload),
}

/// The next publication; in random order, so that a frequent one does not starve the others.
pub(crate) async fn publication(
    events: &Subscription,
    states: Option<&Subscription>,
    order: Option<&Subscription>,
) -> Result<Publication, Error> {
    tokio::select! {
        event = events.next() => Ok(Publication::Event(event?)),
        state = next(states) => Ok(Publication::State(state?)),
        order = next(order) => Ok(Publication::Order(order?)),
    }
}

/// The next sample, never without a subscription.
async fn next(subscription: Option<&Subscription>) -> Result<Payload, Error> {
    match subscription {
        Some(subscription) => subscription.next().await,
        None => pending().await,
    }
}
