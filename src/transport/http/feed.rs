//! Subscriptions for the tabs, shared by all tabs that watch the same swarm.
//!
//! A slow tab uses no further memory: a newer state replaces an unread one, and events beyond
//! [`EVENT_CAPACITY`] are dropped and counted; the page queries them.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

use axum::body::Bytes;
use jostle_proto::keys;
use tokio::sync::{broadcast, watch};
use tokio::task::spawn_blocking;
use tokio::time::{Instant, MissedTickBehavior, interval};
use tracing::debug;
use zenoh::Wait;
use zenoh::pubsub::Subscriber;

use crate::transport::http::bus::Bus;
use crate::transport::zenoh::session_pool::Lease;

/// Events that are queued for a tab.
const EVENT_CAPACITY: usize = 64;

/// The interval between queries of the list of swarms while a tab is open, and the longest interval
/// between sending it, as a heartbeat.
const LIST_INTERVAL: Duration = Duration::from_millis(500);
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);

/// The messages of one swarm.
pub struct Feed {
    /// Its newest state, in CBOR; empty before the first.
    pub states: watch::Sender<Bytes>,
    /// Its newest order, in JSON.
    pub orders: watch::Sender<Bytes>,
    /// Its events, in JSON.
    pub events: broadcast::Sender<Bytes>,
    subscribers: Option<Subscribers>,
}

/// The subscribers to states, orders and events, and the session that declared them.
type Subscribers = ([Subscriber<()>; 3], Lease);

impl Drop for Feed {
    fn drop(&mut self) {
        // Undeclaring may block on other clients.
        if let Some(subscribers) = self.subscribers.take() {
            spawn_blocking(move || drop(subscribers));
        }
    }
}

/// The feeds with at least one tab.
pub struct Feeds {
    bus: Bus,
    watched: Mutex<HashMap<String, Weak<Feed>>>,
    /// The list of swarms, in JSON; empty while no tab is open.
    pub list: watch::Sender<Bytes>,
}

impl Feeds {
    /// Starts the task that queries the list of swarms while a tab is open.
    pub fn start(bus: Bus) -> Arc<Self> {
        let feeds = Arc::new(Feeds {
            bus,
            watched: Mutex::default(),
            list: watch::Sender::new(Bytes::new()),
        });
        tokio::spawn(list(Arc::downgrade(&feeds)));
        feeds
    }

    /// The feed of a swarm and its current state; `None` if there is no such swarm.
    pub async fn watch(&self, swarm: &str) -> Option<(Arc<Feed>, Bytes)> {
        let feed = self.feed(swarm).await?;
        // Queried after the subscription, so that no state is missed.
        let state = self
            .bus
            .query(&format!("{swarm}/state"), "", None, None)
            .await;
        Some((feed, state.ok()?.ok()?))
    }

    /// Queries the list of swarms, and sends it if it has changed or `is_due`. Returns `None` if it was
    /// not sent.
    pub async fn refresh(&self, is_due: bool) -> Option<()> {
        let reply = self.bus.query("@node/get/swarms", "", None, None).await;
        let document = reply.ok()?.ok()?;
        let is_new = *self.list.borrow() != document;
        (is_new || is_due).then(|| drop(self.list.send_replace(document)))
    }

    async fn feed(&self, swarm: &str) -> Option<Arc<Feed>> {
        if let Some(feed) = self.lock().get(swarm).and_then(Weak::upgrade) {
            return Some(feed);
        }
        let (states, orders) = (
            watch::Sender::new(Bytes::new()),
            watch::Sender::new(Bytes::new()),
        );
        let events = broadcast::Sender::new(EVENT_CAPACITY);
        let pool = self.bus.pool.clone();
        let of = |key: fn(&str, &str) -> String| key(&self.bus.prefix, swarm);
        let [state, order, event] = [of(keys::state), of(keys::order), of(keys::event)];
        let (sender, newest_of) = (events.clone(), [states.clone(), orders.clone()]);
        let declaring = move || {
            let session = pool.lease()?;
            let newest = |key: String, sender: watch::Sender<Bytes>| {
                let declared = session.declare_subscriber(key).callback(move |sample| {
                    sender.send_replace(Bytes::from(sample.payload().to_bytes().into_owned()));
                });
                declared.wait()
            };
            let each = session.declare_subscriber(event).callback(move |sample| {
                // There may be no receiver.
                let _ = sender.send(Bytes::from(sample.payload().to_bytes().into_owned()));
            });
            let [states, orders] = newest_of;
            let subscribers = [newest(state, states)?, newest(order, orders)?, each.wait()?];
            zenoh::Result::Ok((subscribers, session))
        };
        // zenoh blocks the thread that declares while it removes what a session has declared.
        let subscribers = spawn_blocking(declaring).await.ok()?;
        let subscribers = subscribers
            .inspect_err(|error| debug!(swarm, %error, "failed to subscribe for the page"));
        let feed = Arc::new(Feed {
            states,
            orders,
            events,
            subscribers: Some(subscribers.ok()?),
        });
        let mut watched = self.lock();
        watched.retain(|_, feed| feed.strong_count() > 0);
        // Another tab may have inserted one meanwhile.
        if let Some(feed) = watched.get(swarm).and_then(Weak::upgrade) {
            return Some(feed);
        }
        watched.insert(swarm.to_owned(), Arc::downgrade(&feed));
        Some(feed)
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, HashMap<String, Weak<Feed>>> {
        self.watched.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Sends the list when it has changed, and as a heartbeat.
async fn list(feeds: Weak<Feeds>) {
    let mut tick = interval(LIST_INTERVAL);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut sent = Instant::now();
    loop {
        tick.tick().await;
        let Some(feeds) = feeds.upgrade() else {
            return;
        };
        if feeds.list.receiver_count() == 0 {
            // The next tab must not receive an old list.
            feeds.list.send_replace(Bytes::new());
            continue;
        }
        let is_due = sent.elapsed() >= HEARTBEAT_INTERVAL;
        if feeds.refresh(is_due).await.is_some() {
            sent = Instant::now();
        }
    }
}
