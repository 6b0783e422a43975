//! `list`, `status` and `spec`: one query, one table.

use jostle_proto::{NodeReply, Reply, SwarmSummary, Swarms};
use serde_json::Value;

use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::table::{self, Column};

pub async fn list(context: &Context) -> Result<(), Failure> {
    let answer = context.client.get_node("swarms").await?;
    let reply: NodeReply<Swarms> = answer.read()?;
    let if_empty = format!(
        "no swarms on {}: `jostle create demo --n 50` makes one",
        reply.node
    );
    let columns: [Column<SwarmSummary>; 10] = [
        ("swarm", |it| it.swarm.clone()),
        ("phase", |it| it.phase.name().into()),
        ("reason", |it| match (&it.reason, it.replay) {
            (Some(reason), true) => format!("replay, {reason}"),
            (None, true) => "replay".into(),
            (reason, false) => format::or_none(reason.as_ref()),
        }),
        ("step", |it| it.step.to_string()),
        ("time", |it| format::time(it.time)),
        ("n", |it| it.n.to_string()),
        ("informed", |it| it.informed.to_string()),
        ("order", |it| format::share(Some(it.order))),
        ("rate", |it| format::rate(it.rate)),
        ("actual", |it| format::factor(it.real_time_factor)),
    ];
    let swarms = &reply.result.swarms;
    context.output.list(&answer, swarms, columns, &if_empty)
}

pub async fn status(context: &Context, swarm: &str) -> Result<(), Failure> {
    let answer = context.client.get(swarm, "status").await?;
    context.output.reply(&answer, table::status)
}

/// Prints the spec of a swarm as `create --spec` reads it.
pub async fn spec(context: &Context, swarm: &str) -> Result<(), Failure> {
    let answer = context.client.get(swarm, "spec").await?;
    let describe = |reply: &Reply<Value>| format!("{:#}", reply.result);
    context.output.reply(&answer, describe)
}
