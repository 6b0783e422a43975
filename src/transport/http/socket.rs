//! The WebSocket of a tab: the server sends, the tab sends nothing.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, close_code};
use serde::Deserialize;
use serde_json::value::RawValue;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{broadcast, watch};
use tokio::time::timeout;

use crate::transport::http::feed::{Feed, Feeds};

/// The time for sending a message, after which a tab that does not read is disconnected. The page
/// reconnects.
const SEND_TIMEOUT: Duration = Duration::from_secs(150);

/// The time for sending a close frame.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

/// The part of the list that is sent.
#[derive(Deserialize)]
struct Document<'a> {
    #[serde(borrow)]
    result: ListResult<'a>,
}

#[derive(Deserialize)]
struct ListResult<'a> {
    #[serde(borrow)]
    swarms: &'a RawValue,
}

/// The part of an event that is read here.
#[derive(Deserialize)]
struct Event<'a> {
    #[serde(borrow)]
    event: Kind<'a>,
}

#[derive(Deserialize)]
struct Kind<'a> {
    kind: &'a str,
}

/// Sends a tab the list of swarms, and the frames of `swarm` if given, until the tab disconnects or
/// `revoked` completes.
pub async fn serve(
    mut socket: WebSocket,
    feeds: Arc<Feeds>,
    swarm: Option<String>,
    revoked: impl Future<Output = ()>,
) {
    tokio::select! {
        () = feed(&mut socket, feeds, swarm) => {}
        () = revoked => {
            let reason = Utf8Bytes::from_static("this token is no longer valid");
            let close = CloseFrame { code: close_code::POLICY, reason };
            // A client that does not read is disconnected anyway.
            let close = socket.send(Message::Close(Some(close)));
            let _ = timeout(CLOSE_TIMEOUT, close).await;
        }
    }
}

/// Sends the list, and the messages of one swarm if given, until the tab disconnects.
async fn feed(socket: &mut WebSocket, feeds: Arc<Feeds>, swarm: Option<String>) {
    let mut lists = feeds.list.subscribe();
    lists.mark_changed();
    let is_first = lists.borrow().is_empty();
    if is_first {
        feeds.refresh(false).await;
    }
    let mut watched = None;
    if let Some(swarm) = swarm {
        let Some((feed, state)) = feeds.watch(&swarm).await else {
            return send_gone(socket).await;
        };
        let subscribed = Watched::new(feed);
        if send(socket, Message::Binary(state)).await.is_none() {
            return;
        }
        watched = Some(subscribed);
    }
    loop {
        let message = tokio::select! {
            received = socket.recv() => match received {
                // Other messages of a tab are ignored.
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                Some(Ok(_)) => continue,
            },
            changed = lists.changed() => match changed {
                Ok(()) => {
                    let list = lists.borrow_and_update().clone();
                    list_of(&list)
                }
                Err(_) => return,
            },
            message = next(&mut watched) => message,
        };
        let Some(message) = message else {
            continue;
        };
        let is_end = is_end(&message);
        if send(socket, message).await.is_none() {
            return;
        }
        // For a new swarm of the same name the tab reconnects.
        if is_end {
            return send_gone(socket).await;
        }
    }
}

/// Sends that there is no such swarm.
async fn send_gone(socket: &mut WebSocket) {
    let _ = send(socket, text(r#"{"gone":true}"#.into())).await;
    let _ = send(socket, Message::Close(None::<CloseFrame>)).await;
}

/// Whether a message is the event that the swarm is deleted.
fn is_end(message: &Message) -> bool {
    let Message::Text(text) = message else {
        return false;
    };
    #[derive(Deserialize)]
    struct Wrapped<'a> {
        #[serde(borrow)]
        event: Option<Event<'a>>,
    }
    let event = serde_json::from_str::<Wrapped<'_>>(text)
        .ok()
        .and_then(|it| it.event);
    event.is_some_and(|it| it.event.kind == "deleted")
}

/// The subscription of a tab to a swarm.
struct Watched {
    states: watch::Receiver<Bytes>,
    orders: watch::Receiver<Bytes>,
    events: broadcast::Receiver<Bytes>,
    _feed: Arc<Feed>,
}

impl Watched {
    fn new(feed: Arc<Feed>) -> Self {
        let mut orders = feed.orders.subscribe();
        orders.mark_changed();
        Watched {
            states: feed.states.subscribe(),
            orders,
            events: feed.events.subscribe(),
            _feed: feed,
        }
    }
}

/// The next message of the watched swarm. Never completes if there is none.
async fn next(watched: &mut Option<Watched>) -> Option<Message> {
    let Some(Watched {
        states,
        orders,
        events,
        ..
    }) = watched
    else {
        return std::future::pending().await;
    };
    tokio::select! {
        Ok(()) = states.changed() => {
            let state = states.borrow_and_update().clone();
            (!state.is_empty()).then_some(Message::Binary(state))
        }
        Ok(()) = orders.changed() => wrapped("order", &orders.borrow_and_update().clone()),
        event = events.recv() => match event {
            Ok(event) => wrapped("event", &event),
            Err(RecvError::Lagged(missed)) => Some(text(format!("{{\"missed\":{missed}}}"))),
            Err(RecvError::Closed) => std::future::pending().await,
        },
    }
}

fn list_of(document: &[u8]) -> Option<Message> {
    let document: Document<'_> = serde_json::from_slice(document).ok()?;
    let swarms = document.result.swarms.get();
    Some(text(format!("{{\"swarms\":{swarms}}}")))
}

fn wrapped(name: &str, document: &[u8]) -> Option<Message> {
    let document = std::str::from_utf8(document).ok()?;
    (!document.is_empty()).then(|| text(format!("{{\"{name}\":{document}}}")))
}

fn text(text: String) -> Message {
    Message::Text(Utf8Bytes::from(text))
}

/// Sends a message; `None` if the tab is disconnected or does not read.
async fn send(socket: &mut WebSocket, message: Message) -> Option<()> {
    timeout(SEND_TIMEOUT, socket.send(message)).await.ok()?.ok()
}
