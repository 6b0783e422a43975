//! What tabs watch: the newest of each, held once however many tabs there are.
//!
//! A tab that does not read costs what its socket holds: the next frame replaces the last, and
//! events beyond a few dozen are counted and left to be asked for.

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

/// Events that a tab may be behind.
const EVENTS: usize = 64;

/// How often the list of swarms is looked at while a tab is open, and told though nothing changed.
const LIST_PERIOD: Duration = Duration::from_millis(500);
const LIST_TOLD: Duration = Duration::from_secs(1);

/// What is told of one swarm.
pub struct Feed {
    /// Its newest state, in CBOR; empty until there is one.
    pub states: watch::Sender<Bytes>,
    /// Its newest order, in JSON.
    pub orders: watch::Sender<Bytes>,
    /// Its events, in JSON.
    pub events: broadcast::Sender<Bytes>,
    subscribers: Option<Subscribers>,
}

/// The subscribers to state, order and events, and the session that declared them.
type Subscribers = ([Subscriber<()>; 3], Lease);

impl Drop for Feed {
    fn drop(&mut self) {
        // Letting go of what is declared may wait for other clients.
        if let Some(subscribers) = self.subscribers.take() {
            spawn_blocking(move || drop(subscribers));
        }
    }
}

/// The feeds that somebody watches.
pub struct Feeds {
    bus: Bus,
    watched: Mutex<HashMap<String, Weak<Feed>>>,
    /// The list of swarms, in JSON.
    pub list: watch::Sender<Bytes>,
}

impl Feeds {
    /// Starts to look at the list of swarms, while a tab is open.
    pub fn start(bus: Bus) -> Arc<Self> {
        let feeds = Arc::new(Feeds {
            bus,
            watched: Mutex::default(),
            list: watch::Sender::new(Bytes::new()),
        });
        tokio::spawn(list(Arc::downgrade(&feeds)));
        feeds
    }

    /// The feed of a swarm, and its state as it is now; none if there is no such swarm.
    pub async fn watch(&self, swarm: &str) -> Option<(Arc<Feed>, Bytes)> {
        let feed = self.feed(swarm).await?;
        // After the subscription, so that nothing falls between.
        let state = self
            .bus
            .ask(&format!("{swarm}/state"), "", None, None)
            .await;
        Some((feed, state.ok()?.ok()?))
    }

    async fn feed(&self, swarm: &str) -> Option<Arc<Feed>> {
        if let Some(feed) = self.lock().get(swarm).and_then(Weak::upgrade) {
            return Some(feed);
        }
        let (states, orders) = (
            watch::Sender::new(Bytes::new()),
            watch::Sender::new(Bytes::new()),
        );
        let events = broadcast::Sender::new(EVENTS);
        let pool = self.bus.pool.clone();
        let of = |key: fn(&str, &str) -> String| key(&self.bus.prefix, swarm);
        let [state, order, event] = [of(keys::state), of(keys::order), of(keys::event)];
        let (told, to) = (events.clone(), [states.clone(), orders.clone()]);
        let declaring = move || {
            let session = pool.lease()?;
            let newest = |key: String, sender: watch::Sender<Bytes>| {
                let declared = session.declare_subscriber(key).callback(move |sample| {
                    sender.send_replace(Bytes::from(sample.payload().to_bytes().into_owned()));
                });
                declared.wait()
            };
            let each = session.declare_subscriber(event).callback(move |sample| {
                // Nobody may be listening.
                let _ = told.send(Bytes::from(sample.payload().to_bytes().into_owned()));
            });
            let [states, orders] = to;
            let subscribers = [newest(state, states)?, newest(order, orders)?, each.wait()?];
            zenoh::Result::Ok((subscribers, session))
        };
        // zenoh blocks the thread that declares while it removes what a session has declared.
        let subscribers = spawn_blocking(declaring).await.ok()?;
        let subscribers =
            subscribers.inspect_err(|error| debug!(swarm, %error, "failed to watch for the page"));
        let feed = Arc::new(Feed {
            states,
            orders,
            events,
            subscribers: Some(subscribers.ok()?),
        });
        let mut watched = self.lock();
        watched.retain(|_, feed| feed.strong_count() > 0);
        // Another tab may have been quicker.
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

/// Tells the list when it has changed, and now and then as a sign of life.
async fn list(feeds: Weak<Feeds>) {
    let mut tick = interval(LIST_PERIOD);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut told = Instant::now();
    loop {
        tick.tick().await;
        let Some(feeds) = feeds.upgrade() else {
            return;
        };
        if feeds.list.receiver_count() == 0 {
            continue;
        }
        let answer = feeds.bus.ask("@node/get/swarms", "", None, None).await;
        let Some(document) = answer.ok().and_then(|answer| answer.ok()) else {
            continue;
        };
        let is_new = *feeds.list.borrow() != document;
        if is_new || told.elapsed() >= LIST_TOLD {
            feeds.list.send_replace(document);
            told = Instant::now();
        }
    }
}
