//! Queries the list of swarms periodically.

use std::sync::Arc;
use std::time::Duration;

use jostle_client::{Client, Error};
use jostle_proto::SwarmSummary;

use super::mailbox::Mailbox;
use super::view::Message;
use crate::failure::Failure;
use crate::verbs::outage::DAEMON_AWAY;

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
        mailbox.post(match swarms(&client).await {
            Ok(swarms) => Message::Swarms(swarms),
            Err(Error::NoDaemon { .. } | Error::NoNode { .. }) => Message::Away(DAEMON_AWAY.into()),
            Err(error) => Message::Away(Failure::from(error).to_string()),
        });
        tokio::time::sleep(QUERY_INTERVAL).await;
    }
}

async fn swarms(client: &Client) -> Result<Vec<SwarmSummary>, Error> {
    let mut swarms = Vec::new();
    for node in client.nodes_to_query().await? {
        swarms.extend(client.swarms_of(&node).await?);
    }
    swarms.sort_by(|a, b| a.swarm.cmp(&b.swarm));
    swarms.dedup_by(|a, b| a.swarm == b.swarm);
    Ok(swarms)
}
