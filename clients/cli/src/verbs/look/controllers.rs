//! `controllers`: who steers a swarm, and for whom it waits.

use jostle_proto::{Controller, ControllerList, Reply};

use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table;
use crate::verbs::look::Sight;

/// Ids shown of one controller.
const MOST_IDS: usize = 8;

/// The controllers of a swarm.
///
/// # Errors
///
/// Why there are none to see.
pub async fn sight(bus: &Bus, output: Output, swarm: &str) -> Result<Sight, Failure> {
    let answer = bus.get(swarm, "controllers").await?;
    let mut is_empty = false;
    let sight = Sight::of_answer(output, &answer, |reply: &Reply<ControllerList>| {
        let controllers = &reply.result.controllers;
        is_empty = controllers.is_empty();
        let rows = controllers.iter().map(row).collect();
        let header = [
            "controller",
            "mode",
            "steers",
            "deadline_s",
            "on_timeout",
            "target",
            "misses",
            "waited_s",
            "puts",
            "stale",
            "refused",
        ];
        table::table(header, rows)
    })?;
    Ok(match is_empty {
        true => Sight {
            data: None,
            note: Some(format!("no controller has joined {swarm}")),
        },
        false => sight,
    })
}

fn row(controller: &Controller) -> [String; 11] {
    let Controller {
        controller,
        mode,
        ids,
        deadline_secs,
        on_timeout,
        driving: _,
        target_step,
        misses,
        waited_secs,
        puts,
    } = controller;
    let word = |value: serde_json::Value| format::value(&value, false);
    let shown = format::ids(&ids[..ids.len().min(MOST_IDS)]);
    let or_none = |text: Option<String>| text.unwrap_or_else(|| format::NONE.into());
    [
        controller.clone(),
        word(serde_json::json!(mode)),
        match ids.len() {
            0 => format::NONE.into(),
            n if n > MOST_IDS => format!("{shown},… ({n})"),
            _ => shown,
        },
        deadline_secs.to_string(),
        word(serde_json::json!(on_timeout)),
        or_none(target_step.map(|step| step.to_string())),
        misses.to_string(),
        or_none(waited_secs.map(|secs| format!("{secs:.1}"))),
        puts.applied.to_string(),
        puts.stale.to_string(),
        puts.refused.to_string(),
    ]
}
