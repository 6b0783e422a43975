//! `list`, `status` and `spec`: what there is.

use jostle_proto::{NodeReply, Reply, Status, Swarms};
use serde_json::Value;

use crate::bus::Bus;
use crate::failure::Failure;
use crate::output::Output;
use crate::table;
use crate::verbs::print;

/// Lists the swarms of a daemon.
///
/// # Errors
///
/// Why there is no list.
pub async fn list(bus: &Bus, output: Output) -> Result<(), Failure> {
    let answer = bus.get_node("swarms").await?;
    if output.json {
        return output.data(answer.json()?);
    }
    let reply: NodeReply<Swarms> = answer.read()?;
    if reply.result.swarms.is_empty() {
        output.note(&format!(
            "no swarms on {}: `jostle create demo --n 50` makes one",
            reply.node
        ));
        return Ok(());
    }
    output.data(&table::swarms(&reply.result.swarms))
}

/// Shows how a swarm is doing.
///
/// # Errors
///
/// Why there is no status.
pub async fn status(bus: &Bus, output: Output, swarm: &str) -> Result<(), Failure> {
    let answer = bus.get(swarm, "status").await?;
    print(output, &answer, |reply: &Reply<Status>| {
        table::status(reply)
    })
}

/// Prints what a swarm was made from, as `create --spec` reads it.
///
/// # Errors
///
/// Why there is no spec.
pub async fn spec(bus: &Bus, output: Output, swarm: &str) -> Result<(), Failure> {
    let answer = bus.get(swarm, "spec").await?;
    print(output, &answer, |reply: &Reply<Value>| {
        format!("{:#}", reply.result)
    })
}
