//! Asks again and again which swarms there are.

use std::sync::Arc;
use std::time::Duration;

use jostle_proto::SwarmSummary;

use super::mailbox::Mailbox;
use super::view::Message;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::verbs::lookout::GONE;

/// How long to rest between two questions.
const REST: Duration = Duration::from_secs(1);

/// Posts the swarms of every daemon in reach, or why nobody tells.
pub async fn list(bus: Arc<Bus>, mailbox: Arc<Mailbox>) {
    let mut lost_before = bus.lost();
    loop {
        // A daemon may be gone and back between two questions.
        if lost_before != bus.lost() {
            lost_before = bus.lost();
            mailbox.post(Message::Away(GONE.into()));
        }
        mailbox.post(match swarms(&bus).await {
            Ok(swarms) => Message::Swarms(swarms),
            Err(failure) if failure.code() == "unreachable" => Message::Away(GONE.into()),
            Err(failure) => Message::Away(failure.to_string()),
        });
        tokio::time::sleep(REST).await;
    }
}

async fn swarms(bus: &Bus) -> Result<Vec<SwarmSummary>, Failure> {
    let mut swarms = Vec::new();
    for node in bus.nodes_to_ask().await? {
        swarms.extend(bus.swarms_of(&node).await?);
    }
    swarms.sort_by(|a, b| a.swarm.cmp(&b.swarm));
    swarms.dedup_by(|a, b| a.swarm == b.swarm);
    Ok(swarms)
}
