//! Subscriptions for the tabs, shared by all tabs that watch the same swarm.
//!
//! A slow tab uses no further memory: a newer state replaces an unread one, and events beyond
//! [`EVENT_CAPACITY`] are dropped and counted; the page queries them.

use std::collections::HashMap;
use std::sync::{Arc, Weak};
use std::time::Duration;

use axum::extract::ws::Message;
use jostle_proto::keys;
use parking_lot::Mutex;
use serde_json::value::RawValue;
use tokio::sync::{broadcast, watch};
use tokio::task::spawn_blocking;
use tokio::time::{Instant, MissedTickBehavior, interval};
use tracing::debug;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Subscriber;
use zenoh::{Session, Wait};

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
    /// Its newest state.
    pub states: watch::Sender<Option<Message>>,
    /// Its newest order.
    pub orders: watch::Sender<Option<Message>>,
    /// Its events, each with whether it is the last: the swarm is deleted.
    pub events: broadcast::Sender<(Message, bool)>,
    /// The subscribers to states, orders and events, and the session that declared them.
    subscribers: Option<([Subscriber<()>; 3], Lease)>,
}

impl Feed {
    /// Subscribes to a swarm. This may block: while zenoh undeclares the keys of a session, it blocks
    /// every thread that declares one.
    fn subscribe(bus: &Bus, swarm: &str) -> zenoh::Result<Self> {
        let session = bus.pool.lease()?;
        let (states, orders) = (watch::Sender::default(), watch::Sender::default());
        let events = broadcast::Sender::new(EVENT_CAPACITY);
        let (state, order, event) = (states.clone(), orders.clone(), events.clone());
        let on_state = move |payload: &ZBytes| {
            let bytes = payload.to_bytes().into_owned();
            state.send_replace(Some(Message::Binary(bytes.into())));
        };
        let on_order = move |payload: &ZBytes| {
            if let Ok(document) = payload.try_to_string() {
                order.send_replace(Some(wrapped("order", &document)));
            }
        };
        let on_event = move |payload: &ZBytes| {
            if let Ok(document) = payload.try_to_string() {
                let kind = field(&document, "event").and_then(|event| field(event, "kind"));
                let is_last = kind == Some("\"deleted\"");
                // There may be no receiver.
                let _ = event.send((wrapped("event", &document), is_last));
            }
        };
        let prefix = &bus.prefix;
        let subscribers = [
            subscriber(&session, keys::state(prefix, swarm), on_state)?,
            subscriber(&session, keys::order(prefix, swarm), on_order)?,
            subscriber(&session, keys::event(prefix, swarm), on_event)?,
        ];
        Ok(Feed {
            states,
            orders,
            events,
            subscribers: Some((subscribers, session)),
        })
    }
}

fn subscriber(
    session: &Session,
    key: String,
    on_sample: impl Fn(&ZBytes) + Send + Sync + 'static,
) -> zenoh::Result<Subscriber<()>> {
    let declared = session.declare_subscriber(key);
    let declared = declared.callback(move |sample| on_sample(sample.payload()));
    declared.wait()
}

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
    /// The list of swarms; `None` while no tab is open.
    pub list: watch::Sender<Option<Message>>,
}

impl Feeds {
    /// Starts the task that queries the list of swarms while a tab is open.
    pub fn start(bus: Bus) -> Arc<Self> {
        let feeds = Arc::new(Feeds {
            bus,
            watched: Mutex::default(),
            list: watch::Sender::default(),
        });
        tokio::spawn(list(Arc::downgrade(&feeds)));
        feeds
    }

    /// The feed of a swarm and its current state; `None` if there is no such swarm.
    pub async fn watch(&self, swarm: &str) -> Option<(Arc<Feed>, Message)> {
        let feed = self.feed(swarm).await?;
        // Queried after the subscription, so that no state is missed.
        let key = format!("{swarm}/state");
        let state = self.bus.query(&key, "", None, None).await.ok()?.ok()?;
        Some((feed, Message::Binary(state)))
    }

    /// Queries the list of swarms, and sends it if it has changed or `is_due`. Returns `None` if it was
    /// not sent.
    pub async fn refresh(&self, is_due: bool) -> Option<()> {
        let reply = self.bus.query("@node/get/swarms", "", None, None).await;
        let document = reply.ok()?.ok()?;
        let result = field(std::str::from_utf8(&document).ok()?, "result")?;
        let list = Some(wrapped("swarms", field(result, "swarms")?));
        let is_new = *self.list.borrow() != list;
        (is_new || is_due).then(|| drop(self.list.send_replace(list)))
    }

    async fn feed(&self, swarm: &str) -> Option<Arc<Feed>> {
        if let Some(feed) = self.watched.lock().get(swarm).and_then(Weak::upgrade) {
            return Some(feed);
        }
        let (bus, name) = (self.bus.clone(), swarm.to_owned());
        let subscribed = spawn_blocking(move || Feed::subscribe(&bus, &name)).await;
        let subscribed = subscribed.ok()?.inspect_err(|error| {
            debug!(swarm, %error, "failed to subscribe for the page");
        });
        let feed = Arc::new(subscribed.ok()?);
        let mut watched = self.watched.lock();
        watched.retain(|_, feed| feed.strong_count() > 0);
        // Another tab may have inserted one meanwhile.
        if let Some(feed) = watched.get(swarm).and_then(Weak::upgrade) {
            return Some(feed);
        }
        watched.insert(swarm.to_owned(), Arc::downgrade(&feed));
        Some(feed)
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
            feeds.list.send_replace(None);
            continue;
        }
        let is_due = sent.elapsed() >= HEARTBEAT_INTERVAL;
        if feeds.refresh(is_due).await.is_some() {
            sent = Instant::now();
        }
    }
}

/// The field of a JSON object, in JSON.
fn field<'a>(object: &'a str, name: &str) -> Option<&'a str> {
    let fields: HashMap<&str, &'a RawValue> = serde_json::from_str(object).ok()?;
    Some(fields.get(name)?.get())
}

/// The message with one field that contains a JSON document.
fn wrapped(name: &str, document: &str) -> Message {
    Message::Text(format!("{{\"{name}\":{document}}}").into())
}
