//! Queries the list of swarms periodically.

use std::sync::Arc;
use std::time::Duration;

use jostle_client::{Client, Error};

use super::mailbox::Mailbox;
use super::view::Message;
use crate::failure::Failure;
use crate::verbs::outage::DAEMON_AWAY;
use crate::verbs::which::summaries;

/// The pause between two queries; no message publishes the list.
const QUERY_INTERVAL: Duration = Duration::from_secs(1);

/// Posts the swarms of all reachable daemons, or the error.
pub async fn list(client: Client, mailbox: Arc<Mailbox>) {
    let mut lost_before = client.connections_lost();
    loop {
        // A daemon may restart between two queries.
        if lost_before != client.connections_lost() {
            lost_before = client.connections_lost();
            mailbox.post(Message::Away(DAEMON_AWAY.into()));
        }
        mailbox.post(match summaries(&client).await {
            Ok(swarms) => Message::Swarms(swarms),
            Err(Error::NoDaemon { .. } | Error::NoNode { .. }) => Message::Away(DAEMON_AWAY.into()),
            Err(error) => Message::Away(Failure::from(error).to_string()),
        });
        tokio::time::sleep(QUERY_INTERVAL).await;
    }
}
