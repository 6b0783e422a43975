//! The WebSocket of a tab: the server sends, the tab sends nothing.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, close_code};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{broadcast, watch};
use tokio::time::timeout;

use crate::transport::http::feed::{Feed, Feeds};

/// The time for sending a message, after which a tab that does not read is disconnected. The page
/// reconnects.
const SEND_TIMEOUT: Duration = Duration::from_secs(150);

/// The time for sending a close frame.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

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
    let is_first = lists.borrow().is_none();
    if is_first {
        feeds.refresh(false).await;
    }
    let mut watched = None;
    if let Some(swarm) = swarm {
        let Some((feed, state)) = feeds.watch(&swarm).await else {
            return send_gone(socket).await;
        };
        watched = Some(TabSubscription::new(feed));
        if send(socket, state).await.is_none() {
            return;
        }
    }
    loop {
        let (message, is_last) = tokio::select! {
            received = socket.recv() => match received {
                // Other messages of a tab are ignored.
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                Some(Ok(_)) => continue,
            },
            changed = lists.changed() => match changed {
                Ok(()) => (lists.borrow_and_update().clone(), false),
                Err(_) => return,
            },
            message = next(&mut watched) => message,
        };
        let Some(message) = message else {
            continue;
        };
        if send(socket, message).await.is_none() {
            return;
        }
        // For a new swarm of the same name the tab reconnects.
        if is_last {
            return send_gone(socket).await;
        }
    }
}

/// Sends that there is no such swarm.
async fn send_gone(socket: &mut WebSocket) {
    let gone = Utf8Bytes::from_static(r#"{"gone":true}"#);
    let _ = send(socket, Message::Text(gone)).await;
    let _ = send(socket, Message::Close(None::<CloseFrame>)).await;
}

/// The subscription of a tab to a swarm.
struct TabSubscription {
    states: watch::Receiver<Option<Message>>,
    orders: watch::Receiver<Option<Message>>,
    events: broadcast::Receiver<(Message, bool)>,
    _feed: Arc<Feed>,
}

impl TabSubscription {
    fn new(feed: Arc<Feed>) -> Self {
        let mut orders = feed.orders.subscribe();
        orders.mark_changed();
        TabSubscription {
            states: feed.states.subscribe(),
            orders,
            events: feed.events.subscribe(),
            _feed: feed,
        }
    }
}

/// The next message of the watched swarm, and whether it is the last. Never completes if there is none.
async fn next(watched: &mut Option<TabSubscription>) -> (Option<Message>, bool) {
    let Some(TabSubscription {
        states,
        orders,
        events,
        ..
    }) = watched
    else {
        return std::future::pending().await;
    };
    tokio::select! {
        Ok(()) = states.changed() => (states.borrow_and_update().clone(), false),
        Ok(()) = orders.changed() => (orders.borrow_and_update().clone(), false),
        event = events.recv() => match event {
            Ok((event, is_last)) => (Some(event), is_last),
            Err(RecvError::Lagged(missed)) => {
                (Some(Message::Text(format!("{{\"missed\":{missed}}}").into())), false)
            }
            Err(RecvError::Closed) => std::future::pending().await,
        },
    }
}

/// Sends a message; `None` if the tab is disconnected or does not read.
async fn send(socket: &mut WebSocket, message: Message) -> Option<()> {
    timeout(SEND_TIMEOUT, socket.send(message)).await.ok()?.ok()
}
