//! `list`, `status` and `spec`: what there is.

use jostle_proto::{NodeReply, Reply, Status, Swarms};
use serde_json::Value;

use crate::bus::Bus;
use crate::failure::Failure;
use crate::output::Output;
use crate::table;
use crate::verbs::look::Sight;

/// The swarms of a daemon.
///
/// # Errors
///
/// Why there is no list.
pub async fn list(bus: &Bus, output: Output) -> Result<Sight, Failure> {
    let answer = bus.get_node("swarms").await?;
    let reply: NodeReply<Swarms> = answer.read()?;
    if output.json || !reply.result.swarms.is_empty() {
        return Sight::of_answer(output, &answer, |reply: &NodeReply<Swarms>| {
            table::swarms(&reply.result.swarms)
        });
    }
    Ok(Sight {
        data: None,
        note: Some(format!(
            "no swarms on {}: `jostle create demo --n 50` makes one",
            reply.node
        )),
    })
}

/// How a swarm is doing.
///
/// # Errors
///
/// Why there is no status.
pub async fn status(bus: &Bus, output: Output, swarm: &str) -> Result<Sight, Failure> {
    let answer = bus.get(swarm, "status").await?;
    Sight::of_answer(output, &answer, |reply: &Reply<Status>| {
        table::status(reply)
    })
}

/// What a swarm was made from, as `create --spec` reads it.
///
/// # Errors
///
/// Why there is no spec.
pub async fn spec(bus: &Bus, output: Output, swarm: &str) -> Result<Sight, Failure> {
    let answer = bus.get(swarm, "spec").await?;
    Sight::of_answer(output, &answer, |reply: &Reply<Value>| {
        format!("{:#}", reply.result)
    })
}
