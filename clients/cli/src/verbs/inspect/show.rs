//! `list`, `status` and `spec`: one query, one table.

use jostle_proto::{NodeReply, Reply, SwarmSummary, Swarms};
use serde_json::Value;

use crate::arguments::FilterArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::narrow::{self, Column, Room};
use crate::table;

pub async fn list(context: &Context, filter: &FilterArguments) -> Result<(), Failure> {
    let answer = context.client.get_node("swarms").await?;
    let mut reply: NodeReply<Swarms> = answer.read()?;
    if !filter.is_empty() {
        filter.check_named(&reply.result.swarms)?;
        reply.result.swarms.retain(|it| filter.lists(it));
        if context.output.json {
            return context.output.document(&reply);
        }
        if reply.result.swarms.is_empty() {
            context
                .output
                .note("no such swarm: `jostle list` lists all");
            return Ok(());
        }
    }
    let if_empty = format!(
        "no swarms on {}: `jostle create demo --n 50` makes one",
        reply.node
    );
    let columns: [Column<SwarmSummary>; 10] = [
        ("swarm", |it| it.swarm.clone(), Room::Elide),
        ("phase", |it| it.phase.name().into(), Room::Keep),
        ("reason", reason, Room::Elide),
        ("step", |it| it.step.to_string(), Room::Keep),
        ("time", |it| format::time(it.time), Room::Drop(2)),
        ("n", |it| it.n.to_string(), Room::Keep),
        ("informed", |it| it.informed.to_string(), Room::Drop(4)),
        ("order", |it| format::share(Some(it.order)), Room::Drop(5)),
        ("rate", |it| format::rate(it.rate), Room::Drop(3)),
        (
            "actual",
            |it| format::factor(it.real_time_factor),
            Room::Drop(1),
        ),
    ];
    let swarms = &reply.result.swarms;
    if context.output.json {
        return context.output.data(answer.json()?);
    }
    if swarms.is_empty() {
        context.output.note(&if_empty);
        return Ok(());
    }
    let width = narrow::terminal_width();
    context.output.data(&narrow::of(swarms, columns, width))
}

/// Why a swarm is in its phase, in one line.
fn reason(summary: &SwarmSummary) -> String {
    let is = |name: &str, holds: bool| holds.then(|| name.to_owned());
    let parts = [
        is("replay", summary.replay),
        is("protected", summary.protected),
        summary
            .earlier_models
            .first()
            .map(|it| format!("from model {}", it.model_version)),
        summary.reason.as_deref().map(format::printable),
    ];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    format::or_none((!parts.is_empty()).then(|| parts.join(", ")))
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
