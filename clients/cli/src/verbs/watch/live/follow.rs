//! Follows one swarm for the view.

use std::sync::Arc;
use std::time::Duration;

use jostle_client::{Client, Error, EventsFrom, FollowOptions, Update};
use jostle_proto::{Events, Reply};
use tokio::time::{interval, sleep};

use super::mailbox::Mailbox;
use super::view::Message;
use crate::failure::Failure;

/// The least time between two states: more would not be drawn.
const STATE_INTERVAL: Duration = Duration::from_millis(50);
/// The interval of the queries for values that no event contains, and for a lost state of a
/// paused swarm.
const QUERY_INTERVAL: Duration = Duration::from_secs(5);
/// How many past events are shown.
const PAST_EVENTS: u64 = 20;

/// Posts the updates of a swarm until the task is aborted. Whether it exists is shown by the list.
pub async fn follow(client: Client, mailbox: Arc<Mailbox>, swarm: String) {
    loop {
        match updates(&client, &mailbox, &swarm).await {
            Err(error) if !error.is_transient() && !error.is_not_found() => {
                return mailbox.post(Message::Failed(Failure::from(error).to_string()));
            }
            // A swarm of the same name may be created.
            _ => sleep(QUERY_INTERVAL).await,
        }
    }
}

/// Posts the updates of a swarm until it is deleted.
async fn updates(client: &Client, mailbox: &Mailbox, swarm: &str) -> Result<(), Error> {
    // Every reply has the newest number.
    let reply: Reply<Events> = client.get(swarm, "events?after=0;limit=1").await?.read()?;
    let after = reply.result.newest.saturating_sub(PAST_EVENTS);
    let options = FollowOptions {
        states: Some(1),
        events: Some(EventsFrom::After(after)),
        ..FollowOptions::default()
    };
    let mut updates = client.follow(swarm, options).await?;
    let mut queries = interval(QUERY_INTERVAL);
    loop {
        let mut update = tokio::select! {
            update = updates.next() => update,
            _ = queries.tick() => {
                post_status(client, mailbox, swarm).await;
                if let Ok(state) = client.state(swarm).await.and_then(|it| it.read()) {
                    mailbox.post(Message::State(Box::new(state)));
                }
                continue;
            }
        };
        let mut events = Vec::new();
        loop {
            match update {
                Some(Ok(Update::Event(event))) => events.push(event.value),
                Some(Ok(Update::State(state))) => {
                    mailbox.post(Message::State(Box::new(state.value)));
                    break;
                }
                Some(Ok(Update::Deleted)) => return Ok(()),
                // A newer daemon may publish kinds of events that this version does not know.
                Some(Ok(_) | Err(Error::Decode { .. })) => {}
                Some(Err(error)) => return Err(error),
                None => break,
            }
            update = updates.try_next();
        }
        if !events.is_empty() {
            mailbox.post(Message::Events(events));
            post_status(client, mailbox, swarm).await;
        }
        sleep(STATE_INTERVAL).await;
    }
}

/// Queries the status. An error is ignored: a lasting one appears in the list.
async fn post_status(client: &Client, mailbox: &Mailbox, swarm: &str) {
    if let Ok(status) = client.status(swarm).await {
        mailbox.post(Message::Status(Box::new(status)));
    }
}
