//! `controllers`: the controllers that have joined a swarm.

use jostle_proto::{Controller, ControllerList, Reply};
use serde::Serialize;
use serde_json::json;

use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::table::Column;

/// Ids shown of one controller.
const MAX_IDS: usize = 8;

pub async fn controllers(context: &Context, swarm: &str) -> Result<(), Failure> {
    let answer = context.client.get(swarm, "controllers").await?;
    let reply: Reply<ControllerList> = answer.read()?;
    let if_empty = format!("no controller has joined {swarm}");
    let columns: [Column<Controller>; 11] = [
        ("controller", |it| it.controller.clone()),
        ("mode", |it| word(&it.mode)),
        ("steers", |it| ids(&it.ids)),
        ("deadline_s", |it| it.deadline_secs.to_string()),
        ("on_timeout", |it| word(&it.on_timeout)),
        ("target", |it| format::or_none(it.target_step)),
        ("misses", |it| it.misses.to_string()),
        ("waited_s", |it| {
            format::or_none(it.waited_secs.map(|secs| format!("{secs:.1}")))
        }),
        ("puts", |it| it.puts.applied.to_string()),
        ("stale", |it| it.puts.stale.to_string()),
        ("refused", |it| it.puts.refused.to_string()),
    ];
    let controllers = &reply.result.controllers;
    context
        .output
        .list(&answer, controllers, columns, &if_empty)
}

/// A mode or another word of the wire.
fn word(value: &impl Serialize) -> String {
    format::value(&json!(value), false)
}

fn ids(ids: &[u32]) -> String {
    let shown = format::ids(&ids[..ids.len().min(MAX_IDS)]);
    match ids.len() {
        0 => format::NONE.into(),
        n if n > MAX_IDS => format!("{shown},… ({n})"),
        _ => shown,
    }
}
